"""The procedure "boards": camera, stand-off of the port and plane of the sheet of a laser line, from captures of a checkerboard.

The adjustment is that of `laser_line.calibrate`: all stores together, in air and in water. What it finds is turned into a scene's
own values s: the sheet's plane into the laser's position P, moved along the plane's normal alone, and the angles of its frame,

    R_z R_y R_x = [n, f, a],    C_s = (∂s/∂q) C (∂s/∂q)ᵀ,

q the parameters of the adjustment and C their covariance. Where in the plane the laser stands, and its turn about n, stay as
declared: a line on a board does not show them, so that P and the angles have no standard errors of their own; the plane has. The
rig file keeps C_s (`rig.calibration`), so that a capture whose scene takes the file declares it, and estimators add it to their
errors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.rotation import rotation_angles_deg
from ...scenes.errors import InputError
from ..laser_line.board import Board
from ..laser_line.bundle import Adjusted, flat_port
from ..laser_line.calibrate import calibrate
from ..laser_line.described import described, spread
from ..laser_line.deviations import STEPS, deviated
from ..laser_line.geometry import Geometry
from ..rig import DeclaredRig, read_rig
from .procedure import Calibrated, Figure, Procedure

__all__ = ["BOARDS"]

Float = npt.NDArray[np.float64]

_KIND = "laser_line"
#: Fewest views: two of a line tell its plane, a third tells an error.
_LEAST_VIEWS = 3
#: Most corners along a side of a board, and its largest lengths [m].
_MOST_CORNERS, _LARGEST_M = 200, 10.0
#: Nearer to ±90° than this [degree] the angle about y leaves the two others open.
_UPRIGHT_DEG = 0.1
_TYPE = "--procedures 'boards[rows=6,cols=9,square_m=0.02,beyond_x_m=0.095,beyond_y_m=0.035]'"
_PLANE = ("turn_about_axis_rad", "turn_about_fan_rad", "shift_m")
_IN_PLANE = "of the sheet's plane; within it as declared"
_SCALE = "scales with square_m, which captures of one pose each do not check"
#: Path without "rig." -> (name, unit, parameters of the adjustment on which it rests).
_SHOWN: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "camera.focal_length_m": ("focal length", "m", ("focal_px",)),
    "principal_offset_px.0": ("principal point, row", "px", ("principal_row_px",)),
    "principal_offset_px.1": ("principal point, column", "px", ("principal_col_px",)),
    **{f"distortion.{name}": (f"distortion {name}", "1", (name,)) for name in ("k1", "k2", "p1", "p2", "k3")},
    "port.stand_off_m": ("stand-off of the port", "m", ("stand_off_m",)),
    **{f"laser.position_m.{k}": (f"laser, {axis}", "m", _PLANE) for k, axis in enumerate("xyz")},
    **{f"laser.rotation_deg.{k}": (f"laser, turn about {axis}", "degree", _PLANE) for k, axis in enumerate("xyz")},
}


def _lacking(
    captures: Sequence[xr.Dataset], *, rows: int | None = None, cols: int | None = None, square_m: float | None = None,
    beyond_x_m: float | None = None, beyond_y_m: float | None = None,
) -> str:  # fmt: skip
    """What is missing: a camera of a laser line, or the sizes of the board, which no image tells."""
    if any(str(one.attrs.get("modality")) != _KIND for one in captures):
        return "frames of a laser-line camera that sees a checkerboard"
    sizes = {"rows": rows, "cols": cols, "square_m": square_m, "beyond_x_m": beyond_x_m, "beyond_y_m": beyond_y_m}
    missing = [name for name, value in sizes.items() if value is None]
    if missing:
        return (
            f"the board's {', '.join(missing)}: type {_TYPE} with the sizes of your board (rows and cols of inner corners, the "
            "side of a square, and how far the plane goes on evenly beyond the corners)"
        )
    return ""


def _run(
    captures: Sequence[xr.Dataset], *, rows: int | None = None, cols: int | None = None, square_m: float | None = None,
    beyond_x_m: float | None = None, beyond_y_m: float | None = None,
) -> Calibrated:  # fmt: skip
    """The rig's values of all captures together. Raises InputError as `laser_line.calibrate.calibrate`, for captures of several
    cameras and for fewer than three views."""
    assert rows is not None and cols is not None and square_m is not None
    assert beyond_x_m is not None and beyond_y_m is not None
    if max(rows, cols) > _MOST_CORNERS or square_m > _LARGEST_M or not 0.0 <= min(beyond_x_m, beyond_y_m) < _LARGEST_M:
        raise InputError(
            "The sizes of the board are not possible.", where="--procedures boards",
            value=f"{rows} x {cols} corners, {square_m:g} m apart, {beyond_x_m:g} and {beyond_y_m:g} m beyond them",
            allowed=f"{_MOST_CORNERS} corners a side or fewer, lengths in m from 0 to {_LARGEST_M:g}",
            next_step="measure the board, in m",
        )  # fmt: skip
    board = Board(rows, cols, square_m, (beyond_x_m, beyond_y_m))
    rigs = [read_rig(one, _KIND) for one in captures]
    _check_one_camera(rigs)
    found = calibrate(list(captures), board, least_views=1)
    if len(found.poses) < _LEAST_VIEWS:
        raise InputError(
            "Too few views show the whole board.", where="DATA", value=f"{len(found.poses)} views",
            allowed=f"{_LEAST_VIEWS} or more", next_step="show the board from more places, tilted to different sides",
        )  # fmt: skip
    stations = [len(np.unique(np.asarray(one["pose"].values), axis=0)) for one in captures]
    used = {
        "corners_a_board": f"{rows} x {cols}", "m_between_corners": square_m, "views": len(found.poses),
        "views_left_out": sum(stations) - len(found.poses), "corners": found.corners, "points_of_the_line": found.points,
    }  # fmt: skip
    pitch = rigs[-1].number("camera.pixel_pitch_m", above=0)
    return _calibrated(found, pitch, used, checked=max(stations) >= _LEAST_VIEWS)


def _check_one_camera(rigs: Sequence[DeclaredRig]) -> None:
    """Refuse captures whose declared cameras differ in what the board does not show."""
    for path in ("camera.rows", "camera.cols", "camera.pixel_pitch_m"):
        held = sorted({rig.number(path) for rig in rigs})
        if len(held) > 1:
            raise InputError(
                "The captures are of several cameras.", where=f"attribute rig: {path}", value=held, allowed="one value",
                next_step="calibrate the captures of each camera alone",
            )  # fmt: skip


def _calibrated(found: Adjusted, pitch_m: float, used: dict[str, Any], *, checked: bool) -> Calibrated:
    told = [path for path, (_, _, needs) in _SHOWN.items() if set(needs) <= set(found.names)]
    value = _scene_values(found.geometry, pitch_m)
    covariance = _scene_covariance(found, pitch_m, told)
    sigma = dict(zip(told, np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist(), strict=True))
    figures = []
    for path, (name, unit, _) in _SHOWN.items():
        if path in told:
            plane = path.startswith("laser.")
            note = _IN_PLANE if plane else _SCALE if path.startswith("port.") and not checked else ""
            figures.append(Figure(name, unit, value[path], math.nan if plane else sigma[path], f"rig.{path}", note))
    figures += _plane(found, pitch_m, "" if checked else _SCALE) if _PLANE[0] in found.names else []
    figures += [
        Figure("corners, rms residual", "px", found.corner_rms_px, math.nan),
        Figure("line, rms residual", "px", found.line_rms_px, math.nan),
    ]
    brown = ("k1", "k2", "p1", "p2", "k3")
    values: dict[str, Any] = {}
    if "principal_offset_px.0" in told:
        values["rig.principal_offset_px"] = [value[f"principal_offset_px.{k}"] for k in range(2)]
        values["rig.distortion"] = {name: value[f"distortion.{name}"] for name in brown}
    if "laser.position_m.0" in told:
        values |= {
            f"rig.laser.{name}": [value[f"laser.{name}.{k}"] for k in range(3)]
            for name in ("position_m", "rotation_deg")
        }
    values["rig.calibration"] = {"paths": told, "covariance": covariance.tolist()}
    return Calibrated(tuple(figures), values, used=used)


def _plane(found: Adjusted, pitch_m: float, note: str) -> list[Figure]:
    """The sheet's plane n·X = d in numbers that are all told, as of `laser_line.described`."""
    value = described(found.geometry, pitch_m)
    sigma = spread(found.geometry, pitch_m, found.names, found.covariance)
    angle, error = value["plane_angle"][0], sigma["plane_angle"][0]
    away = value["plane_offset"][0], sigma["plane_offset"][0]
    return [
        Figure("sheet, elevation of its normal", "rad", float(angle[0]), float(error[0])),
        Figure("sheet, azimuth of its normal", "rad", float(angle[1]), float(error[1])),
        Figure("sheet, distance from the pupil", "m", float(away[0]), float(away[1]), "", note),
    ]


def _scene_values(geometry: Geometry, pitch_m: float) -> dict[str, float]:
    """{path without "rig.": value} of a geometry. Raises InputError for a sheet whose angles are no three numbers."""
    camera, sheet = geometry.camera, geometry.sheet
    port = flat_port(camera.port)
    angles = rotation_angles_deg(sheet.frame)
    if abs(abs(angles[1]) - 90.0) < _UPRIGHT_DEG:
        raise InputError(
            "The sheet's angles cannot be stated with errors: turned by 90 degrees about y, turns about x and z are one.",
            where="rig.laser.rotation_deg", value=list(angles), allowed=f"an angle about y {_UPRIGHT_DEG} degrees from ±90 or more",
            next_step="beambench.estimators.laser_line.calibrate.with_calibration sets the plane of a declared rig",
        )  # fmt: skip
    return {
        "camera.focal_length_m": camera.focal_px * pitch_m,
        "principal_offset_px.0": camera.row0 - 0.5 * (geometry.rows - 1),
        "principal_offset_px.1": camera.col0 - 0.5 * (geometry.cols - 1),
        **{f"distortion.{name}": k for name, k in zip(("k1", "k2", "p1", "p2", "k3"), camera.distortion, strict=True)},
        "port.stand_off_m": math.nan if port is None else port.stand_off_m,
        **{f"laser.position_m.{k}": float(at) for k, at in enumerate(sheet.source)},
        **{f"laser.rotation_deg.{k}": angle for k, angle in enumerate(angles)},
    }


def _scene_covariance(found: Adjusted, pitch_m: float, paths: Sequence[str]) -> Float:
    """C_s (paths, paths), by central differences of the scene's values."""
    slope = np.zeros((len(paths), len(found.names)))
    for k, name in enumerate(found.names):
        ends = []
        for sign in (1.0, -1.0):
            values = _scene_values(deviated(found.geometry, {name: sign * STEPS[name]}), pitch_m)
            ends.append(np.array([values[path] for path in paths]))
        away = ends[0] - ends[1]
        turn = np.array([path.startswith("laser.rotation_deg") for path in paths])
        away = np.where(turn, (away + 180.0) % 360.0 - 180.0, away)
        slope[:, k] = away / (2.0 * STEPS[name])
    made = slope @ found.covariance @ slope.T
    return np.asarray(0.5 * (made + made.T))


BOARDS = Procedure(
    "boards", "camera, port and plane of the sheet of a laser line, from captures of a checkerboard in air and in water", _lacking,
    _run,
)  # fmt: skip
