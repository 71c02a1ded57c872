"""What the laws run on for pulsed rangers: the analog rig of the scene "counter", and one that counts single photons."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import xarray as xr

from ...optics.constants import C_M_PER_S
from ...scenes.load import load_scene
from ...scenes.medium_index import group_index
from ...scenes.rigs.waveform import waveform_rig
from ..written.waveform import written_capture
from .maker import Laws

__all__ = ["LAWS", "clean_capture", "counted_capture"]

_SHOTS = 48
_ELECTRONS, _BACKGROUND = 4000.0, 4.0
#: Later samples, and later starts of all records: whole cycles of a counter at 1 GHz, so that its steps stay where they are.
_DELAY_S, _START_S = 1e-9, 2e-9


def clean_capture(seed: int = 1, light: float = 1.0, background: float = 1.0) -> xr.Dataset:
    """A bright analog capture (48, 128) with its truth: 4000 photoelectrons in an echo, 4 in a sample of background."""
    scene = load_scene("counter", {"rig.record.shots": _SHOTS, "rig.laser.energy_fluctuation": 0.0})
    return written_capture(
        scene, light * _ELECTRONS, background * _BACKGROUND, 4.0 + 0.1 * np.linspace(0, 1, _SHOTS), seed=seed
    )


def counted_capture(seed: int = 1, light: float = 1.0, background: float = 1.0) -> xr.Dataset:
    """The same light (48, 160), counted photon by photon: no dead time, and so many pulses that no count hides another."""
    changes = {
        "rig.record.shots": _SHOTS, "rig.pulses_per_shot": 65535, "rig.detector.readout.dead_time_s": 0.0,
    }  # fmt: skip
    scene = load_scene("single-photon", changes)
    rig = waveform_rig(scene)
    half = C_M_PER_S / (2 * group_index(scene.medium, rig.laser.wavelength_m))
    ranges = (rig.record.start_s + 4e-9) * half + 0.1 * np.linspace(0, 1, _SHOTS)
    return written_capture(scene, light * _ELECTRONS, background * _BACKGROUND, ranges, seed=seed)


def _half(capture: xr.Dataset) -> float:
    """Range per travel time, m/s."""
    return C_M_PER_S / (2 * float(json.loads(capture.attrs["rig"])["medium"]["group_index"]))


def _step(capture: xr.Dataset) -> float:
    """Range per sampling interval, m."""
    return float(np.diff(capture["time"].values[:2])[0]) * _half(capture)


def _later(capture: xr.Dataset) -> tuple[xr.Dataset, float]:
    time = capture["time"]
    attrs = {"units": "s", "long_name": "start of the shot's record: added to `time`"}
    start = ("shot", np.full(capture.sizes["shot"], _START_S), attrs)
    moved = capture.assign_coords(time=(time + _DELAY_S).assign_attrs(time.attrs), start=start)
    return moved, (_DELAY_S + _START_S) * _half(capture)


def _converter(rig: dict[str, Any]) -> dict[str, Any] | None:
    readout: dict[str, Any] = rig["detector"]["readout"]
    return readout if "gain_dn_per_e" in readout else None


LAWS = Laws((clean_capture, counted_capture), "a later zero of time, farther ranges", _later, _step, _converter)
