"""The check of designs reads wavefronts as it reads stacks."""

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


def test_phases_are_read() -> None:
    small = {
        "rig.lenslets.across": 8, "rig.pupil.diameter_m": 1.2e-3, "rig.pupil.modes": 10, "rig.camera.rows": 80,
        "rig.camera.cols": 80,
    }  # fmt: skip
    sums, answered = squares(load_scene("gated-turbulence", small), {}, (1,), None, "phase")
    assert answered > 0.5 and 0.0 < _rms(sums) < 3.0
