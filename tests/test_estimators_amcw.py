"""AMCW estimators: phase and ambiguity, efficiency against the exact bound, and the laws."""

from __future__ import annotations

import json
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.benchmarks.bounds.amcw import amcw_bound
from beambench.captures.hide import hide_truth
from beambench.estimators import get_estimator, list_estimators, run_estimator
from beambench.generator.generate import generate
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

NAMES = [name for name in list_estimators() if name.startswith("amcw")]
#: The same light as three frequencies of 5 µs, spread over six whose phases distinguish 100 cycles.
JOINT = {
    "rig.modulation.frequencies_hz": [1.2e7, 4.4e7, 6.4e7, 1.5e8, 1.66e8, 2e8],
    "rig.modulation.integration_s": 2.5e-6,
}


@lru_cache(maxsize=32)
def _made(text: str, seed: int) -> xr.Dataset:
    return generate(load_scene("amcw", json.loads(text)), seed=seed, rtol=0.01)


def made(changes: dict[str, Any] | None = None, seed: int = 1) -> xr.Dataset:
    return _made(json.dumps(changes or {}), seed)


def errors(label: str, capture: xr.Dataset) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    result = run_estimator(label, hide_truth(capture))
    return (result["range"] - capture["truth_range"]).values, result["sigma"].values, result["valid"].values


def test_the_registry_holds_them() -> None:
    assert set(NAMES) == {"amcw-decade", "amcw-ml", "amcw-phase"}
    assert all(get_estimator(name).modality == "amcw" for name in NAMES)


@pytest.mark.parametrize("name", ["amcw-decade", "amcw-ml"])
def test_variance_is_the_bound_and_sigma_is_true(name: str) -> None:
    capture = made({"rig.shots": 3000})
    error, sigma, valid = errors(name, capture)
    bound = amcw_bound(capture)
    assert valid.all() and bound.kind == "exact"
    # 3000 squared normal errors: standard error √(2/3000) = 2.6 %; 4 of them. The ladder reads the finest phase alone,
    # which holds all but 1 % of the information.
    efficiency = 1 / np.mean((error / bound.sigma) ** 2)
    assert efficiency == pytest.approx(1.0, abs=0.105)
    assert np.sqrt(np.mean((error / sigma) ** 2)) == pytest.approx(1.0, abs=0.055)
    assert abs(error.mean()) < 4 * bound.sigma.mean() / np.sqrt(3000)


def test_read_noise_and_few_photons_keep_the_bound() -> None:
    capture = made({"rig.shots": 3000, "rig.laser.power_w": 5e-4, "rig.detector.read_noise_e": 40.0,
                    "rig.modulation.phase_steps": 3})  # fmt: skip
    error, sigma, valid = errors("amcw-ml", capture)
    bound = amcw_bound(capture)
    assert valid.mean() > 0.99
    efficiency = 1 / np.mean((error[valid] / bound.sigma[valid]) ** 2)
    assert efficiency == pytest.approx(1.0, abs=0.105)
    assert np.sqrt(np.mean((error[valid] / sigma[valid]) ** 2)) == pytest.approx(1.0, abs=0.055)


def test_one_frequency_is_ambiguous_by_half_its_wavelength() -> None:
    capture = made({"rig.shots": 200})
    error, _, valid = errors("amcw-phase", capture)
    half = amcw_bound(capture).scale * np.sqrt(12.0)
    cycles = error[valid] / half
    # The window begins at .5 m: 4 m is six half wavelengths of .552 m too far.
    np.testing.assert_allclose(cycles, np.rint(cycles), atol=0.02)
    assert set(np.rint(cycles)) == {-6.0}
    coarse, sigma, valid = errors("amcw-phase[frequency=0]", capture)
    assert valid.all() and np.abs(coarse).max() < 5 * sigma.max()


def test_the_ladder_fails_where_joint_candidates_survive_by_counts() -> None:
    # 15 µW: the phases at 2 and 20 MHz err by 18° (a quarter of the next wavelength) in many shots.
    shots = 1000
    dim = {"rig.shots": shots, "rig.laser.power_w": 1.5e-5}
    ladder, joint = made(dim), made(dim | JOINT)
    limit = 0.25 * amcw_bound(ladder).scale * np.sqrt(12.0)
    error, _, valid = errors("amcw-decade[min_snr=0]", ladder)
    wrong_ladder = int((~valid | (np.abs(error) > limit)).sum())
    error, _, valid = errors("amcw-ml[min_gap=0,min_snr=0]", joint)
    wrong_joint = int((~valid | (np.abs(error) > limit)).sum())
    assert wrong_ladder > 0.3 * shots
    # Measured: 29 against over 300.
    assert wrong_joint < 0.05 * shots and wrong_ladder > 8 * wrong_joint
    # With its gap the joint one refuses what it might get wrong: of those it answers almost none is wrong.
    error, _, valid = errors("amcw-ml", made(dim | JOINT, seed=2))
    assert valid.mean() > 0.5 and (np.abs(error[valid]) > limit).sum() <= 0.002 * shots


def test_the_ladder_fails_as_its_phase_error_predicts() -> None:
    # P(wrong rung) = P(|phase error| > 18°) at 20 MHz, Gaussian phase noise from the sample variance.
    from math import erfc

    from beambench.estimators.amcw.samples import phasors, read_samples

    capture = made({"rig.shots": 4000, "rig.laser.power_w": 2.5e-5})
    found = phasors(read_samples(hide_truth(capture)))
    sigma = np.sqrt(found.variance[:, 1]) / (0.36 * capture["truth_amplitude"].values)
    # The fine phase enters the decision at a tenth: 1.01 times the variance of 20 MHz; likewise from 2 to 20 MHz.
    one_rung = np.mean([erfc(np.radians(18.0) / (s * np.sqrt(2.02))) for s in sigma])
    error, _, valid = errors("amcw-decade[min_snr=0]", capture)
    limit = 0.25 * amcw_bound(capture).scale * np.sqrt(12.0)
    wrong = np.mean(~valid | (np.abs(error) > limit))
    expected = 1 - (1 - one_rung) ** 2
    assert 0.01 < expected < 0.3
    # Binomial of 4000: 4 standard errors; the angle's own curvature at σ = 10° adds a few per cent.
    assert wrong == pytest.approx(expected, abs=4 * np.sqrt(expected / 4000) + 0.1 * expected)


@pytest.mark.parametrize("name", NAMES)
def test_laws(name: str) -> None:
    capture = hide_truth(made({"rig.shots": 64}))
    kept = capture.copy(deep=True)
    one, two = run_estimator(name, capture), run_estimator(name, capture)
    xr.testing.assert_identical(one, two)
    xr.testing.assert_identical(capture, kept)
    # Shots are independent: reversed shots give reversed answers.
    turned = run_estimator(name, capture.isel(shot=slice(None, None, -1)))
    np.testing.assert_array_equal(turned["valid"].values[::-1], one["valid"].values)
    np.testing.assert_allclose(turned["range"].values[::-1], one["range"].values, rtol=1e-9)
    # Gain: the same electrons in a converter of twice the gain.
    rig = json.loads(capture.attrs["rig"])
    rig["detector"] |= {"gain_dn_per_e": 1.0, "offset_dn": 200.0, "adc_bits": 17}
    doubled = capture.assign(samples=(2.0 * capture["samples"].astype(float)).assign_attrs(capture["samples"].attrs))
    gained = run_estimator(name, doubled.assign_attrs(capture.attrs | {"rig": json.dumps(rig)}))
    np.testing.assert_allclose(gained["range"].values, one["range"].values, rtol=1e-5)
    # Shift: a later reference, declared, moves the answer by c/2n · Δt0.
    rig = json.loads(capture.attrs["rig"])
    rig["t0_s"] = 0.2e-9
    moved = run_estimator(name, capture.assign_attrs(rig=json.dumps(rig)))
    step = 0.2e-9 * 299792458.0 / (2 * rig["medium"]["group_index"])
    both = one["valid"].values & moved["valid"].values
    assert both.mean() > 0.9
    np.testing.assert_allclose((moved["range"] - one["range"]).values[both], step, atol=3e-6)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", ["zeros", "equal", "saturated", "offset", "nan", "one-shot-bad"])
def test_finite_or_invalid(name: str, kind: str) -> None:
    capture = hide_truth(made({"rig.shots": 8}))
    samples = capture["samples"].values.astype(np.float32)
    if kind == "nan":
        samples[:] = np.nan
    elif kind == "one-shot-bad":
        samples[3, 1] = np.inf
    else:
        samples[:] = {"zeros": 0, "equal": 777, "saturated": 65535, "offset": 100}[kind]
    result = run_estimator(name, capture.assign(samples=(capture["samples"].dims, samples)))
    valid = result["valid"].values
    assert np.isnan(result["range"].values[~valid]).all()
    if kind == "one-shot-bad":
        expected = np.ones(8, dtype=bool)
        if name == "amcw-decade":
            expected[3] = False
        assert (valid[np.arange(8) != 3]).all() and (name != "amcw-decade" or not valid[3])
    else:
        assert not valid.any()


def test_bad_parameters_and_captures_are_refused() -> None:
    capture = hide_truth(made({"rig.shots": 8}))
    with pytest.raises(InputError, match="frequency"):
        run_estimator("amcw-phase[frequency=7]", capture)
    with pytest.raises(InputError, match="negative"):
        run_estimator("amcw-ml[min_gap=-1.0]", capture)
    with pytest.raises(InputError, match="declared rig"):
        run_estimator("amcw-ml", capture.assign_attrs(rig="{}"))
    with pytest.raises(InputError, match="amcw captures"):
        run_estimator("amcw-ml", capture.assign_attrs(modality="waveform"))
