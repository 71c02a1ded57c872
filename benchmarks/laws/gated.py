"""What the laws run on for range-gated cameras: a flat wall's rig, with a strip of pixels at ranges 4 cm apart at most.

The view is narrow, so that corrections by the angle of a pixel, right or wrong, stay below every tolerance.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import xarray as xr

from ...optics.constants import C_M_PER_S
from ...scenes.load import load_scene
from ...scenes.medium_index import group_index
from ...scenes.rigs.gated import gated_rig
from ..written.gated import written_capture
from .maker import Laws

__all__ = ["LAWS", "clean_capture"]

_ROWS, _COLS = 4, 24
_ELECTRONS, _BACKGROUND = 4000.0, 4.0
_STEPS = 7


def clean_capture(seed: int = 1, light: float = 1.0, background: float = 1.0) -> xr.Dataset:
    """A bright capture (64, 4, 24) with its truth: 4000 photoelectrons at an open gate, 4 of background, or multiples."""
    scene = load_scene(
        "flat-wall",
        {"rig.camera.rows": _ROWS, "rig.camera.cols": _COLS, "rig.camera.focal_length_m": 1.0,
         "rig.laser.illumination.half_angle_rad": 1e-3},
    )  # fmt: skip
    rig = gated_rig(scene)
    middle = rig.delays.start_s + rig.delays.step_s * (rig.delays.count // 2)
    half = C_M_PER_S / (2 * group_index(scene.medium, rig.laser.wavelength_m))
    ranges = middle * half + 0.02 * np.linspace(-1, 1, _ROWS * _COLS).reshape(_ROWS, _COLS)
    return written_capture(scene, light * _ELECTRONS, background * _BACKGROUND, ranges, seed=seed)


def _step(capture: xr.Dataset) -> float:
    """Range per step of the delays, m."""
    index = float(json.loads(capture.attrs["rig"])["medium"]["group_index"])
    return float(np.diff(capture["delay"].values[:2])[0]) * C_M_PER_S / (2 * index)


def _later(capture: xr.Dataset) -> tuple[xr.Dataset, float]:
    delay = capture["delay"]
    moved = delay + _STEPS * float(np.diff(delay.values[:2])[0])
    return capture.assign_coords(delay=moved.assign_attrs(delay.attrs)), _STEPS * _step(capture)


def _converter(rig: dict[str, Any]) -> dict[str, Any]:
    part: dict[str, Any] = rig["detector"]
    return part


LAWS = Laws((clean_capture,), "later delays, farther ranges", _later, _step, _converter)
