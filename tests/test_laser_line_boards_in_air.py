"""The condition "calibrated" of a laser line before a window with air on both sides."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beambench.benchmarks.judges import judge_of
from beambench.benchmarks.suites.suite import load_suite
from beambench.scenes.declared import declared_rig


def test_a_port_in_air_keeps_its_declared_stand_off() -> None:
    """With air on both sides a window hardly bends rays: its distance cannot be calibrated, and was found at -373 m."""
    loaded = load_suite("laser-line")
    scene = dict(loaded.scenes)["air"]
    made = judge_of("laser_line").calibrate
    assert made is not None and loaded.suite.calibration is not None
    declared = json.loads(json.dumps(declared_rig(scene)))
    rig = made(scene, declared, loaded.suite.calibration, lambda kind, index: np.random.default_rng((kind, index)))
    assert rig["port"]["stand_off_m"] == declared["port"]["stand_off_m"]
    assert rig["camera"]["focal_length_m"] == pytest.approx(declared["camera"]["focal_length_m"], rel=0.01)
