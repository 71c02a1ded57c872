"""Written captures against expectations that are derived here from other formulas."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr
from scipy.special import ndtr

from beambench.benchmarks.written import amcw, gated, waveform
from beambench.captures.validate import validate
from beambench.optics.constants import C_M_PER_S, FWHM_PER_SIGMA
from beambench.optics.pile_up import dead_bins, expected_counts
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

SHOTS = 400
#: 10-90 % rise of a Gaussian step in standard deviations.
RISE = 2.5631031310892007


def _index(capture: xr.Dataset) -> float:
    return float(json.loads(capture.attrs["rig"])["medium"]["group_index"])


def _agrees(counts: np.ndarray, mean: np.ndarray, variance: np.ndarray) -> None:
    """Averages over the shots lie within 5 standard errors of the expectation, in every sample."""
    error = (counts.mean(axis=0) - mean) / np.sqrt(variance / len(counts))
    assert np.abs(error).max() < 5 and (error**2).mean() == pytest.approx(1.0, abs=5 * np.sqrt(2 / error.size))


def test_a_slice_is_the_pulse_through_a_rectangular_gate() -> None:
    scene = load_scene("flat-wall", {"rig.camera.rows": 20, "rig.camera.cols": 20, "rig.detector.gain_dn_per_e": 4.0})
    capture = gated.written_capture(scene, 900.0, 30.0, 5.0, seed=4)
    validate(capture)
    sigma = 1e-9 / FWHM_PER_SIGMA
    u = 2 * _index(capture) * 5.0 / C_M_PER_S - capture["delay"].values
    mean = 900.0 * (ndtr(u / sigma) - ndtr((u - 1e-9) / sigma)) + 30.0
    electrons = (capture["counts"].values.reshape(u.size, -1).T - 100.0) / 4.0
    _agrees(electrons, mean, mean + 2.0**2 + 1 / (12 * 4.0**2))


def test_an_analog_sample_is_the_detected_pulse_over_its_interval() -> None:
    changes = {
        "rig.record.shots": SHOTS,
        "rig.laser.energy_fluctuation": 0.0,
        "rig.detector.readout.gain_dn_per_e": 2.0,
    }
    capture = waveform.written_capture(load_scene("counter", changes), 2000.0, 20.0, 4.0, seed=4)
    validate(capture)
    sigma = np.hypot(1e-9 / FWHM_PER_SIGMA, 300e-12 / RISE)
    edge = np.append(capture["time"].values - 125e-12, capture["time"].values[-1] + 125e-12)
    mean = 2000.0 * np.diff(ndtr((edge - 2 * _index(capture) * 4.0 / C_M_PER_S) / sigma)) + 20.0
    electrons = (capture["signal"].values - 40.0) / 2.0
    _agrees(electrons, mean, mean + 3.0**2 + 1 / (12 * 2.0**2))


@pytest.mark.parametrize("dead_s", [0.0, 1e-9, 50e-9])
def test_single_photons_blind_the_detector(dead_s: float) -> None:
    changes = {"rig.record.shots": SHOTS, "rig.detector.readout.dead_time_s": dead_s, "rig.laser.jitter_pulse_s": 0.0}
    capture = waveform.written_capture(load_scene("single-photon", changes), 2000.0, 10.0, 3.0, seed=4)
    validate(capture)
    sigma = np.hypot(0.5e-9 / FWHM_PER_SIGMA, 120e-12 / RISE)
    edge = np.append(capture["time"].values - 50e-12, capture["time"].values[-1] + 50e-12)
    light = 2000.0 * np.diff(ndtr((edge - 2 * _index(capture) * 3.0 / C_M_PER_S) / sigma)) + 10.0
    mean, live = expected_counts(light / 2000, 2000, dead_bins(dead_s, 1e-10, edge.size - 1))
    chance = -np.expm1(-light / 2000)
    # Given live pulses the count is binomial; the live pulses themselves vary by less than a binomial of all pulses.
    _agrees(capture["signal"].values, mean, live * chance * (1 - chance) + chance**2 * live * (1 - live / 2000))
    if dead_s == 50e-9:
        assert capture["signal"].values.sum(axis=1).max() <= 2000


def test_an_amcw_sample_is_the_correlation_of_light_and_reference() -> None:
    changes = {"rig.shots": SHOTS, "rig.t0_s": 0.3e-9, "rig.detector.gain_dn_per_e": 1.0}
    capture = amcw.written_capture(load_scene("amcw", changes), 3000.0, 50.0, 4.0, seed=4)
    validate(capture)
    frequency, phase = capture["frequency"].values, capture["phase"].values
    turn = 2 * np.pi * frequency[:, None] * (2 * _index(capture) * 4.0 / C_M_PER_S - 0.3e-9) - phase
    mean = 3000.0 * (1 + 0.5 * 0.9 * 0.8 * np.cos(turn)) + 50.0
    _agrees(capture["samples"].values - 100.0, mean, mean + 5.0**2 + 1 / 12)


@pytest.mark.parametrize(("write", "name", "data"), [
    (gated.written_capture, "flat-wall", "counts"), (waveform.written_capture, "counter", "signal"),
    (amcw.written_capture, "amcw", "samples"),
])  # fmt: skip
def test_a_wrong_zero_is_declared_and_the_light_stays(write, name: str, data: str) -> None:  # type: ignore[no-untyped-def]
    late = load_scene(name, {"rig.t0_s": 1e-9})
    true, staged = (
        write(scene, 50.0, 1.0, 4.5, seed=2) for scene in (late, late.model_copy(update={"declared": {"t0_s": 3e-9}}))
    )
    assert (true[data].values == staged[data].values).all()
    assert json.loads(staged.attrs["rig"])["t0_s"] == 3e-9
    for coordinate in {"delay", "time"} & set(true.coords) - ({"time"} if data == "counts" else set()):
        np.testing.assert_allclose(staged[coordinate] - true[coordinate], 2e-9, rtol=1e-6)
    assert not write(late, 50.0, 1.0, 4.5)[data].values.any()
    other = load_scene("amcw" if name != "amcw" else "counter")
    with pytest.raises(InputError, match="scenes only"):
        write(other, 50.0, 1.0, 4.5)
