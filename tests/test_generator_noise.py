"""The variance of a camera's sample, by hand: of a bare sensor, behind a tube, at another exposure and gain."""

from __future__ import annotations

import numpy as np
import pytest

from beambench.generator.noise import noise_variance
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.parts import Detector

_OWN = {"rig.detector.dark_current_e_per_s": 200.0, "rig.detector.exposure_s": 0.05, "rig.detector.read_noise_e": 3.0}


def _detector(**changes: object) -> Detector:
    rig = load_scene("spotscan-wall", _OWN | {f"rig.detector.{key}": value for key, value in changes.items()}).rig
    detector: Detector = rig.detector
    return detector


def test_of_a_bare_sensor() -> None:
    """Light, 10 dark electrons, 9 of read noise, rounding 1/(12 K²); light below zero adds none."""
    found = noise_variance(_detector(gain_dn_per_e=0.25), np.array([-5.0, 0.0, 100.0]))
    np.testing.assert_allclose(found, np.array([0.0, 0.0, 100.0]) + 10.0 + 9.0 + 16.0 / 12.0, rtol=1e-12)


def test_at_another_exposure_and_gain() -> None:
    """Four times the exposure: 40 dark electrons. Twice the gain: a quarter of the rounding; read noise stays."""
    found = noise_variance(_detector(gain_dn_per_e=0.25), 100.0, exposure=4.0, gain=2.0)
    assert float(found) == pytest.approx(100.0 + 40.0 + 9.0 + 4.0 / 12.0, rel=1e-12)


def test_behind_a_tube() -> None:
    """F² of the light; what comes after the tube counts for 1/G²: (10 + 9 + 16/12)/50²."""
    tube = {"gain": 50.0, "excess_noise_factor": 2.0, "phosphor_sigma_px": 0.5}
    found = noise_variance(_detector(gain_dn_per_e=0.25, intensifier=tube), 100.0)
    assert float(found) == pytest.approx(200.0 + (10.0 + 9.0 + 16.0 / 12.0) / 2500.0, rel=1e-12)
