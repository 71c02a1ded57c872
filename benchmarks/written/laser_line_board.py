"""Captures of a checkerboard before a laser-line rig from closed forms: edges blurred by the lens, and a Gaussian line beside them.

Each pixel's ray, refracted exactly, meets the board at (x, y). With p the distance of neighbouring corners, the light there is

    ρ ½ (1 − κ q(x) q(y)),   q = Π_k erf(d_k/(√2 s)),   s² = s_lens² + 1/12,

d_k the distances [px] to the edges of the squares along x or y, and κ = 1 on the squares; s holds the pixel's own width. Lens and
pixel are those of an edge that is straight over some pixels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.special import erf, ndtr

from ...captures.build import make_capture
from ...estimators.laser_line.board import Board
from ...estimators.laser_line.board_pose import BoardPose
from ...optics.pinhole import Pinhole
from ...optics.rotation import turned_by
from ...optics.sheet import Sheet, meeting
from ...scenes.declared import declared_rig
from ...scenes.medium_index import phase_index
from ...scenes.rigs.laser_line import laser_line_rig
from ...scenes.rigs.laser_line_geometry import line_camera, line_sheet
from ...scenes.scene import Scene
from ..bounds.laser_line import line_noise
from .draw import drawn_counts, generator, truth_attributes

__all__ = ["board_capture", "board_poses", "seen_line"]

Float = npt.NDArray[np.float64]

#: Light of black squares over that of white ones.
_BLACK = 0.1


def board_poses(board: Board, stations: Float, place: Float) -> tuple[BoardPose, ...]:
    """Poses in the camera of each station (n, 6) of a board at rest that faces −z, its middle at `place` (3) [m]."""
    corner = board.points().mean(axis=0)
    turns = [turned_by(station[3:]) for station in stations]
    return tuple(
        BoardPose(turn.T, turn.T @ (place - corner - station[:3]))
        for turn, station in zip(turns, stations, strict=True)
    )


def seen_line(camera: Pinhole, sheet: Sheet, pose: BoardPose, row: Float, cols: int) -> Float:
    """Columns [px] at `row` (n) where the sheet's plane meets the board's, by Newton's method; NaN where that is not within the
    `cols` columns of the image."""
    col = np.full(row.size, 0.5 * cols)

    def apart(at: Float) -> Float:
        origin, direction = camera.rays(row, np.clip(at, 0.0, cols - 1.0))
        return sheet.offset(meeting(origin, direction, pose.turn[:, 2], pose.place))

    for _ in range(20):
        u = apart(col)
        with np.errstate(invalid="ignore", divide="ignore"):
            col = np.clip(col - u * 1e-3 / (apart(col + 1e-3) - u), 0.0, cols - 2.0)
    return np.where(np.abs(apart(col)) < 1e-9, col, np.nan)


def board_capture(
    scene: Scene, board: Board, *, place_m: tuple[float, float, float], white_e: float = 6e3, line_e: float = 2e4,
    width_px: float = 0.75, blur_px: float = 0.6, background: float = 20.0, seed: int | None = None,
) -> xr.Dataset:  # fmt: skip
    """A capture of a board at rest from the stations of the scene's rig, half of its frames with the laser.

    Main arguments:
        place_m: middle of the board's corners; the board faces −z. white_e, line_e [photoelectrons]: of a white pixel, and of the
            line in a row. width_px, blur_px [px, 1 σ]: of the line, and of the lens.
    Other arguments:
        seed: of the noise; None gives the mean itself, as float32 without rounding.

    Truth is the columns and points of the line on the board. Raises InputError for a scene of another modality.
    """
    rig = laser_line_rig(scene)
    index = phase_index(scene.medium, rig.wavelength_m)
    camera, sheet = line_camera(rig, index), line_sheet(rig, index)
    rows, cols = rig.camera.rows, rig.camera.cols
    stations = np.asarray(rig.stations or ((0.0,) * 6,), np.float64)
    number = np.concatenate([np.arange(many) % len(stations) for many in (rig.frames.lit, rig.frames.laser_off)])
    on = np.arange(number.size) < rig.frames.lit
    poses = board_poses(board, stations, np.array(place_m))
    even = np.stack([_image(camera, board, pose, rows, cols, float(np.hypot(blur_px, 12**-0.5))) for pose in poses])
    column = np.stack([seen_line(camera, sheet, pose, np.arange(float(rows)), cols) for pose in poses])
    edge = np.arange(cols + 1) - 0.5
    line = np.nan_to_num(np.diff(ndtr((edge - column[..., None]) / width_px), axis=-1))
    mean = background + even[number] * (white_e + np.where(on[:, None, None], line_e * line[number], 0.0))
    noise = line_noise(rig)
    counts: Any = (mean * noise.gain_dn_per_e + noise.offset_dn).astype(np.float32)
    if seed is not None:
        counts = drawn_counts(mean, noise, generator(seed))
    shown = np.where(on[:, None], column[number], np.nan)
    point = np.stack([_points(camera, pose, column[k], rows) for k, pose in enumerate(poses)])[number]
    return make_capture(
        "laser_line",
        data={"counts": counts},
        coords={
            "time": rig.frames.interval_s * np.arange(number.size), "laser_on": on, "valid": True, "pose": stations[number],
        },
        truth={"truth_column": shown[..., None], "truth_point": np.where(on[:, None, None], point, np.nan)[:, :, None]},
        attrs=truth_attributes(scene, declared_rig(scene)) | ({"averaged": True} if seed is None else {}),
    )  # fmt: skip


def _points(camera: Pinhole, pose: BoardPose, column: Float, rows: int) -> Float:
    origin, direction = camera.rays(np.arange(float(rows)), np.nan_to_num(column))
    point = meeting(origin, direction, pose.turn[:, 2], pose.place)
    return np.asarray(np.where(np.isfinite(column), point, np.nan).T)


def _image(camera: Pinhole, board: Board, pose: BoardPose, rows: int, cols: int, blur_px: float) -> Float:
    """Light (rows, cols) of the board and of its even plane, 1 where it is white."""
    row, col = np.meshgrid(np.arange(float(rows)), np.arange(float(cols)), indexing="ij")
    origin, direction = camera.rays(row, col)
    point = meeting(origin, direction, pose.turn[:, 2], pose.place)
    place = np.tensordot(pose.turn.T, point - pose.place[:, None, None], axes=1)
    wave, inside = np.ones((rows, cols)), np.ones((rows, cols))
    for at, count in ((place[0], board.cols), (place[1], board.rows)):
        per_px = np.hypot(*np.gradient(at))

        def step(where: float, at: Float = at, per_px: Float = per_px) -> Float:
            return np.asarray(erf((at - where * board.square_m) / per_px / (np.sqrt(2.0) * blur_px)))

        wave = wave * np.prod([step(float(k)) for k in range(count)], axis=0)
        inside = inside * 0.25 * (1.0 + step(-1.0)) * (1.0 - step(float(count)))
    square = 0.5 * (1.0 + _BLACK) + 0.5 * (1.0 - _BLACK) * wave
    return np.asarray(inside * square + (1.0 - inside))
