"""What a calibration of a laser-line rig leaves open: the covariance of its values, by paths of the rig and as estimators read it.

A rig's values p (paths) err by e with covariance C. Estimators know the errors of the geometry q, of camera, stand-off and plane of
the sheet (`PARAMETERS`), whose covariance is D C Dᵀ, D = ∂q/∂p:

    turn about the sheet's middle ray a: δn·f,   turn about the fan's direction f: −δn·a,   shift along the normal n: n·δP,

P the laser's position. Of the six values of position and rotation these are the three that move the sheet's plane.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from ...optics.rotation import rotation_matrix
from ..base import Spec

__all__ = ["PARAMETERS", "PATHS", "LineCalibration", "calibration_data"]

Float = NDArray[np.float64]

#: What the geometry may err by, in the names that estimators read; rows of D.
PARAMETERS = (
    "focal_px", "principal_row_px", "principal_col_px", "k1", "k2", "p1", "p2", "k3", "stand_off_m", "turn_about_axis_rad",
    "turn_about_fan_rad", "shift_m",
)  # fmt: skip
_PLANE = PARAMETERS[-3:]
#: Paths, from the rig, of values that say so; columns of D.
PATHS = (
    "camera.focal_length_m", "principal_offset_px.0", "principal_offset_px.1", "distortion.k1", "distortion.k2", "distortion.p1",
    "distortion.p2", "distortion.k3", "port.stand_off_m", *(f"laser.position_m.{k}" for k in range(3)),
    *(f"laser.rotation_deg.{k}" for k in range(3)),
)  # fmt: skip
#: Least eigenvalue of correlations, rounding allowed for; step [degree] of derivatives by an angle.
_NEGATIVE, _STEP_DEG = -1e-9, 1e-3
#: The greatest variance: beyond it nothing is known, and sums leave the numbers of a file.
_MOST = 1e12


class LineCalibration(Spec):
    """What a calibration leaves open.

    `paths`: values of the rig, without "rig.": those of `PATHS`. `covariance`: of them, row by row, in the units of their names.
    """

    paths: Annotated[tuple[str, ...], Field(min_length=1, max_length=len(PATHS))]
    covariance: tuple[tuple[float, ...], ...]

    @model_validator(mode="after")
    def _it_is_a_covariance(self) -> LineCalibration:
        unknown = [path for path in self.paths if path not in PATHS]
        if unknown or len(set(self.paths)) < len(self.paths):
            raise ValueError(f"paths should be different ones of {', '.join(PATHS)}")
        if any(len(row) != len(self.paths) for row in self.covariance) or len(self.covariance) != len(self.paths):
            raise ValueError("covariance should have as many rows and columns as there are paths")
        matrix = np.array(self.covariance)
        variance = np.diag(matrix)
        if (
            variance.min() < 0
            or variance.max() > _MOST
            or matrix[variance == 0].any()
            or matrix[:, variance == 0].any()
        ):
            raise ValueError(
                f"covariance should hold variances from 0 to {_MOST:g} on its diagonal, and 0 beside a variance of 0"
            )
        scale = np.sqrt(np.where(variance > 0, variance, 1.0))
        unit = matrix / np.outer(scale, scale)
        if np.abs(unit - unit.T).max() > 1e-9 or np.linalg.eigvalsh(unit).min() < _NEGATIVE:
            raise ValueError("covariance should be symmetric, without negative eigenvalues")
        return self


def calibration_data(
    held: LineCalibration | None, pixel_pitch_m: float, rotation_deg: tuple[float, float, float]
) -> dict[str, Any]:
    """What a rig of these pixels, and of a laser turned by these angles, declares of its calibration: `{"calibration": {parameters,
    covariance}}`; nothing without one."""
    if held is None:
        return {}
    slope = _slopes(pixel_pitch_m, rotation_deg)[:, [PATHS.index(path) for path in held.paths]]
    told = np.flatnonzero(np.abs(slope).max(axis=1) > 0)
    if not told.size:  # the laser's place in its own plane
        return {}
    covariance = slope[told] @ np.array(held.covariance) @ slope[told].T
    return {
        "calibration": {
            "parameters": [PARAMETERS[k] for k in told], "covariance": (0.5 * (covariance + covariance.T)).tolist(),
        }
    }  # fmt: skip


def _slopes(pixel_pitch_m: float, rotation_deg: tuple[float, float, float]) -> Float:
    """D (parameters, paths)."""
    made = np.zeros((len(PARAMETERS), len(PATHS)))
    # The first ones are values of the rig themselves, but for the unit of the focal length.
    plain = PARAMETERS.index(_PLANE[0])
    made[:plain, :plain] = np.diag([1.0 / pixel_pitch_m, *([1.0] * (plain - 1))])
    turn = rotation_matrix(rotation_deg)
    normal, fan, axis = turn.T
    for k in range(3):
        place, angle = PATHS.index(f"laser.position_m.{k}"), PATHS.index(f"laser.rotation_deg.{k}")
        made[plain + 2, place] = normal[k]
        ends = []
        for sign in (1.0, -1.0):
            x, y, z = (value + sign * _STEP_DEG * (part == k) for part, value in enumerate(rotation_deg))
            ends.append(rotation_matrix((x, y, z))[:, 0])
        away = (ends[0] - ends[1]) / (2.0 * _STEP_DEG)
        made[plain, angle], made[plain + 1, angle] = away @ fan, -(away @ axis)
    return made
