"""The simulated calibration: records of the true waveforms, and the declared rig that is made from them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beambench.benchmarks.calibrate import calibrated_rig, record_gate, record_pulse
from beambench.benchmarks.suite_spec import Calibration
from beambench.estimators.response import correlate_samples
from beambench.optics import waveforms
from beambench.scenes.declare import declared_rig
from beambench.scenes.load import load_scene


def calibration(photons: float, seed: int = 1) -> Calibration:
    return Calibration(pulse_photoelectrons=photons, gate_photoelectrons=photons / 100, seed=seed)


def test_records_hold_the_stated_light() -> None:
    rng = np.random.default_rng(1)
    time, counts = record_pulse(waveforms.ExponentialPulse(1e-9, 0.8e-9), 2e-11, 1e6, rng)
    dark = 1e-3 * counts.max() * counts.size
    assert counts.sum() - dark == pytest.approx(1e6, abs=5 * 1e3 + 0.1 * dark)  # 5 standard errors of a Poisson sum
    # The clock's zero is the centroid: its standard error is σ/√N, 1 ns/1000; the dark level adds its own.
    light = counts - 1e-3 * counts.max()
    assert (light * time).sum() / light.sum() == pytest.approx(0.0, abs=2e-11)
    delay, scan = record_gate(waveforms.RectangularGate(2e-9, 0.8), 2e-11, 1e4, rng)
    inside = (delay > 1e-10) & (delay < 1.9e-9)
    assert scan[inside].mean() == pytest.approx(0.8 * 1e4 * 1.001, rel=5 / np.sqrt(8e3 * inside.sum()))
    assert scan[delay < -1e-10].mean() == pytest.approx(8.0, rel=0.2)


def test_a_better_calibration_comes_nearer_to_the_truth() -> None:
    scene = load_scene("relief-tank")
    declared = json.dumps(declared_rig(scene))
    exact = correlate_samples(json.loads(declared)["pulse"], json.loads(declared)["gates"][0])

    def error(photons: float) -> float:
        shifts = []
        for seed in range(12):
            rig = json.loads(calibrated_rig(scene, declared, calibration(photons, seed)))
            found = correlate_samples(rig["pulse"], rig["gates"][0])
            shifts.append(found.centroid_s - exact.centroid_s)
        return float(np.sqrt(np.mean(np.square(shifts))))

    poor, good = error(1e4), error(1e7)
    assert good < poor / 3  # noise falls by √1000; what remains is the cut of the support and the smoothing
    assert good < 5e-12


def test_only_pulse_and_gates_change_and_equal_seeds_agree() -> None:
    scene = load_scene("flat-wall")
    before = declared_rig(scene)
    text = json.dumps(before)
    once, again = (calibrated_rig(scene, text, calibration(1e5)) for _ in range(2))
    assert once == again
    assert once != calibrated_rig(scene, text, calibration(1e5, seed=2))
    after = json.loads(once)
    for name in before:
        if name not in ("pulse", "gates"):
            assert after[name] == json.loads(text)[name]
    pulse = after["pulse"]
    assert sum(pulse["value"]) * pulse["step_s"] == pytest.approx(1.0, rel=1e-6)
    assert len(after["gates"]) == len(before["gates"])


def test_the_true_waveform_is_recorded_not_the_declared_one() -> None:
    # A wrong pulse is declared; whoever calibrates finds the true one.
    scene = load_scene("flat-wall", {"declared": {"laser.pulse.fwhm_s": 3e-9}})
    wrong = declared_rig(scene)
    found = json.loads(calibrated_rig(scene, json.dumps(wrong), calibration(1e6)))
    true = declared_rig(load_scene("flat-wall"))
    width = [correlate_samples(r["pulse"], r["gates"][0]).variance_s2 ** 0.5 for r in (true, found, wrong)]
    assert width[1] == pytest.approx(width[0], rel=0.02)
    assert width[2] > 1.5 * width[0]
