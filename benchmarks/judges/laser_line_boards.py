"""The calibration of a laser-line rig as a laboratory does it, for the condition "calibrated": boards in air and before the target.

Boards of 9 × 6 corners are shown at random poses, half of them in air and half in the scene's medium (all in it where the camera
has no port), at distances about that of the target and as large as half of the view. Corners and the line on the board's plane
are those of the true instrument with the suite's noise; the adjustment through refraction then starts from the declared rig.
"""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ...estimators.laser_line.board import Board, SeenBoard
from ...estimators.laser_line.board_pose import BoardPose
from ...estimators.laser_line.bundle import View, flat_port
from ...estimators.laser_line.calibrate import adjusted, with_calibration
from ...estimators.laser_line.geometry import declared_geometry
from ...estimators.rig import DeclaredRig
from ...optics.pinhole import Pinhole
from ...optics.rotation import turned_by
from ...optics.sheet import Sheet
from ...scenes.errors import InputError
from ...scenes.medium_index import phase_index
from ...scenes.rigs.laser_line import laser_line_rig
from ...scenes.rigs.laser_line_geometry import line_camera, line_sheet
from ...scenes.scene import Scene
from ..suites.spec import Calibration
from ..written.laser_line_board import seen_line
from .judge import Draw

__all__ = ["board_calibration"]

Float = npt.NDArray[np.float64]

#: Kind of the random stream of this record; those of other kinds of instruments differ.
_BOARDS = 111
_ROWS, _COLS = 6, 9
#: Views in each medium, points of the line in each view.
_VIEWS, _POINTS = 8, 40
#: Index of air at the window.
_AIR = 1.00027
#: Most trials of a pose that keeps the board in view.
_TRIALS = 2000


def board_calibration(scene: Scene, rig: dict[str, Any], calibration: Calibration, draw: Draw) -> dict[str, Any]:
    """The declared rig after a calibration with boards; its error is a draw of the suite's noise."""
    true = laser_line_rig(scene)
    index = phase_index(scene.medium, true.wavelength_m)
    camera, sheet = line_camera(true, index), line_sheet(true, index)
    rng = draw(_BOARDS, 0)
    noise = calibration.of("corner_sigma_px"), calibration.of("line_sigma_px")
    distance = float(np.median([abs(item.shape.center_m[2]) for item in scene.target]))
    across = min(true.camera.rows, true.camera.cols) / camera.focal_px
    board = Board(_ROWS, _COLS, 0.5 * across * distance / _COLS)
    shown = [camera] * _VIEWS
    if camera.port is not None:
        shown += [replace(camera, port=replace(camera.port, outside=_AIR))] * _VIEWS
    size = true.camera.rows, true.camera.cols
    views = [_view(one, sheet, board, distance, size, noise, rng) for one in shown]
    text = json.dumps(rig)
    found = adjusted(declared_geometry(DeclaredRig(text, rig)), board, views)
    made: dict[str, Any] = json.loads(with_calibration(text, found))
    return made


def _view(
    camera: Pinhole, sheet: Sheet, board: Board, distance: float, size: tuple[int, int], noise: tuple[float, float],
    rng: np.random.Generator,
) -> View:  # fmt: skip
    """One view of the true instrument: corners within the image, and the line where its rays meet the board's plane."""
    middle = np.array([(_COLS - 1) / 2, (_ROWS - 1) / 2, 0.0]) * board.square_m
    for _ in range(_TRIALS):
        turn = turned_by(rng.uniform(-1.0, 1.0, 3) * [0.6, 0.6, 0.3])
        depth = distance * rng.uniform(0.75, 1.15)
        row, col = (rng.uniform(0.25, 0.75) * many for many in size)
        origin, direction = camera.rays(row, col)
        centre = origin + direction * (depth - origin[2]) / direction[2]
        pose = BoardPose(turn, centre - turn @ middle)
        seen = np.stack(camera.project(pose.of(board.points())), axis=1)
        inside = np.isfinite(seen).all() and seen.min() > 2 and (seen < np.array(size) - 3).all()
        if not inside:
            continue
        at = np.linspace(0.0, size[0] - 1.0, _POINTS)
        column = seen_line(camera, sheet, pose, at, size[1])
        good = (column > 2.0) & (column < size[1] - 3.0)
        if good.sum() >= _POINTS // 4:
            at, column = at[good], column[good]
            corners = SeenBoard(seen + noise[0] * rng.standard_normal(seen.shape), np.full(seen.shape, noise[0]))
            spread = np.full(at.size, noise[1])
            return View(corners, flat_port(camera.port), at, column + spread * rng.standard_normal(at.size), spread)
    raise InputError(
        "No pose of a board shows its corners and the laser's line: the instrument cannot be calibrated in this way.",
        where="calibration", value=f"{_TRIALS} random poses about {distance:.3g} m before the camera",
        allowed="a sheet that crosses the view about the target's distance", next_step='leave out the condition "calibrated"',
    )  # fmt: skip
