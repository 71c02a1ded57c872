"""What the laws run on for amplitude-modulated rangers: the rig of the scene "amcw"."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import xarray as xr

from ...optics.constants import C_M_PER_S
from ...scenes.load import load_scene
from ..written.amcw import written_capture
from .maker import Laws

__all__ = ["LAWS", "clean_capture"]

_SHOTS = 48
_ELECTRONS, _BACKGROUND = 2e4, 3.0
#: A fraction of a cycle of every modulation; no range of `clean_capture` leaves its cycle of the shortest one.
_DELAY_S = 1e-9


def clean_capture(seed: int = 1, light: float = 1.0, background: float = 1.0) -> xr.Dataset:
    """A bright capture (48, 3, 4) with its truth: 20,000 photoelectrons in a sample, 3 of background."""
    scene = load_scene("amcw", {"rig.shots": _SHOTS})
    return written_capture(
        scene, light * _ELECTRONS, background * _BACKGROUND, 4.0 + 0.1 * np.linspace(0, 1, _SHOTS), seed=seed
    )


def _half(rig: dict[str, Any]) -> float:
    """Range per travel time, m/s."""
    return C_M_PER_S / (2 * float(rig["medium"]["group_index"]))


def _step(capture: xr.Dataset) -> float:
    """Range per step of the phase at the highest frequency, m."""
    return _half(json.loads(capture.attrs["rig"])) / float(capture["frequency"].max()) / capture.sizes["phase"]


def _later(capture: xr.Dataset) -> tuple[xr.Dataset, float]:
    rig = json.loads(capture.attrs["rig"])
    rig["t0_s"] += _DELAY_S
    return capture.assign_attrs(rig=json.dumps(rig)), _DELAY_S * _half(rig)


def _converter(rig: dict[str, Any]) -> dict[str, Any]:
    part: dict[str, Any] = rig["detector"]
    return part


LAWS = Laws((clean_capture,), "a later zero of time, farther ranges", _later, _step, _converter)
