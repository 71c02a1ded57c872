"""Times at which the echoes of a surveyed target arrive."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...optics.constants import C_M_PER_S
from ...scenes.errors import InputError
from .gated_scan import DelayScan

__all__ = ["is_flat", "surveyed_delay"]

Float = npt.NDArray[np.float64]

#: rms distance of a flat target from its plane, m: 7 ps of an echo.
_FLAT_M = 1e-3


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
        path = r + np.linalg.norm(r[..., None] * _rays(scan) - laser, axis=-1)
    return np.asarray((path * rig.number("medium.group_index", above=0) / C_M_PER_S).ravel())


def is_flat(scan: DelayScan, range_m: npt.ArrayLike) -> bool:
    """Whether the surveyed ranges (row, col) are those of one plane n·X = 1, along unit rays u: 1/r = n·u, to a millimetre rms.

    A pixel of a curved or stepped target is not timed by the range of its middle alone.
    """
    r = np.asarray(range_m, np.float64)
    known = np.isfinite(r) & (r > 0)
    rays = all(
        scan.rig.get(f"camera.{name}") is not None
        for name in ("focal_length_m", "principal_row_px", "principal_col_px")
    )
    if r.shape != scan.shape or int(known.sum()) < 4 or not rays:
        return False
    ray = _rays(scan)[known]
    plane = np.linalg.lstsq(ray, 1.0 / r[known], rcond=None)[0]
    with np.errstate(divide="ignore"):
        return bool(np.sqrt(np.mean((1.0 / (ray @ plane) - r[known]) ** 2)) < _FLAT_M)


def _rays(scan: DelayScan) -> Float:
    """Unit rays (row, col, xyz) of the pixels."""
    rig = scan.rig
    row, col = np.indices(scan.shape, dtype=np.float64)
    focal = rig.number("camera.focal_length_m", above=0) / rig.number("camera.pixel_pitch_m", above=0)
    ray = np.stack(
        [(col - rig.number("camera.principal_col_px")) / focal,
         (row - rig.number("camera.principal_row_px")) / focal, np.ones(scan.shape)], axis=-1,
    )  # fmt: skip
    return np.asarray(ray / np.linalg.norm(ray, axis=-1, keepdims=True))
