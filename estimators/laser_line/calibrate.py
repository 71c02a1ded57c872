"""Calibration of a laser-line rig from captures of a checkerboard: camera, stand-off of the port and plane of the sheet.

A view is the board at rest before the rig at rest, in frames with the laser and without: a capture is one view, or as many as there
are places at which the rig stood. Corners come from the frames without, the line from the difference. Views in air and through
the port are adjusted together: in air the port hardly bends rays, and the camera's own values show; in water the stand-off
does. Thickness and indices of the glass are as declared.
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
from .board_scale import check_scale
from .bundle import Adjusted, View, adjust, flat_port
from .declared import CALIBRATED
from .frames import Scale
from .geometry import Geometry, declared_geometry

__all__ = ["adjusted", "board_view", "calibrate", "with_calibration"]

Float = npt.NDArray[np.float64]

#: Most points of a line that one view gives: more are as precise as the corners, and cost time.
_MOST_POINTS = 200
#: Height of a line over the noise of the frames with and without it.
_LEAST_SIGMAS = 8.0
#: Difference of the indices before and behind a port from which a view tells of its stand-off.
_BENDS = 0.01


def calibrate(
    captures: Sequence[xr.Dataset], board: Board, *, free: Sequence[str] | None = None, finder: str = "line-erf",
    blur_px: float = 1.0, radius_px: float = 4.0, port: str = "declared", least_views: int | None = None,
    held: Sequence[str] = (),
) -> Adjusted:  # fmt: skip
    """The rig from captures of a board, in air or through the port; a view for each place at which the rig stood.

    Main arguments:
        captures: of one rig, declared to some percent: first values are those of the last capture
            (of the last one through a port, if there is one).
        board: its corners and the even surface beside them.
    Other arguments:
        free, held, port: as of `adjusted` and `declared_geometry`. finder: label of the stage `line`. blur_px, radius_px: as of
            `saddle_places`. least_views: views without a whole board are left out if as many are left; None: every view shows it.

    Raises InputError where a capture shows no whole board, where the views leave something undetermined, and where the squares
    are not as large as stated, as far as the rig's poses tell.
    """
    if not captures:
        raise InputError("A calibration needs captures.", where="calibrate", value=0, allowed="one or more")
    seen = [
        _views(one, board, least_views, finder=finder, blur_px=blur_px, radius_px=radius_px, port=port)
        for one in captures
    ]
    views = [view for own in seen for view, _ in own]
    behind = [capture for capture, own in zip(captures, seen, strict=True) if any(v.port is not None for v, _ in own)]
    last = (behind or captures)[-1]
    start = declared_geometry(read_rig(last, str(last.attrs["modality"])), port=port)
    found = adjusted(start, board, views, free, held=held if port == "declared" else (*held, "stand_off_m"))
    first = 0
    # The places of a camera without its port's stand-off are off by centimetres, and tell nothing of the squares.
    for own in seen if port == "declared" else ():
        last_one = first + len(own)
        covariance = found.pose_covariance[6 * first : 6 * last_one, 6 * first : 6 * last_one]
        check_scale(board, found.poses[first:last_one], np.stack([station for _, station in own]), covariance)
        first = last_one
    return found


def adjusted(
    start: Geometry, board: Board, views: Sequence[View], free: Sequence[str] | None = None, *, held: Sequence[str] = ()
) -> Adjusted:
    """`bundle.adjust` of what the views can tell.

    Other arguments:
        free: parameters to find; None: all but k3, the stand-off only where a view looks through a port into another medium, the
            plane only where the line is seen. held: of these, those that stay as declared.
    """
    bends = any(view.port is not None and abs(view.port.outside - view.port.inside) > _BENDS for view in views)
    lines = any(view.row.size for view in views)
    if free is None:
        silent = {"k3", *held} | (set() if bends else {"stand_off_m"})
        free = [
            name for name in CALIBRATED if name not in silent and (lines or not name.startswith(("turn_", "shift_")))
        ]
    return adjust(start, board, views, free)


def _views(
    capture: xr.Dataset, board: Board, least: int | None, *, finder: str, blur_px: float, radius_px: float, port: str
) -> list[tuple[View, Float]]:
    """(view, pose (6) of the rig) of every place at which the rig stood, in the order of the frames."""
    usable = np.asarray(capture["valid"].values, bool)
    pose = np.asarray(capture["pose"].values, np.float64)
    stations = list(dict.fromkeys(map(tuple, pose[usable].tolist())))
    made: list[tuple[View, Float]] = []
    refused: list[InputError] = []
    for station in stations:
        here = np.flatnonzero(usable & (pose == station).all(axis=1))
        own = capture.isel(frame=here) if len(stations) > 1 else capture
        try:
            view = board_view(own, board, finder=finder, blur_px=blur_px, radius_px=radius_px, port=port)
        except InputError as error:
            if least is None:
                raise
            refused.append(error)
        else:
            made.append((view, np.array(station)))
    if least is not None and len(made) < least:
        raise InputError(
            "Too few views show the whole board.", where="calibrate", value=f"{len(made)} of {len(stations)} views",
            allowed=f"{least} views or more, from different places",
            next_step=f"the first of the others: {refused[0].what}" if refused else "show the board from more places",
        )  # fmt: skip
    return made


def board_view(
    capture: xr.Dataset, board: Board, *, finder: str = "line-erf", blur_px: float = 1.0, radius_px: float = 4.0,
    port: str = "declared",
) -> View:  # fmt: skip
    """What a capture of a rig at rest shows of a board: corners, and points of the line where its plane is even. Arguments as of
    `calibrate`.

    Raises InputError where the rig moves, where no whole board is seen, and where a corner's window holds a pixel that is no
    datum: full, dead or no number.
    """
    rig = read_rig(capture, str(capture.attrs["modality"]))
    geometry = declared_geometry(rig, port=port)
    on, off = _frames(capture)
    scale = Scale.of(rig)
    gain = float(capture["gain"].values[0]) if "gain" in capture.coords else 1.0
    top, dead = (float(ends(np.array([gain]))[0]) for ends in (scale.tops_dn, scale.deads_dn))
    image = _mean(capture, off if off.size else on, top, dead)
    seen = find_board(image, board, blur_px=blur_px, radius_px=radius_px)
    empty = np.zeros(0)
    window = flat_port(geometry.camera.port)
    view = View(seen, window, empty, empty, empty)
    if not on.size:
        return view
    light = _mean(capture, on, top, dead)
    row, col, sigma = _line(capture.isel(frame=on[:1]), light, image if off.size else None, finder)
    pose = board_pose(geometry.camera, board.points(), seen)
    origin, direction = geometry.camera.rays(row, col)
    along = ((pose.place[:, None] - origin) * pose.turn[:, 2:]).sum(axis=0) / (direction * pose.turn[:, 2:]).sum(axis=0)
    x, y, _ = pose.turn.T @ (origin + along * direction - pose.place[:, None])
    chosen = np.flatnonzero(board.blank(x, y))
    chosen = chosen[:: max(int(np.ceil(chosen.size / _MOST_POINTS)), 1)]
    return View(seen, window, row[chosen], col[chosen], sigma[chosen])


def _mean(capture: xr.Dataset, frames: npt.NDArray[np.int64], top_dn: float, dead_dn: float) -> Float:
    """Mean counts (row, col) of some frames; NaN where one of them holds no datum: a difference does not show a full pixel."""
    counts = np.asarray(capture["counts"].values[frames], np.float64)
    with np.errstate(invalid="ignore"):
        good = (np.isfinite(counts) & (counts < top_dn) & (counts > dead_dn)).all(axis=0)
    return np.where(good, counts.mean(axis=0), np.nan)


def _line(capture: xr.Dataset, light: Float, dark: Float | None, finder: str) -> tuple[Float, Float, Float]:
    """(rows, columns, standard errors) of the line in the difference of frames with and without it.

    The finder knows the noise of the difference without the light that both hold: what is not `_LEAST_SIGMAS` above the noise of
    both frames is left out here.
    """
    converter = read_rig(capture).converter("detector")
    lit = light if dark is None else light - dark + converter.offset_dn
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
        with np.errstate(invalid="ignore"):
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
