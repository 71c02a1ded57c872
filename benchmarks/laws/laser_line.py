"""What the laws run on for laser lines: a bright line in every row of the scene "spotscan-wall"."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from ...estimators.laser_line.board import Board
from ...optics.sheet import meeting
from ...scenes.load import load_scene
from ...scenes.medium_index import phase_index
from ...scenes.rigs.laser_line import laser_line_rig
from ...scenes.rigs.laser_line_geometry import line_camera, line_sheet
from ...scenes.scene import Scene
from ..written.laser_line import written_capture
from ..written.laser_line_board import board_capture
from ..written.laser_line_profiles import drawn_heights
from .maker import Laws

__all__ = ["LAWS", "clean_capture", "survey_capture"]

_ROWS = 48
_ELECTRONS, _WIDTH_PX, _BACKGROUND = 4e4, 0.75, 20.0
_CAMERA = {
    "rig.camera.cols": 96, "rig.detector.adc_bits": 12, "rig.detector.gain_dn_per_e": 0.05,
    "rig.detector.offset_dn": 100.0, "rig.detector.read_noise_e": 20.0, "rig.lens_sigma_px": 0.735,
}  # fmt: skip
_STATIONS = {
    "rig.camera.rows": 192, "rig.camera.cols": 240, "rig.camera.pixel_pitch_m": 25.6e-6, "rig.frames.lit": 5,
    "rig.frames.laser_off": 5,
}  # fmt: skip
#: Slope of the spectrum of the surveyed surface.
_SLOPE = 2.5
#: Photoelectrons of a white pixel of a board, and of the line on it in a row.
_WHITE, _LINE = 6e3, 2e4
#: Standard error of an inclinometer's reading.
_METER_DEG = 0.1
#: Columns by which the image is moved.
_SHIFT = 3


def clean_capture(seed: int = 1, light: float = 1.0, background: float = 1.0) -> xr.Dataset:
    """Two frames of 48 rows and 96 columns with lines of 40,000 photoelectrons, σ = .75 px, at columns 40 to 43.

    A converter of 12 bits, and an offset well above the noise, so that a count of 0 is a dead pixel.
    """
    scene = load_scene("spotscan-wall", _CAMERA | {"rig.camera.rows": _ROWS})
    column = 40.0 + 3.0 * np.linspace(0, 1, 2 * _ROWS).reshape(2, _ROWS)
    return _pointed(
        scene, written_capture(scene, light * _ELECTRONS, _WIDTH_PX, background * _BACKGROUND, column, seed=seed)
    )


def _pointed(scene: Scene, capture: xr.Dataset) -> xr.Dataset:
    """With the points where the rays through the true columns meet the sheet."""
    rig = laser_line_rig(scene)
    index = phase_index(scene.medium, rig.wavelength_m)
    camera, sheet = line_camera(rig, index), line_sheet(rig, index)
    column = capture["truth_column"].values
    row = np.broadcast_to(np.arange(float(column.shape[1]))[:, None], column.shape)
    point = np.moveaxis(meeting(*camera.rays(row, column), sheet.normal, sheet.source), 0, -1)
    return capture.assign(truth_point=capture["truth_point"].copy(data=point))


def level_capture(seed: int = 1, light: float = 1.0, background: float = 1.0) -> xr.Dataset:
    """`clean_capture` of a rig with inclinometers, pitched by 20 and rolled by -5 degrees, read within .1 degrees, 1 σ."""
    attitude = {"pitch": 20.0, "roll": -5.0}
    meter = {f"{name}_deg": angle for name, angle in attitude.items()} | {"sigma_deg": _METER_DEG}
    scene = load_scene(
        "spotscan-wall", _CAMERA | {"rig.camera.rows": _ROWS, "rig.inclinometers": {**meter, "bias_deg": [0.0, 0.0]}}
    )
    column = 40.0 + 3.0 * np.linspace(0, 1, 2 * _ROWS).reshape(2, _ROWS)
    capture = _pointed(
        scene, written_capture(scene, light * _ELECTRONS, _WIDTH_PX, background * _BACKGROUND, column, seed=seed)
    )
    read = {name: np.full(2, np.deg2rad(angle)) for name, angle in attitude.items()}
    noise = np.deg2rad(_METER_DEG) * np.random.default_rng(seed).standard_normal((2, 2))
    return capture.assign_coords(
        {name: ("frame", value + own, {"units": "rad"}) for (name, value), own in zip(read.items(), noise, strict=True)}
    )


def survey_capture(seed: int = 1, light: float = 1.0, background: float = 1.0) -> xr.Dataset:
    """Twelve frames of 144 rows, whose lines wander as a power law of slope 2.5 by some pixels: profiles of a rough surface."""
    scene = load_scene("spotscan-wall", _CAMERA | {"rig.camera.rows": 144, "rig.frames.lit": 12})
    rng = np.random.default_rng(seed)
    wander = drawn_heights(rng, 144, 1.0, _SLOPE, 3e-6, profiles=12, period=1152)
    return written_capture(
        scene, light * _ELECTRONS, _WIDTH_PX, background * _BACKGROUND, 45.0 + wander, seed=seed
    ).assign(
        truth_slope=(
            ("survey",),
            np.array([_SLOPE]),
            {"units": "1", "long_name": "slope of the surface's power spectrum"},
        )
    )


def stations_capture(seed: int = 1, light: float = 1.0, background: float = 1.0) -> xr.Dataset:
    """Five views of a board in air, 192 × 240 pixels each, with the line beside its squares and without."""
    return board_capture(
        load_scene("calibration-air", _STATIONS),
        Board(6, 9, 0.02, (0.095, 0.035)),
        place_m=(-0.03, 0.0, 0.6),
        white_e=light * _WHITE,
        line_e=light * _LINE,
        background=background * _BACKGROUND,
        seed=seed,
    )


def _later(capture: xr.Dataset) -> tuple[xr.Dataset, float]:
    return capture.assign(counts=capture["counts"].roll(col=_SHIFT)), float(_SHIFT)


def _step(capture: xr.Dataset) -> float:
    return 1.0


def _point_step(capture: xr.Dataset) -> float:
    """Metres per column of a point at about 1 m: R²/(F b n), .0116."""
    return 0.0116


def _slope_step(capture: xr.Dataset) -> float:
    """A column of light more or less in every row may change the slope of a spectrum by its own size."""
    return 1.0


def _node_step(capture: xr.Dataset) -> float:
    """Metres per column of a point at about .6 m, for pixels of 25.6 µm, f = 8 mm and b = .2 m: R²/(F b), .006."""
    return 0.006


def _converter(rig: dict[str, Any]) -> dict[str, Any]:
    part: dict[str, Any] = rig["detector"]
    return part


LAWS = Laws(
    (clean_capture,), "an image moved by whole columns, columns moved as far", _later, _step, _converter,
    {"triangulation": _point_step, "spectrum": _slope_step, "gravity": _point_step, "calibration": _node_step},
    {"spectrum": (survey_capture,), "gravity": (level_capture,), "calibration": (stations_capture,)},
)  # fmt: skip
