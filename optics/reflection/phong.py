"""Phong's gloss, normalised so that it conserves energy."""

from __future__ import annotations

import numpy as np

from .angles import Angles, Array, lit

__all__ = ["phong"]


def phong(
    angles: Angles, *, diffuse_albedo: float | Array, specular_albedo: float | Array, exponent: float | Array
) -> Array:
    """Response f·cosθi [1/sr] with f = kd/π + ks (n+2)/(2π) cosⁿα, α between the mirror direction and the eye.

    The lobe is cut at α = 90°. Hemispherical albedo: kd + ks at normal incidence, less at others (part of the lobe is
    below the surface), so kd + ks ≤ 1 conserves energy at every angle. f is reciprocal.
    Source: E. P. Lafortune and Y. D. Willems, "Using the modified Phong reflectance model for physically based
    rendering", report CW 197, K. U. Leuven, 1994.
    """
    lobe = np.power(np.maximum(angles.cos_r, 0.0), exponent) * (angles.cos_r > 0.0)
    f = diffuse_albedo / np.pi + specular_albedo * (np.asarray(exponent) + 2.0) / (2.0 * np.pi) * lobe
    return np.where(lit(angles), f * angles.cos_i, 0.0)
