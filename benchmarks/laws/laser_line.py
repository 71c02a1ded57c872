"""What the laws run on for laser lines: a bright line in every row of the scene "spotscan-wall"."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from ...scenes.load import load_scene
from ..written.laser_line import written_capture
from .maker import Laws

__all__ = ["LAWS", "clean_capture"]

_ROWS = 48
_ELECTRONS, _WIDTH_PX, _BACKGROUND = 4e4, 0.75, 20.0
#: Columns by which the image is moved.
_SHIFT = 3


def clean_capture(seed: int = 1) -> xr.Dataset:
    """Two frames of 48 rows and 96 columns with lines of 40,000 photoelectrons, σ = .75 px, at columns 40 to 43.

    A converter of 12 bits, and an offset well above the noise, so that a count of 0 is a dead pixel.
    """
    scene = load_scene(
        "spotscan-wall",
        {
            "rig.camera.rows": _ROWS, "rig.camera.cols": 96, "rig.detector.adc_bits": 12, "rig.detector.gain_dn_per_e": 0.05,
            "rig.detector.offset_dn": 100.0, "rig.detector.read_noise_e": 20.0, "rig.lens_sigma_px": 0.735,
        },
    )  # fmt: skip
    column = 40.0 + 3.0 * np.linspace(0, 1, 2 * _ROWS).reshape(2, _ROWS)
    return written_capture(scene, _ELECTRONS, _WIDTH_PX, _BACKGROUND, column, seed=seed)


def _later(capture: xr.Dataset) -> tuple[xr.Dataset, float]:
    return capture.assign(counts=capture["counts"].roll(col=_SHIFT)), float(_SHIFT)


def _step(capture: xr.Dataset) -> float:
    return 1.0


def _point_step(capture: xr.Dataset) -> float:
    """Metres per column of a point at about 1 m: R²/(F b n), .0116."""
    return 0.0116


def _converter(rig: dict[str, Any]) -> dict[str, Any]:
    part: dict[str, Any] = rig["detector"]
    return part


LAWS = Laws(
    (clean_capture,), "an image moved by whole columns, columns moved as far", _later, _step, _converter,
    {"triangulation": _point_step},
)  # fmt: skip
