"""The check of designs reads every quantity that is designed for, and tells a better design from a worse one."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.checks.design import squares
from beambench.scenes.load import load_scene

pytestmark = pytest.mark.skipif(importlib.util.find_spec("mitsuba") is None, reason="Mitsuba is not installed")


def _rms(sums: Any) -> float:
    return float(np.sqrt(sums[:, 0].sum() / sums[:, 1].sum()))


def test_points_of_a_longer_baseline_are_better() -> None:
    """A baseline 1.2 times as long: errors of the depth fall by about as much."""
    scene = load_scene("spotscan-wall", {"rig.camera.rows": 64})
    laser = scene.rig.laser  # type: ignore[union-attr]
    longer = {"rig.laser.position_m": [1.2 * one for one in laser.position_m]}
    own, answered = squares(scene, {}, (1, 2), None, "point")
    other, also = squares(scene, longer, (1, 2), None, "point")
    assert answered > 0.9 and also > 0.9 and len(own) >= 8
    assert 1.05 < _rms(own) / _rms(other) < 1.4


def test_phases_are_read() -> None:
    small = {
        "rig.lenslets.across": 8, "rig.pupil.diameter_m": 1.2e-3, "rig.pupil.modes": 10, "rig.camera.rows": 80,
        "rig.camera.cols": 80,
    }  # fmt: skip
    sums, answered = squares(load_scene("gated-turbulence", small), {}, (1,), None, "phase")
    assert answered > 0.5 and 0.0 < _rms(sums) < 3.0
