"""Checks of what a laser-line camera sees: that pupil, port and laser can be where they are, and that lines cross the rows."""

from __future__ import annotations

import numpy as np

from ...optics.dome import DomePort
from ...optics.pinhole import Pinhole
from ...optics.sheet import Sheet, meeting
from ..errors import InputError
from .laser_line_spec import LaserLineRig

__all__ = ["check_port", "check_view"]

#: Pixels along each side of the image at which the view is probed, and half the step between them and their neighbours.
_PROBES, _STEP = 17, 0.25
#: Least change of the distance from the sheet along a row, as a share of that across rows; medians over the probes.
_LEAST_CROSSING = 0.02


def check_port(rig: LaserLineRig, camera: Pinhole, name: str) -> None:
    """Refuse a pupil outside its dome, and a laser inside it. Raises InputError."""
    port = camera.port
    if not isinstance(port, DomePort):
        return
    inner, away = port.radius_m - port.thickness_m, float(np.linalg.norm(port.center_m))
    if away >= inner:
        raise InputError(
            "The camera's entrance pupil lies outside its dome.", where=f"{name}: rig.port.center_m", value=list(port.center_m),
            allowed=f"a distance of the centre below radius_m − thickness_m, {inner:.4g} m",
            next_step="move center_m nearer to the pupil, or give a larger radius_m",
        )  # fmt: skip
    laser = np.asarray(rig.laser.position_m) - np.asarray(port.center_m)
    if float(np.linalg.norm(laser)) < port.radius_m:
        raise InputError(
            "The laser lies inside the camera's dome: its light would be refracted there, which is not modelled.",
            where=f"{name}: rig.laser.position_m", value=list(rig.laser.position_m),
            allowed=f"a place more than radius_m, {port.radius_m:.4g} m, from the dome's centre",
        )  # fmt: skip


def check_view(rig: LaserLineRig, camera: Pinhole, sheet: Sheet, name: str) -> None:
    """Refuse a sheet that no ray of the camera meets, and one whose lines run along the rows. Raises InputError."""
    rows, cols = rig.camera.rows, rig.camera.cols
    row, col = (v.ravel() for v in np.meshgrid(_spread(rows), _spread(cols), indexing="ij"))
    origin, direction = camera.rays(row, col)
    point = meeting(origin, direction, sheet.normal, sheet.source)
    with np.errstate(invalid="ignore"):
        ahead = (direction * (point - origin)).sum(axis=0) > 0
        ahead &= sheet.fan_density(sheet.fan_angle(point)) > 0
    if not ahead.any():
        raise InputError(
            "The camera sees no part of the laser's sheet: it leaves the field of view, or lies along it, at every range.",
            where=f"{name}: rig.laser",
            value={"position_m": list(rig.laser.position_m), "rotation_deg": list(rig.laser.rotation_deg)},
            allowed="a sheet that crosses the view ahead of the camera",
            next_step="turn rig.laser.rotation_deg toward the view, or move rig.laser.position_m",
        )  # fmt: skip
    steps = []
    for down, right in ((0.0, _STEP), (_STEP, 0.0)):
        ends = [camera.rays(row + sign * down, col + sign * right) for sign in (-1.0, 1.0)]
        offset = [sheet.offset(meeting(o, d, direction, point)) for o, d in ends]
        steps.append(np.abs(offset[1] - offset[0])[ahead])
    if not np.median(steps[0]) > _LEAST_CROSSING * np.median(steps[1]):
        raise InputError(
            "The laser's lines run along the rows of the image, and must cross them: no row holds one column of the line.",
            where=f"{name}: rig.laser.rotation_deg", value=list(rig.laser.rotation_deg),
            allowed="a sheet roughly along y, beside the camera along x", next_step="turn the sheet by 90 degrees about z",
        )  # fmt: skip


def _spread(count: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.linspace(-0.5, count - 0.5, _PROBES)
