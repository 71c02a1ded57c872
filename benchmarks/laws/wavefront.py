"""What the laws run on for wavefronts: 48 frames of bright spots behind 4 × 4 lenslets."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import xarray as xr

from ...optics.lenslets.gradients import mean_gradients, square
from ...scenes.load import load_scene
from ...scenes.rigs.wavefront import wavefront_rig
from ...scenes.rigs.wavefront_geometry import lattice_of
from ..written.wavefront import written_capture
from .maker import Laws

__all__ = ["LAWS", "clean_capture"]

_FRAMES, _ELECTRONS, _BACKGROUND = 48, 1.5e3, 2.0
#: Greatest Noll index of the wavefront, and how far it moves the spots, rms.
_MODES, _PIXELS = 6, 0.2
#: Pixels by which the camera is moved.
_SHIFT = 2


def clean_capture(seed: int = 1) -> xr.Dataset:
    """48 frames of 4 × 4 lenslets, 1,500 photoelectrons each, moved by .2 px rms by slopes of the modes that are fitted.

    A converter of 12 bits, and an offset well above the noise, so that a count of 0 is a dead pixel.
    """
    scene = load_scene(
        "gated-turbulence",
        {
            "rig.lenslets.across": 4, "rig.pupil.diameter_m": 0.75e-3, "rig.pupil.modes": _MODES, "rig.pupil.least_fill": 0.6,
            "rig.pupil.samples": 4, "rig.camera.rows": 48, "rig.camera.cols": 48, "rig.frames.count": _FRAMES,
            "rig.detector.intensifier": None, "rig.detector.gain_dn_per_e": 2.0, "rig.detector.read_noise_e": 5.0,
            "rig.detector.dark_current_e_per_s": 0.0,
        },
    )  # fmt: skip
    rig = wavefront_rig(scene)
    lattice, radius = lattice_of(rig), 0.5 * rig.pupil.diameter_m
    centre = np.stack([lattice.x_m, lattice.y_m], axis=1)
    gradient = mean_gradients(range(2, _MODES + 1), centre, square(rig.lenslets.pitch_m), radius)
    coefficient = np.random.default_rng(7).standard_normal((_FRAMES, _MODES - 1))
    slope = np.einsum("laj,fj->fla", gradient, coefficient) * rig.wavelength_m / (2.0 * np.pi)
    return written_capture(scene, _ELECTRONS, _BACKGROUND, slope * _PIXELS * _slope_step(None) / slope.std(), seed=seed)


def _later(capture: xr.Dataset) -> tuple[xr.Dataset, float]:
    """The camera moved by whole pixels behind the lenslets: all images, and where the rig declares their spots."""
    rig = json.loads(capture.attrs["rig"])
    for name in ("row_px", "col_px"):
        rig["lenslets"][name] = [value + _SHIFT for value in rig["lenslets"][name]]
    moved = {name: capture[name].roll(row=_SHIFT, col=_SHIFT) for name in ("counts", "reference")}
    return capture.assign(moved).assign_attrs(rig=json.dumps(rig)), float(_SHIFT)


def _step(capture: xr.Dataset) -> float:
    return 1.0


def _slope_step(capture: xr.Dataset | None) -> float:
    """Slope of a pixel, p/f."""
    return 17.8e-6 / 6.7e-3


def _mode_step(capture: xr.Dataset) -> float:
    """Tilt coefficient [rad rms] of a slope of a pixel: k s D/4."""
    return 2.0 * np.pi / 532e-9 * 17.8e-6 / 6.7e-3 * 0.75e-3 / 4.0


def _converter(rig: dict[str, Any]) -> dict[str, Any]:
    part: dict[str, Any] = rig["detector"]
    return part


LAWS = Laws(
    (clean_capture,), "camera and declared lenslets moved by whole pixels, spots moved as far", _later, _step, _converter,
    {"assignment": _slope_step, "reconstruction": _mode_step},
)  # fmt: skip
