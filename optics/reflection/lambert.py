"""Lambert's law: an ideal diffuse surface."""

from __future__ import annotations

import numpy as np

from .angles import Angles, Array, lit

__all__ = ["lambert"]


def lambert(angles: Angles, *, albedo: float | Array) -> Array:
    """Response f·cosθi = albedo/π · cosθi [1/sr]; zero where light or eye is below the surface.

    `albedo` (0..1) broadcasts against the angles. Hemispherical albedo: `albedo` at every incidence.
    Source: J. H. Lambert, Photometria, 1760.
    """
    return np.where(lit(angles), albedo / np.pi * angles.cos_i, 0.0)
