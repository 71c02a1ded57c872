"""Small deviations of the geometry that a calibration finds: of the camera, of its distance from the port, of the laser's plane."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ...optics.port import FlatPort
from ...optics.rotation import turned_by
from .geometry import Geometry

__all__ = ["STEPS", "deviated"]

Float = npt.NDArray[np.float64]

#: Parameters (`declared.CALIBRATED`), and steps of their derivatives: small beside what a calibration leaves open, and large
#: beside rounding.
STEPS: dict[str, float] = {
    "focal_px": 1e-3,
    "principal_row_px": 1e-3,
    "principal_col_px": 1e-3,
    "k1": 1e-6,
    "k2": 1e-6,
    "p1": 1e-6,
    "p2": 1e-6,
    "k3": 1e-6,
    "stand_off_m": 1e-6,
    "turn_about_axis_rad": 1e-6,
    "turn_about_fan_rad": 1e-6,
    "shift_m": 1e-6,
}


def deviated(geometry: Geometry, by: Mapping[str, float]) -> Geometry:
    """The geometry with its parameters changed by what is given, by name; others stay.

    focal_px, principal_row_px, principal_col_px [px], k1 … k3 (Brown), stand_off_m: plain sums. The sheet is turned about its
    middle ray and about the direction along the fan [rad], as one rotation vector, and then moved along its normal by
    shift_m: with it a plane has its three degrees of freedom.
    """
    camera, sheet = geometry.camera, geometry.sheet
    brown = np.array(camera.distortion) + [by.get(name, 0.0) for name in ("k1", "k2", "p1", "p2", "k3")]
    port = camera.port
    if isinstance(port, FlatPort):
        port = replace(port, stand_off_m=port.stand_off_m + by.get("stand_off_m", 0.0))
    k1, k2, p1, p2, k3 = brown.tolist()
    camera = replace(
        camera, focal_px=camera.focal_px + by.get("focal_px", 0.0), row0=camera.row0 + by.get("principal_row_px", 0.0),
        col0=camera.col0 + by.get("principal_col_px", 0.0), distortion=(k1, k2, p1, p2, k3), port=port,
    )  # fmt: skip
    vector = (
        by.get("turn_about_axis_rad", 0.0) * sheet.frame[:, 2] + by.get("turn_about_fan_rad", 0.0) * sheet.frame[:, 1]
    )
    frame = turned_by(vector) @ sheet.frame
    source = sheet.source + by.get("shift_m", 0.0) * frame[:, 0]
    return replace(geometry, camera=camera, sheet=replace(sheet, frame=frame, source=source))
