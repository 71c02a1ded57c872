"""Slopes from spots: each spot is that of the lenslet in whose cell it lies."""

from __future__ import annotations

import numpy as np
import xarray as xr

from ..registry import estimator
from ..result import stage_result
from ..rig import DeclaredRig
from .geometry import declared_geometry

__all__ = ["slope_cell"]


@estimator("assignment", cites="Guo et al. 2017, Eq. 27: slope = displacement over focal length")
def slope_cell(spots: xr.Dataset, rig: DeclaredRig) -> xr.Dataset:
    """∂W/∂x = Δx/f (Eq. 27), Δx from the declared place of the lenslet's spot.

    Returns slope, sigma [rad], valid (frame, lenslet, axis), along the camera's axes. A spot that left its cell is none of this
    assignment: the centroid marks it invalid.
    """
    geometry = declared_geometry(rig)
    moved = np.asarray(spots["spot"].values) - geometry.place_px
    scale = geometry.rad_per_px
    return stage_result(
        "assignment", slope=moved * scale, sigma=np.asarray(spots["sigma"].values) * scale,
        valid=np.asarray(spots["valid"].values),
    )  # fmt: skip
