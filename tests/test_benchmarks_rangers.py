"""Waveform and AMCW captures through bounds, scores, calibration and the runner."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm

from beambench.benchmarks.bounds.amcw import amcw_bound
from beambench.benchmarks.bounds.profiled import profiled_sigma
from beambench.benchmarks.bounds.waveform import waveform_bound
from beambench.benchmarks.judges.bound import bound_of
from beambench.benchmarks.judges.calibrate import calibrated_rig
from beambench.benchmarks.run import run_suite
from beambench.benchmarks.suites.spec import Calibration
from beambench.benchmarks.suites.suite import load_suite
from beambench.captures.example import example_capture
from beambench.generator.generate import generate
from beambench.optics.constants import C_M_PER_S
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

STILL = {"rig.laser.energy_fluctuation": 0.0, "rig.record.shots": 4, "rig.record.scan_half_angle_rad": 0.0}


def test_bound_of_a_dense_gaussian_record_is_its_closed_form() -> None:
    # Poisson counts of a dense Gaussian echo without background: cσ_t/(2n√N).
    changes = STILL | {"rig.ambient_e_per_s": 0.0, "rig.detector.dark_e_per_s": 1e2, "rig.record.step_s": 5e-11,
                       "rig.record.samples": 512, "rig.detector.readout.read_noise_e": 0.0,
                       "rig.detector.readout.gain_dn_per_e": 4.0, "rig.detector.readout.adc_bits": 16}  # fmt: skip
    capture = generate(load_scene("counter", changes), seed=1)
    bound = waveform_bound(capture)
    index = json.loads(capture.attrs["rig"])["medium"]["group_index"]
    sigma_t = np.hypot(1e-9 / 2.3548, 3e-10 / 2.5631)
    exact = C_M_PER_S * sigma_t / (2 * index * np.sqrt(capture["truth_amplitude"].values))
    # Sampling at σ/9 costs (Δ/σ)²/12 = 1e-3; rounding to a quarter electron costs little more.
    np.testing.assert_allclose(bound.sigma, exact, rtol=5e-3)
    assert bound.kind == "exact" and bound.scale == pytest.approx(C_M_PER_S * sigma_t / (2 * index), rel=2e-3)


#: Steps of 4.6 σ of the echo, no noise but that of the light, a wall that the shots scan.
COARSE = {
    "rig.laser.energy_fluctuation": 0.0, "rig.record.shots": 16, "rig.ambient_e_per_s": 1.0e9, "rig.detector.dark_e_per_s": 0.0,
    "rig.record.step_s": 2e-9, "rig.record.samples": 16, "rig.detector.readout.read_noise_e": 0.0,
    "rig.detector.readout.gain_dn_per_e": 4.0, "rig.detector.readout.adc_bits": 16,
}  # fmt: skip


def _coarse_bound(place: np.ndarray, light: float, level: float, step: float, sigma: float) -> float:
    """Bound on the place [in the unit of `place`] of a Gaussian whose samples at `place` (relative to it) each hold its integral
    over one step: Poisson counts, height and level unknown."""
    low, high = (place - step / 2) / sigma, (place + step / 2) / sigma
    share = norm.cdf(high) - norm.cdf(low)
    slope = (norm.pdf(low) - norm.pdf(high)) / sigma
    gradient = np.stack([light * slope, share, np.ones_like(share)])
    return float(np.sqrt(np.linalg.inv((gradient / (light * share + level)) @ gradient.T)[0, 0]))


def test_bound_of_a_coarse_record_is_that_of_its_integrals_over_the_steps() -> None:
    # The bound depends by a factor of 1.7 on where in a step the echo falls, which half a step would turn round.
    capture = generate(load_scene("counter", COARSE), seed=1)
    bound = waveform_bound(capture)
    index = json.loads(capture.attrs["rig"])["medium"]["group_index"]
    sigma = float(np.hypot(1e-9 / 2.3548, 3e-10 / 2.5631))
    time, half = capture["time"].values, C_M_PER_S / (2 * index)
    expected = np.array([
        half * _coarse_bound(time - truth / half, light, 1e9 * 2e-9, 2e-9, sigma)
        for truth, light in zip(capture["truth_range"].values, capture["truth_amplitude"].values, strict=True)
    ])  # fmt: skip
    assert expected.max() > 1.5 * expected.min()
    # Rounding to a quarter electron, and an echo stretched by the wall's slope across the beam.
    np.testing.assert_allclose(bound.sigma, expected, rtol=0.01)


def test_a_declared_zero_of_time_does_not_move_the_bound_of_a_record() -> None:
    true = waveform_bound(generate(load_scene("counter", COARSE), seed=1)).sigma
    told = generate(load_scene("counter", COARSE | {"declared": {"t0_s": 5e-10}}), seed=1)
    assert json.loads(told.attrs["rig"])["t0_s"] == 5e-10
    np.testing.assert_allclose(waveform_bound(told).sigma, true, rtol=1e-6)


def test_bound_of_rare_photons_is_that_of_poisson_counts_of_all_pulses() -> None:
    # Far below one count a pulse there is no pile-up: cσ_t/(2n√N), N the photoelectrons of all 2,000 pulses.
    scene = load_scene("single-photon", {"rig.record.shots": 3, "rig.record.scan_half_angle_rad": 0.0, "rig.ambient_e_per_s": 0.0,
                                         "rig.detector.dark_e_per_s": 1.0, "rig.laser.pulse_energy_j": 2e-16})  # fmt: skip
    capture = generate(scene, seed=1)
    light = capture["truth_amplitude"].values
    assert (light > 1).all() and (light / 2000 < 0.02).all()
    sigma_t = np.sqrt((0.5e-9 / 2.3548) ** 2 + 0.05e-9**2 + (120e-12 / 2.5631) ** 2)
    index = json.loads(capture.attrs["rig"])["medium"]["group_index"]
    exact = C_M_PER_S * sigma_t / (2 * index * np.sqrt(light))
    # Dead bins hide up to N/2,000 of the light; steps of .45 σ cost (Δ/σ)²/24.
    np.testing.assert_allclose(waveform_bound(capture).sigma, exact, rtol=0.03)


def test_bounds_against_a_numerical_likelihood() -> None:
    # Fisher information as the mean square of scores drawn from the model itself: binomial counts with dead time.
    from beambench.optics import pile_up

    capture = generate(load_scene("single-photon", {"rig.record.shots": 1, "rig.laser.pulse_energy_j": 4e-13}), seed=1,
                       truth_electrons=True)  # fmt: skip
    bound = waveform_bound(capture)
    pulses = 2000
    rate = capture["truth_electrons"].values[0].astype(float) / pulses
    rng = np.random.default_rng(4)
    trials, bins = 20_000, rate.size
    chance = -np.expm1(-rate)
    dead = min(500, bins)  # 50 ns of 100 ps, not asked of the code under test
    share = (rate - rate.min()) / (rate - rate.min()).sum()
    gradient = np.stack([np.gradient(share), share, np.ones(bins)])  # any three directions serve
    score = np.zeros((3, trials))
    live = np.full(trials, pulses)
    for k in range(bins):
        n = rng.binomial(live, chance[k])
        score += gradient[:, k : k + 1] * (n / np.expm1(rate[k]) - (live - n)) / pulses
        live = live - n if dead >= bins else live
    drawn = np.cov(score)
    _, live_mean = pile_up.expected_counts(rate, pulses, dead)
    information = pile_up.count_information(rate, live_mean) / pulses**2
    exact = np.einsum("pk,qk,k->pq", gradient, gradient, information)
    d = np.sqrt(np.diag(exact))
    # Second moments of 20,000 draws: 1 % each.
    np.testing.assert_allclose(drawn / np.outer(d, d), exact / np.outer(d, d), atol=0.045)
    assert np.isfinite(bound.sigma).all() and bound.kind == "exact"


def test_an_amcw_bound_is_phase_noise_in_the_shot_limit() -> None:
    scene = load_scene("amcw", {"rig.shots": 3, "rig.scan_half_angle_rad": 0.0, "rig.modulation.frequencies_hz": [2e8],
                                "rig.detector.read_noise_e": 0.5, "rig.modulation.phase_steps": 16})  # fmt: skip
    capture = generate(scene, seed=1)
    a, b = float(capture["truth_amplitude"][0]), (0.5e6 + 1e5) * 5e-6
    index = json.loads(capture.attrs["rig"])["medium"]["group_index"]
    variance = 2 * (a + b) / (16 * (0.36 * a) ** 2)  # of even noise; Poisson's unevenness helps by C²/4 or so
    range_sigma = np.sqrt(variance) * C_M_PER_S / index / 2e8 / (4 * np.pi)
    bound = amcw_bound(capture)
    assert bound.sigma[0] == pytest.approx(range_sigma, rel=0.04) and bound.sigma[0] < range_sigma
    # Phases repeat every half wave of 200 MHz, .75 m in air: a range drawn evenly over that errs by its length / √12.
    assert bound.scale == pytest.approx(C_M_PER_S / index / 2e8 / 2 / np.sqrt(12), rel=1e-6)


def test_no_light_means_no_information() -> None:
    information, gradient = np.ones((1, 4)), np.zeros((3, 1, 4))
    gradient[2] = 1.0
    assert profiled_sigma(information, gradient)[0] == np.inf


def test_dispatch_knows_what_it_scores() -> None:
    capture = generate(load_scene("amcw", {"rig.shots": 3}), seed=1)
    np.testing.assert_array_equal(bound_of(capture).sigma, amcw_bound(capture).sigma)
    with pytest.raises(InputError, match="does not score"):
        bound_of(example_capture("amcw").assign_attrs(modality="unknown"))


def test_a_calibrated_response_comes_from_a_noisy_record_of_the_true_one() -> None:
    scene = load_scene(
        "counter", {"rig.record.shots": 3, "rig.detector.response": {"shape": "single-pole", "rise_time_s": 6e-10}}
    )
    text = str(generate(scene, seed=1).attrs["rig"])
    calibration = Calibration(pulse_photoelectrons=1e6, gate_photoelectrons=1e3, seed=2)
    old, new = json.loads(text)["response"], json.loads(calibrated_rig(scene, text, calibration))["response"]

    def moments(r: dict[str, Any]) -> tuple[float, float, float]:
        w = np.asarray(r["value"])
        t = r["start_s"] + r["step_s"] * np.arange(w.size)
        mean = (w * t).sum() / w.sum()
        return w.sum() * r["step_s"], mean, np.sqrt((w * (t - mean) ** 2).sum() / w.sum())

    assert new["value"] != old["value"]
    assert moments(new)[0] == pytest.approx(1.0, abs=1e-3)
    # Its place is the record's centroid, σ/√N; the samples end where the tail sinks into the dark counts.
    assert moments(new)[1] == pytest.approx(moments(old)[1], abs=3 * moments(old)[2] / np.sqrt(1e6))
    assert moments(new)[2] == pytest.approx(moments(old)[2], rel=0.02)
    amcw = load_scene("amcw", {"rig.shots": 3})
    declared = str(generate(amcw, seed=1).attrs["rig"])
    assert calibrated_rig(amcw, declared, calibration) == declared


@pytest.mark.parametrize("name", ["waveform", "amcw"])
def test_the_published_suites_load(name: str) -> None:
    loaded = load_suite(name)
    assert {scene.modality for _, scene in loaded.scenes} == {name}


def test_a_suite_runs_from_scene_to_scores(tmp_path: Path) -> None:
    suite = {
        "suite": "rangers", "version": 1, "title": "t", "scenes": ["counter", "single-photon"],
        "conditions": ["matched", "calibrated"], "estimators": ["waveform-ml", "waveform-coates"],
        "seeds": {"test": [1]}, "limits": {"time_s": 30.0, "warmup_s": 60.0, "memory_bytes": 2**31, "output_bytes": 2**20},
        "calibration": {"pulse_photoelectrons": 1e6, "gate_photoelectrons": 1e3}, "rtol": 1e-2,
    }  # fmt: skip
    result = run_suite(suite, tmp_path / "run", overrides={"rig.record.shots": 64}, report=False)
    table = pd.read_csv(result.out / "scores.csv")
    skipped = (table.estimator == "waveform-coates") & (table.scene == "counter")
    assert len(table) == 8 and (table.status[~skipped] == "ok").all() and (table.modality == "waveform").all()
    assert (table.n[~skipped] == 64).all() and (table.unit == "m").all()
    ml = table[(table.estimator == "waveform-ml")]
    assert (ml.coverage == 1).all() and (ml.rmse < 1.5 * ml.bound).all()
    # Analog captures have no pile-up to correct: skipped with a reason, and no failure.
    assert table.status[skipped].str.startswith("skip: reads rigs whose detector.readout.kind is single-photon").all()
    assert (table.n[skipped] == 0).all() and table.failure_rate[skipped].isna().all()
    amcw = {
        **suite, "suite": "phases", "scenes": ["amcw"], "conditions": ["matched"], "estimators": ["amcw-ml", "amcw-decade"],
    }  # fmt: skip
    table = pd.read_csv(
        run_suite(amcw, tmp_path / "phases", overrides={"rig.shots": 64}, report=False).out / "scores.csv"
    )
    assert (table.modality == "amcw").all() and (table.coverage == 1).all()
    # A mean square of 64 normal errors: standard error √(2/64).
    assert (np.abs((table.rmse / table.bound) ** 2 - 1) < 4 * np.sqrt(2 / 64)).all()
