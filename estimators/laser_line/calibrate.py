"""Calibration of a laser-line rig from captures of a checkerboard: camera, stand-off of the port and plane of the sheet.

Each capture is one view: the board at rest, frames with the laser and without. Corners come from the frames without, the line from
the difference. Views in air and through the port are adjusted together: in air the port hardly bends rays, and the camera's own
values show; in water the stand-off does. Thickness and indices of the glass are as declared.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...scenes.errors import InputError
from ..registry import run_estimator
from ..rig import read_rig
from .board import Board, find_board
from .board_pose import board_pose
from .bundle import Adjusted, View, adjust, flat_port
from .declared import CALIBRATED
from .geometry import declared_geometry

__all__ = ["board_view", "calibrate", "with_calibration"]

Float = npt.NDArray[np.float64]

#: Most points of a line that one view gives: more are as precise as the corners, and cost time.
_MOST_POINTS = 200
#: Height of a line over the noise of the frames with and without it.
_LEAST_SIGMAS = 8.0
#: Difference of the indices before and behind a port from which a view tells of its stand-off.
_BENDS = 0.01


def calibrate(
    captures: Sequence[xr.Dataset], board: Board, *, free: Sequence[str] | None = None, finder: str = "line-erf",
    blur_px: float = 1.0, radius_px: float = 4.0,
) -> Adjusted:  # fmt: skip
    """The rig from captures of a board, one view each, in air or through the port.

    Main arguments:
        captures: of one rig, declared to some percent: first values are those of the last capture
            (of the last one through a port, if there is one).
        board: its corners and the even surface beside them.
    Other arguments:
        free: parameters to find; None: all but k3, the stand-off only where a view looks through a port into another medium, the
            plane only where the line is seen. finder: label of the stage `line`. blur_px, radius_px: as of `saddle_places`.

    Raises InputError where a capture shows no whole board or changes its pose, and where the views leave something undetermined.
    """
    if not captures:
        raise InputError("A calibration needs captures.", where="calibrate", value=0, allowed="one or more")
    views = [board_view(one, board, finder=finder, blur_px=blur_px, radius_px=radius_px) for one in captures]
    behind = [capture for capture, view in zip(captures, views, strict=True) if view.port is not None] or captures
    start = declared_geometry(read_rig(behind[-1], str(behind[-1].attrs["modality"])))
    bends = any(view.port is not None and abs(view.port.outside - view.port.inside) > _BENDS for view in views)
    lines = any(view.row.size for view in views)
    if free is None:
        free = [
            name for name in CALIBRATED
            if name != "k3" and (bends or name != "stand_off_m") and (lines or not name.startswith(("turn_", "shift_")))
        ]  # fmt: skip
    return adjust(start, board, views, free)


def board_view(
    capture: xr.Dataset, board: Board, *, finder: str = "line-erf", blur_px: float = 1.0, radius_px: float = 4.0
) -> View:
    """What one capture shows of a board: corners, and points of the line where its plane is even. Arguments as of `calibrate`."""
    geometry = declared_geometry(read_rig(capture, str(capture.attrs["modality"])))
    on, off = _frames(capture)
    counts = capture["counts"]
    image = np.asarray(counts.values[off if off.size else on], np.float64).mean(axis=0)
    seen = find_board(image, board, blur_px=blur_px, radius_px=radius_px)
    empty = np.zeros(0)
    window = flat_port(geometry.camera.port)
    view = View(seen, window, empty, empty, empty)
    if not on.size:
        return view
    frames = np.asarray(counts.values[on], np.float64)
    top = read_rig(capture).converter("detector").saturation_dn
    # A pixel that is full in one frame is full in their mean.
    light = np.where((frames >= top).any(axis=0), np.inf, frames.mean(axis=0)).clip(max=top)
    row, col, sigma = _line(capture.isel(frame=on[:1]), light, image if off.size else None, finder)
    pose = board_pose(geometry.camera, board.points(), seen)
    origin, direction = geometry.camera.rays(row, col)
    along = ((pose.place[:, None] - origin) * pose.turn[:, 2:]).sum(axis=0) / (direction * pose.turn[:, 2:]).sum(axis=0)
    x, y, _ = pose.turn.T @ (origin + along * direction - pose.place[:, None])
    chosen = np.flatnonzero(board.blank(x, y))
    chosen = chosen[:: max(int(np.ceil(chosen.size / _MOST_POINTS)), 1)]
    return View(seen, window, row[chosen], col[chosen], sigma[chosen])


def _line(capture: xr.Dataset, light: Float, dark: Float | None, finder: str) -> tuple[Float, Float, Float]:
    """(rows, columns, standard errors) of the line in the difference of frames with and without it.

    The finder knows the noise of the difference without the light that both hold: what is not `_LEAST_SIGMAS` above the noise of
    both frames is left out here.
    """
    converter = read_rig(capture).converter("detector")
    lit = light if dark is None else light - dark + converter.offset_dn
    lit = np.where(light < converter.saturation_dn, lit, np.nan)  # a difference does not show that a pixel was full
    counts = capture["counts"]
    one = capture.assign(counts=(counts.dims, lit.astype(np.float32)[None], counts.attrs)).assign_attrs(averaged=True)
    found = run_estimator(finder, one)
    valid = found["valid"].values[0]
    row = np.broadcast_to(np.arange(valid.shape[0])[:, None], valid.shape)[valid]
    col, sigma = found["column"].values[0][valid], found["sigma"].values[0][valid]
    if dark is not None:
        at = np.clip(np.rint(col).astype(np.int64), 0, light.shape[1] - 1)
        both = np.maximum(light[row, at] + dark[row, at] - 2.0 * converter.offset_dn, 0.0) / converter.gain_dn_per_e
        noise = np.sqrt(both + 2.0 * converter.floor_e2) * converter.gain_dn_per_e
        kept = (light - dark)[row, at] > _LEAST_SIGMAS * noise
        row, col, sigma = row[kept], col[kept], sigma[kept]
    return row.astype(np.float64), col, sigma


def _frames(capture: xr.Dataset) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Numbers of the usable frames with the laser, and of those without. Raises InputError where the rig moves between them."""
    usable = np.asarray(capture["valid"].values, bool)
    on = np.asarray(capture["laser_on"].values, bool)
    pose = np.asarray(capture["pose"].values, np.float64)[usable]
    if not pose.size or np.ptp(pose, axis=0).max() > 0:
        raise InputError(
            "A view of a board needs usable frames of one pose.", where="pose", value=pose.tolist(),
            allowed="a rig at rest", next_step="make one capture of each pose",
        )  # fmt: skip
    for name in ("exposure", "gain"):
        own = np.asarray(capture[name].values, np.float64)[usable] if name in capture.coords else np.ones(1)
        if np.ptp(own) > 0:
            raise InputError(
                "A view of a board needs frames of one exposure and gain.", where=name, value=own.tolist(),
                allowed="equal values", next_step="take the board's frames with the automatic exposure off",
            )  # fmt: skip
    return np.flatnonzero(usable & on), np.flatnonzero(usable & ~on)


def with_calibration(rig: str, found: Adjusted) -> str:
    """A declared rig (JSON) with the values of a calibration and their covariance, which triangulation adds to its errors."""
    values = json.loads(rig)
    camera, sheet = found.geometry.camera, found.geometry.sheet
    values["camera"] |= {
        "focal_length_m": camera.focal_px * values["camera"]["pixel_pitch_m"], "principal_row_px": camera.row0,
        "principal_col_px": camera.col0, "distortion": list(camera.distortion),
    }  # fmt: skip
    window = flat_port(camera.port)
    if window is not None and values["port"]["kind"] == "flat":
        values["port"]["stand_off_m"] = window.stand_off_m
    values["laser"] |= {
        "position_m": sheet.source.tolist(),
        "normal": sheet.normal.tolist(),
        "axis": sheet.frame[:, 2].tolist(),
    }
    values["calibration"] = {"parameters": list(found.names), "covariance": found.covariance.tolist()}
    return json.dumps(values, allow_nan=False)
