"""What a calibration answers: camera, stand-off and plane of the sheet in numbers, and points at a lattice of pixels.

The plane is n·X = d in the camera's frame, n = (cos e cos a, sin e, cos e sin a) with n_x >= 0: `plane_angle` holds (e, a) [rad],
`plane_offset` d [m], the distance of the plane from the entrance pupil. `node` holds the points where the rays of a lattice of
pixels meet the sheet: an error of a calibration there is the error of every point that is triangulated by it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from ...optics.port import FlatPort
from .deviations import STEPS, deviated
from .geometry import Geometry

__all__ = ["NEEDED", "NODES", "described", "nodes", "spread"]

Float = npt.NDArray[np.float64]

#: Rows and columns of the lattice.
NODES = (8, 32)
#: The parameters (`declared.CALIBRATED`) that a calibration must have found to answer a quantity.
NEEDED: Mapping[str, tuple[str, ...]] = {
    "node": ("turn_about_axis_rad", "turn_about_fan_rad", "shift_m"),
    "focal_length": ("focal_px",),
    "principal_point": ("principal_row_px", "principal_col_px"),
    "stand_off": ("stand_off_m",),
    "plane_angle": ("turn_about_axis_rad", "turn_about_fan_rad"),
    "plane_offset": ("turn_about_axis_rad", "turn_about_fan_rad", "shift_m"),
}


def nodes(rows: int, cols: int) -> tuple[Float, Float]:
    """Rows and columns (256) [px] of the lattice: the middles of 8 × 32 equal parts of the image."""
    part = [(np.arange(many) + 0.5) / many * size - 0.5 for many, size in zip(NODES, (rows, cols), strict=True)]
    row, col = np.meshgrid(*part, indexing="ij")
    return row.ravel(), col.ravel()


def described(geometry: Geometry, pitch_m: float) -> dict[str, Float]:
    """The quantities of the stage `calibration` by name: node (256, xyz) [m], focal_length (1) [m] of pixels of `pitch_m`,
    principal_point (1, 2) row and column [px], stand_off (1) [m], NaN without a flat port, plane_angle (1, 2) [rad],
    plane_offset (1) [m]."""
    camera, sheet = geometry.camera, geometry.sheet
    normal = sheet.normal * (1.0 if sheet.normal[0] >= 0 else -1.0)
    port = camera.port
    return {
        "node": np.moveaxis(geometry.points(*nodes(geometry.rows, geometry.cols)), 0, -1),
        "focal_length": np.array([camera.focal_px * pitch_m]),
        "principal_point": np.array([[camera.row0, camera.col0]]),
        "stand_off": np.array([port.stand_off_m if isinstance(port, FlatPort) else np.nan]),
        "plane_angle": np.array([[np.arcsin(np.clip(normal[1], -1.0, 1.0)), np.arctan2(normal[2], normal[0])]]),
        "plane_offset": np.array([float(normal @ sheet.source)]),
    }


def spread(geometry: Geometry, pitch_m: float, names: Sequence[str], covariance: Float) -> dict[str, Float]:
    """Standard errors of `described`, √(J C Jᵀ)_ii, for the covariance C of the deviations `names`."""
    ends = []
    for name in names:
        ahead, behind = (described(deviated(geometry, {name: sign * STEPS[name]}), pitch_m) for sign in (1.0, -1.0))
        ends.append({key: (ahead[key] - behind[key]) / (2.0 * STEPS[name]) for key in ahead})
    if not ends:
        return {key: np.zeros(value.shape) for key, value in described(geometry, pitch_m).items()}
    slopes = {key: np.stack([end[key] for end in ends]) for key in ends[0]}
    return {
        key: np.sqrt(np.maximum(np.einsum("k...,kl,l...->...", slope, covariance, slope), 0.0))
        for key, slope in slopes.items()
    }
