"""Waveform estimators: attained bounds, quantisation of the counter, walk error, corrected pile-up, and the laws."""

from __future__ import annotations

import json
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.benchmarks.bounds.waveform import waveform_bound
from beambench.captures.hide import hide_truth
from beambench.estimators import get_estimator, list_estimators, run_estimator
from beambench.estimators.rig import read_rig
from beambench.estimators.waveform.analog import read_analog
from beambench.generator.generate import generate
from beambench.optics.constants import C_M_PER_S
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

NAMES = [name for name in list_estimators() if name.startswith("waveform")]
STILL = {"rig.laser.energy_fluctuation": 0.0}
#: With a clock for rigs that declare none.
LABEL = {name: f"{name}[counter_hz=1e9]" if name == "waveform-counter" else name for name in NAMES}
#: Coates's correction reads single-photon counts only.
ANALOG = [name for name in NAMES if name != "waveform-coates"]


def _read_by(*scenes: str) -> list[tuple[str, str]]:
    return [(name, scene) for name in NAMES for scene in scenes if name in ANALOG or scene == "single-photon"]


@lru_cache(maxsize=32)
def _made(scene: str, text: str, seed: int) -> xr.Dataset:
    return generate(load_scene(scene, json.loads(text)), seed=seed, rtol=5e-3)


def made(scene: str, changes: dict[str, Any] | None = None, seed: int = 1) -> xr.Dataset:
    return _made(scene, json.dumps(changes or {}), seed)


def errors(label: str, capture: xr.Dataset) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    result = run_estimator(label, hide_truth(capture))
    return (result["range"] - capture["truth_range"]).values, result["sigma"].values, result["valid"].values


def test_the_registry_holds_them() -> None:
    assert set(NAMES) == {f"waveform-{n}" for n in (
        "average", "coates", "constant-fraction", "counter", "first-return", "gaussian", "leading-edge", "matched", "ml",
        "several-returns")}  # fmt: skip
    for name in NAMES:
        found = get_estimator(name)
        assert found.modality == "waveform" and found.function.__doc__ and len(found.cites) > 10


@pytest.mark.parametrize(("scene", "changes"), [
    ("counter", STILL),
    ("counter", STILL | {"rig.laser.pulse_energy_j": 1e-10}),
    ("counter", STILL | {"rig.detector.response": {"shape": "single-pole", "rise_time_s": 8e-10}}),
    ("single-photon", {}),
    ("single-photon", {"rig.laser.pulse_energy_j": 5e-13}),
    ("single-photon", {"rig.detector.readout.dead_time_s": 1e-9}),
])  # fmt: skip
def test_maximum_likelihood_attains_the_exact_bound(scene: str, changes: dict[str, Any]) -> None:
    shots = 2000
    capture = made(scene, changes | {"rig.record.shots": shots})
    bound = waveform_bound(capture)
    error, sigma, valid = errors("waveform-ml", capture)
    assert bound.kind == "exact" and valid.all()
    efficiency = 1 / np.mean((error / bound.sigma) ** 2)
    # 2000 squared normal errors: standard error √(2/2000) = 3.2 %, times 4.
    assert efficiency == pytest.approx(1.0, abs=0.13)
    assert np.sqrt(np.mean((error / sigma) ** 2)) == pytest.approx(1.0, abs=0.07)
    assert abs(error.mean()) < 4.5 * bound.sigma.mean() / np.sqrt(shots)


@pytest.mark.parametrize(
    "name", ["waveform-matched", "waveform-gaussian", "waveform-average", "waveform-constant-fraction"]
)
def test_stated_sigmas_are_true_and_none_beats_the_bound(name: str) -> None:
    capture = made("counter", STILL | {"rig.record.shots": 2000})
    bound = waveform_bound(capture)
    error, sigma, valid = errors(name, capture)
    assert valid.mean() > 0.995
    e = error[valid] - error[valid].mean()
    assert np.std(e / sigma[valid]) == pytest.approx(1.0, abs=0.1)
    assert np.std(e / bound.sigma[valid]) > 0.95
    # Bias below a fifth of a standard error, but for the constant fraction's straight lines: an eighth of a sample.
    limit = 0.2 * bound.sigma.mean() if name != "waveform-constant-fraction" else 0.25e-9 / 8 * C_M_PER_S / 2.7
    assert abs(error[valid].mean()) < limit


def test_the_counter_errs_evenly_over_its_cycle() -> None:
    # Ranges of a tilted wall, scanned, sweep some 11 cycles; a bright echo leaves the counting error alone.
    capture = made("counter", STILL | {"rig.record.shots": 3000, "rig.detector.readout.adc_bits": 16,
                                       "rig.detector.readout.gain_dn_per_e": 1.0, "rig.laser.pulse_energy_j": 2e-8,
                                       "rig.record.scan_half_angle_rad": 0.2, "rig.record.step_s": 5e-11,
                                       "rig.record.samples": 640, "target.0.shape.tilt_y_deg": 35.0,
                                       "target.0.shape.width_m": 30.0})  # fmt: skip
    edge, _, valid_edge = errors("waveform-leading-edge", capture)
    counted, sigma, valid = errors("waveform-counter", capture)
    both = valid & valid_edge
    assert both.mean() > 0.99
    step = C_M_PER_S / (2 * json.loads(capture.attrs["rig"])["medium"]["group_index"] * 1e9)
    quantised = (counted - edge)[both]
    assert np.abs(quantised).max() <= 0.5 * step * (1 + 1e-9)
    # Even over ±step/2: rms step/√12. Neighbouring shots follow one another: parts of a cycle at the two ends.
    assert quantised.std() == pytest.approx(step / np.sqrt(12), rel=0.05)
    assert abs(quantised.mean()) < 0.05 * step
    hist, _ = np.histogram(quantised, bins=8, range=(-step / 2, step / 2))
    assert hist.min() > 0.7 * both.sum() / 8
    assert sigma[both].min() >= step / np.sqrt(12)
    finer, _, ok = errors("waveform-counter[counter_hz=1e10]", capture)
    assert (finer - edge)[both & ok].std() == pytest.approx(step / 10 / np.sqrt(12), rel=0.05)
    with pytest.raises(InputError, match="no counter"):
        run_estimator("waveform-counter", hide_truth(made("single-photon", {"rig.record.shots": 8})))


def test_a_fixed_threshold_walks_with_brightness_and_a_constant_fraction_does_not() -> None:
    dim = made("counter", STILL | {"rig.laser.pulse_energy_j": 4e-10, "rig.record.scan_half_angle_rad": 0.0})
    bright = made("counter", STILL | {"rig.laser.pulse_energy_j": 4e-9, "rig.record.scan_half_angle_rad": 0.0})
    moved = {}
    for label in (
        "waveform-leading-edge[walk=none]",
        "waveform-leading-edge",
        "waveform-constant-fraction",
        "waveform-ml",
    ):
        moved[label] = np.nanmean(errors(label, bright)[0]) - np.nanmean(errors(label, dim)[0])
    # Threshold at 8σ of the background: the Gaussian edge of ten times the light is there earlier by some .2 ns.
    assert -0.06 < moved["waveform-leading-edge[walk=none]"] < -0.015
    assert abs(moved["waveform-constant-fraction"]) < 0.003
    assert abs(moved["waveform-ml"]) < 0.001
    assert abs(moved["waveform-leading-edge"]) < 0.005


def test_pile_up_pulls_early_and_coates_undoes_it() -> None:
    capture = made("single-photon", {"rig.laser.pulse_energy_j": 5e-13, "rig.record.shots": 400})
    raw, _, _ = errors("waveform-average", capture)
    corrected, sigma, valid = errors("waveform-coates", capture)
    assert valid.all()
    assert raw.mean() < -0.015
    assert abs(corrected.mean()) < 4 * sigma.mean() / 20
    assert np.std(corrected / sigma) == pytest.approx(1.0, abs=4 / np.sqrt(800))


def test_the_stated_variance_of_dark_samples_is_that_of_the_samples_behind_a_multiplier() -> None:
    # 40 × 128 dark samples: their variance has a standard error of 2 %. The multiplier's gain divides the electronic noise.
    tube = {"gain": 20.0, "excess_noise_factor": 2.5}
    dark = made("counter", {"rig.laser.pulse_energy_j": 1e-20, "rig.ambient_e_per_s": 0.0, "rig.detector.dark_e_per_s": 1.0,
                            "rig.detector.readout.avalanche": tube, "rig.record.shots": 40})  # fmt: skip
    raw = dark["signal"].values
    read = read_analog(read_rig(hide_truth(dark)), raw, np.ones(40, bool))
    assert read.floor_var == pytest.approx((3.0**2 + 1 / 12) / 20.0**2, rel=1e-6) and read.excess == 2.5
    assert np.var(read.z) == pytest.approx(read.floor_var, rel=5 * np.sqrt(2 / raw.size))


@pytest.mark.parametrize("scene", ["counter", "photodetector-5m"])
def test_coates_refuses_analog_records_with_a_reason(scene: str) -> None:
    # They have no pile-up to correct: no answer would be one of this method, and no failure either.
    analog = hide_truth(made(scene, {"rig.record.shots": 8}))
    coates = get_estimator("waveform-coates")
    assert coates.unfit(analog) == "reads rigs whose detector.readout.kind is single-photon, not analog"
    with pytest.raises(InputError, match="is single-photon, not analog"):
        run_estimator("waveform-coates", analog)
    with pytest.raises(InputError, match="no pile-up"):
        coates.function(analog)
    assert coates.unfit(hide_truth(made("single-photon", {"rig.record.shots": 8}))) == ""


def test_background_left_in_pulls_the_average_to_the_window_s_middle() -> None:
    changes = STILL | {"rig.record.shots": 500, "rig.ambient_e_per_s": 4e10, "rig.record.scan_half_angle_rad": 0.0}
    capture = made("counter", changes)
    error, _, _ = errors("waveform-average[background=none,reach=0.0,min_snr=0.0]", capture)
    rig = json.loads(capture.attrs["rig"])
    half = C_M_PER_S / (2 * rig["medium"]["group_index"])
    t = capture["time"].values
    light, level = float(capture["truth_amplitude"][0]), float(capture["truth_background"][0]) * t.size
    middle = t.mean() * half
    predicted = (middle - 4.0) * level / (light + level)
    assert error.mean() == pytest.approx(predicted, abs=4 * error.std() / np.sqrt(500))
    assert abs(predicted) > 0.05


def test_wrong_declared_zero_and_index_shift_the_answer_as_they_must() -> None:
    base = made("counter", STILL | {"rig.record.scan_half_angle_rad": 0.0})
    late = made("counter", STILL | {"rig.record.scan_half_angle_rad": 0.0, "declared": {"t0_s": 1e-10}})
    half = C_M_PER_S / (2 * json.loads(base.attrs["rig"])["medium"]["group_index"])
    shift = np.nanmean(errors("waveform-ml", late)[0]) - np.nanmean(errors("waveform-ml", base)[0])
    # Another capture key draws other noise: .8 mm a shot, 256 shots each.
    assert shift == pytest.approx(1e-10 * half, abs=5 * 8e-4 * np.sqrt(2 / 256))


@pytest.mark.parametrize(("name", "scene"), _read_by("counter", "single-photon", "photodetector-5m"))
def test_laws(name: str, scene: str) -> None:
    capture = hide_truth(made(scene, {"rig.record.shots": 30}))
    label = LABEL[name]
    kept = capture.copy(deep=True)
    one, two = run_estimator(label, capture), run_estimator(label, capture)
    xr.testing.assert_identical(one, two)
    xr.testing.assert_identical(capture, kept)
    if scene == "counter" and name in ANALOG:
        assert one["valid"].all()
    turned = run_estimator(label, capture.isel(shot=slice(None, None, -1)))
    np.testing.assert_array_equal(turned["valid"].values[::-1], one["valid"].values)
    np.testing.assert_allclose(turned["range"].values[::-1], one["range"].values, rtol=1e-9)
    # Shift: a later clock moves the answer by c/2n of it (a whole cycle for the counter). Scoring stops within 1e-3 σ.
    delay = 3e-9
    moved = run_estimator(label, capture.assign_coords(time=capture["time"] + delay))
    half = C_M_PER_S / (2 * json.loads(capture.attrs["rig"])["medium"]["group_index"])
    np.testing.assert_array_equal(moved["valid"].values, one["valid"].values)
    difference = (moved["range"] - one["range"]).values / half - delay
    assert np.nanmax(np.abs(difference), initial=0.0) < 1e-13 + 2e-3 * np.nanmax(
        one["sigma"].values / half, initial=0.0
    )


@pytest.mark.parametrize("name", ANALOG)
def test_gain(name: str) -> None:
    # The same electrons in a converter of twice the gain and offset.
    capture = hide_truth(made("counter", {"rig.record.shots": 30}))
    rig = json.loads(capture.attrs["rig"])
    rig["detector"]["readout"] |= {"gain_dn_per_e": 2.0, "offset_dn": 80.0, "adc_bits": 13}
    signal = (2 * capture["signal"].astype(np.uint16)).assign_attrs(capture["signal"].attrs)
    one = run_estimator(LABEL[name], capture)
    two = run_estimator(LABEL[name], capture.assign(signal=signal).assign_attrs(rig=json.dumps(rig)))
    # The smaller ADC step takes 1/16 e² from a floor of 9.08: a threshold at 8σ falls by .4 %, which moves an edge by
    # .02 σ at most; a count of the clock may change.
    difference = np.abs(two["range"] - one["range"]) / one["sigma"]
    assert float(difference.max()) < (0.05 if name != "waveform-counter" else 3.5)


KINDS = [
    "zeros",
    "equal",
    "offset",
    "saturated",
    "one-sample",
    "nan",
    "inf",
    "one-bad-shot",
    "few-samples",
    "laser-off",
]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("name", "scene"), _read_by("counter", "single-photon"))
def test_finite_or_invalid(name: str, scene: str, kind: str) -> None:
    capture = hide_truth(made(scene, {"rig.record.shots": 8}))
    signal = capture["signal"].values.astype(np.float32)
    if kind in ("zeros", "equal", "offset", "saturated"):
        signal[:] = {"zeros": 0, "equal": 77, "offset": 40, "saturated": 65535}[kind]
    elif kind == "one-sample":
        signal[:] = signal.min()
        signal[:, 60] = 900
    elif kind in ("nan", "inf"):
        signal[:] = np.nan if kind == "nan" else np.inf
    elif kind == "one-bad-shot":
        signal[3] = np.nan
        signal[4, 5] = -np.inf
    changed = capture.assign(signal=(("shot", "sample"), signal))
    if kind == "few-samples":
        changed = changed.isel(sample=slice(0, 5))
    elif kind == "laser-off":
        changed = changed.assign_coords(laser_on=("shot", np.zeros(8, dtype=bool)))
    with np.errstate(all="raise", under="ignore"):
        result = run_estimator(LABEL[name], changed)  # the contract is checked there; and no warning stays unseen
    valid = result["valid"].values
    assert np.isnan(result["range"].values[~valid]).all() and np.isnan(result["sigma"].values[~valid]).all()
    if kind in ("zeros", "offset", "saturated", "nan", "inf", "laser-off"):
        assert not valid.any() or (scene == "single-photon" and kind == "offset")
    elif kind == "one-bad-shot":
        assert not valid[3]


def test_a_clipped_echo_is_refused_or_read_from_its_flanks() -> None:
    capture = made("counter", STILL | {"rig.detector.readout.adc_bits": 9, "rig.laser.pulse_energy_j": 4e-9})
    assert not errors("waveform-average", capture)[2].any()
    error, sigma, valid = errors("waveform-ml", capture)
    assert valid.all()
    # Samples that clip are left out: which ones they are depends on their noise, a bias of part of a σ.
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 1.5


def test_bad_parameters_and_captures_are_refused() -> None:
    capture = hide_truth(made("counter", {"rig.record.shots": 8}))
    for label in ("waveform-leading-edge[threshold_sigma=0.0]", "waveform-constant-fraction[fraction=1.5]",
                  "waveform-average[reach=-1.0]", "waveform-ml[min_snr=-1.0]"):  # fmt: skip
        with pytest.raises(InputError):
            run_estimator(label, capture)
    uneven = capture.assign_coords(time=("sample", capture["time"].values ** 1.01))
    with pytest.raises(InputError, match="evenly"):
        run_estimator("waveform-ml", uneven)
    with pytest.raises(InputError, match="declared rig"):
        run_estimator("waveform-ml", capture.assign_attrs(rig="{}"))
