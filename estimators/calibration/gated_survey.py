"""Times at which the echoes of a surveyed target arrive."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...optics.constants import C_M_PER_S
from ...scenes.errors import InputError
from .gated_scan import DelayScan

__all__ = ["surveyed_delay"]

Float = npt.NDArray[np.float64]


def surveyed_delay(scan: DelayScan, range_m: npt.ArrayLike) -> Float:
    """Time of the echo of every pixel [s] of a target at known radial ranges (row, col): 2 n_g r/c, or the way by a laser
    apart.

    Raises:
        InputError: ranges of another shape.
    """
    r = np.asarray(range_m, np.float64)
    if r.shape != scan.shape:
        raise InputError(
            "The surveyed ranges do not fit the image.", where="truth_range", value=r.shape, allowed=str(scan.shape)
        )
    rig = scan.rig
    laser = rig.numbers("laser.position_m", length=3)
    path = 2.0 * r
    if laser.any():
        row, col = np.indices(scan.shape, dtype=np.float64)
        focal = rig.number("camera.focal_length_m", above=0) / rig.number("camera.pixel_pitch_m", above=0)
        ray = np.stack(
            [(col - rig.number("camera.principal_col_px")) / focal,
             (row - rig.number("camera.principal_row_px")) / focal, np.ones(scan.shape)], axis=-1,
        )  # fmt: skip
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        path = r + np.linalg.norm(r[..., None] * ray - laser, axis=-1)
    return np.asarray((path * rig.number("medium.group_index", above=0) / C_M_PER_S).ravel())
