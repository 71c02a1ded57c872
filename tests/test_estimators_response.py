"""The response from samples, against quadrature and closed forms; calibration from noisy measurements."""

from __future__ import annotations

import numpy as np
import pytest

from beambench.benchmarks.written.gated_stack import GaussianRig, stack_capture
from beambench.estimators import run_estimator
from beambench.estimators.calibration import gate_from_scan, pulse_from_trace, simulate_measurement
from beambench.estimators.response import correlate_samples
from beambench.optics.constants import C_M_PER_S
from beambench.scenes.errors import InputError

STEP = 1e-11
# A pulse with a long tail and a gate with a slow opening: orientation shows.
PULSE = {
    "start_s": -2e-10,
    "step_s": STEP,
    "value": [0.0, *np.linspace(0, 1, 20), *np.exp(-np.arange(1, 300) / 40), 0.0],
}
GATE = {"start_s": -3e-10, "step_s": STEP, "value": [*np.linspace(0, 0.8, 61), *[0.8] * 80, *np.linspace(0.8, 0, 7)]}


def _quadrature(pulse: dict, gate: dict, u: float) -> float:  # type: ignore[type-arg]
    t = np.linspace(-1e-9, 5e-9, 60001)
    tp = pulse["start_s"] + pulse["step_s"] * np.arange(len(pulse["value"]))
    tg = gate["start_s"] + gate["step_s"] * np.arange(len(gate["value"]))
    p = np.interp(t, tp, pulse["value"], left=0, right=0)
    g = np.interp(t + u, tg, gate["value"], left=0, right=0)
    return float((p * g).sum() / p.sum())


def test_correlation_of_samples_is_that_of_their_straight_lines() -> None:
    found = correlate_samples(PULSE, GATE)
    u = np.linspace(-2.5e-9, 2e-9, 60)
    expected = np.array([_quadrature(PULSE, GATE, x) for x in u])
    # Exact up to where steps do not meet (the grid is finer than both) and the quadrature's own 1e-13 s steps.
    np.testing.assert_allclose(found(u)[0], expected, atol=3e-5)
    reverse = correlate_samples(PULSE | {"value": PULSE["value"][::-1]}, GATE)
    assert np.abs(reverse(u)[0] - expected).max() > 0.05


def test_slope_and_curvature_are_derivatives() -> None:
    found = correlate_samples(PULSE, GATE)
    u = np.linspace(found.lo_s, found.hi_s, 501)
    d = 1e-14
    value = [found(u + k * d)[0] for k in (-1, 1)]
    slope = [found(u + k * d)[1] for k in (-1, 1)]
    np.testing.assert_allclose(found(u)[1], (value[1] - value[0]) / (2 * d), atol=1e-5 * np.abs(found.slope).max())
    # A cubic's second derivative jumps at nodes: compared in the mean.
    assert np.abs(found(u)[2] - (slope[1] - slope[0]) / (2 * d)).mean() < 0.02 * np.abs(found(u)[2]).max()


def test_gaussian_response_has_the_closed_forms_moments() -> None:
    rig = GaussianRig()
    declared = rig.declared(2, 2)
    found = correlate_samples(declared["pulse"], declared["gates"][0])
    # Straight lines between samples of step σ/40 widen each variance by (σ/40)²/6: 1e-4.
    assert found.variance_s2 == pytest.approx(rig.sigma_s**2 * (1 + 1 / 9600), rel=1e-6, abs=0.0)
    assert found.centroid_s == pytest.approx(rig.centre_s, rel=1e-9)
    assert found.peak_s == pytest.approx(rig.centre_s, abs=rig.part_s / 40)
    u = rig.centre_s + np.linspace(-4, 4, 99) * rig.sigma_s
    np.testing.assert_allclose(found(u)[0], rig.response(u), atol=1e-4)


def test_jitter_broadens_the_response() -> None:
    declared = GaussianRig().declared(2, 2)
    args = declared["pulse"], declared["gates"][0]
    for jitter in (1e-13, 2e-11, 4e-10):
        wide, sharp = correlate_samples(*args, jitter_s=jitter), correlate_samples(*args)
        # The jitter's own bins add step²/12; six sigma are kept.
        assert wide.variance_s2 - sharp.variance_s2 == pytest.approx(jitter**2, rel=1e-3, abs=(1.1e-11) ** 2 / 6)
        assert wide.centroid_s == pytest.approx(sharp.centroid_s, abs=1e-15)


def test_steps_of_different_length_meet() -> None:
    coarse = {"start_s": 0.0, "step_s": 7e-11, "value": [0.0, 1.0, 1.0, 1.0, 0.0]}
    found = correlate_samples(PULSE, coarse)
    u = np.linspace(-2e-9, 1e-9, 40)
    expected = np.array([_quadrature(PULSE, coarse, x) for x in u])
    np.testing.assert_allclose(found(u)[0], expected, atol=2e-3)
    # Away from the grid's corners the area is kept: transmission times width.
    assert found.area_s == pytest.approx(3 * 7e-11, rel=1e-3)


def test_calibration_recovers_samples() -> None:
    rig = GaussianRig()
    declared = rig.declared(20, 40)
    true = correlate_samples(declared["pulse"], declared["gates"][0])
    pulse = pulse_from_trace(*simulate_measurement(declared["pulse"], noise=0.01, shots=100, seed=1))
    gate = gate_from_scan(*simulate_measurement(declared["gates"][0], noise=0.01, shots=100, seed=2), transmission=1.0)
    value = np.array(pulse["value"])
    t = pulse["start_s"] + pulse["step_s"] * np.arange(value.size)
    assert value.sum() * pulse["step_s"] == pytest.approx(1.0)
    # Zero is the centroid of the record, whose noise of .1 % counts over twice the pulse's length; the samples end sooner.
    assert (t * value).sum() / value.sum() == pytest.approx(0.0, abs=0.003 * rig.sigma_s)
    found = correlate_samples(pulse, gate)
    # .1 % noise after averaging: the gate's half height moves by .001·(its rise, .6 σ) and some; widths by cut tails.
    assert abs(found.centroid_s - true.centroid_s) < 0.003 * rig.sigma_s
    assert np.sqrt(found.variance_s2 / true.variance_s2) == pytest.approx(1.0, abs=0.02)
    # Read with the calibrated rig, the range is off by no more than the calibration's centroid says.
    tau = np.linspace(rig.delay_s[14], rig.delay_s[-14], 800).reshape(20, 40) + rig.centre_s
    capture = stack_capture(
        rig, rig.electrons(tau, 1e4, 2.0).astype(np.float32), declared | {"pulse": pulse, "gates": [gate]}
    )
    result = run_estimator("poisson-ml", capture)
    error = result["range"].values - tau * C_M_PER_S / 2
    assert result["valid"].values.all()
    assert np.abs(error).max() < 1.5 * abs(found.centroid_s - true.centroid_s) * C_M_PER_S / 2 + 1e-4


def test_calibration_of_a_rectangular_gate_keeps_its_width() -> None:
    flat = {"start_s": -STEP / 2, "step_s": STEP, "value": [0.0, *[0.9] * 200, 0.0]}
    gate = gate_from_scan(*simulate_measurement(flat, noise=0.02, shots=400, seed=5), transmission=0.9)
    value = np.array(gate["value"])
    assert value.max() <= 1.0
    # Smoothing moves each half height by a step at most; the top's ripple is the filter's few per cent.
    assert value.sum() * STEP == pytest.approx(0.9 * 200 * STEP, rel=0.02)
    t = gate["start_s"] + STEP * np.arange(value.size)
    assert np.interp(0.0, t, value) == pytest.approx(0.45, abs=0.02)


def test_bad_measurements_are_refused() -> None:
    noise = np.random.default_rng(0).normal(size=(3, 200))
    for act in (
        lambda: pulse_from_trace(0.0, 1e-11, noise),
        lambda: pulse_from_trace(0.0, 1e-11, np.full(50, np.nan)),
        lambda: pulse_from_trace(0.0, 0.0, noise),
        lambda: gate_from_scan(0.0, 1e-11, noise, transmission=1.2),
        lambda: simulate_measurement(PULSE, noise=-1, shots=1, seed=0),
        lambda: correlate_samples({"value": [1, 2]}, GATE),
        lambda: correlate_samples(PULSE, GATE | {"value": [np.nan, 1.0]}),
    ):
        with pytest.raises(InputError):
            act()  # type: ignore[no-untyped-call]
