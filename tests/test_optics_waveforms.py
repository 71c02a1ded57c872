"""Pulse and gate shapes: norms, centroids, edges, jitter, samples."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from beambench.optics.correlation import waveforms as w
from beambench.optics.correlation.response import correlation, correlation_support
from beambench.scenes import waveforms as specs

NS = 1e-9
PULSES: list[w.Pulse] = [
    w.GaussianPulse(1.0 * NS),
    w.RectangularPulse(1.3 * NS),
    w.TrapezoidalPulse(0.3 * NS, 0.5 * NS, 1.2 * NS),
    w.TrapezoidalPulse(0.0, 0.0, 2.0 * NS),
    w.ExponentialPulse(0.6 * NS, 0.9 * NS),
    w.ExponentialPulse(0.1 * NS, 3.0 * NS),
    w.SampledPulse(0.2 * NS, (0.0, 1.0, 4.0, 3.5, 2.0, 1.2, 0.7, 0.3, 0.1, 0.0)),
    w.SampledPulse(0.5 * NS, (1.0, 2.0, 0.5)),
]
GATES: list[w.Gate] = [
    w.RectangularGate(3.0 * NS, 0.8),
    w.TrapezoidalGate(2.0 * NS, 0.5 * NS, 1.0 * NS, 1.0),
    w.GaussianGate(2.0 * NS, 0.9),
    w.ExponentialGate(1.0 * NS, 0.7 * NS, 1.0),
    w.ExponentialGate(0.0, 5.0 * NS, 1.0),
    w.SampledGate(-0.3 * NS, 0.25 * NS, (0.0, 0.2, 0.9, 1.0, 0.95, 0.8, 0.3, 0.1, 0.0)),
]


def moments(start: float, step: float, value: NDArray[np.float64]) -> tuple[float, float, float]:
    """Area, centroid and variance of straight lines between even samples (exact)."""
    t = start + step * np.arange(value.size)
    mass = step * value.copy()
    # A hat function holds `step` of area and step²/6 of variance; half hats at the ends only matter for jumps there.
    area = float(np.sum(mass))
    centre = float(np.sum(mass * t) / area)
    return area, centre, float(np.sum(mass * (t - centre) ** 2) / area + step**2 / 6.0)


@pytest.mark.parametrize("pulse", PULSES, ids=repr)
def test_unit_area_centroid_and_variance(pulse: w.Pulse) -> None:
    lo, hi = w.pulse_support(pulse)
    # Midpoint rule with 2e5 cells: h²/24·|Δp'| < 1e-9 for lines, jumps cost p·h < 1e-5 of the area.
    t = lo + (hi - lo) * (np.arange(200_000) + 0.5) / 200_000
    p = w.pulse_density(pulse, t) * (hi - lo) / 200_000
    np.testing.assert_allclose(np.sum(p), 1.0, atol=2e-5)
    np.testing.assert_allclose(np.sum(p * t), 0.0, atol=2e-5 * (hi - lo))
    np.testing.assert_allclose(np.sum(p * t * t), w.pulse_variance(pulse), rtol=2e-5, atol=2e-5 * (hi - lo) ** 2)
    assert np.all(w.pulse_density(pulse, [lo - NS, hi + NS]) < 1e-12 / NS)


def test_known_variances() -> None:
    np.testing.assert_allclose(w.pulse_variance(w.GaussianPulse(NS)), NS**2 / (8.0 * np.log(2.0)), rtol=1e-14)
    np.testing.assert_allclose(w.pulse_variance(w.RectangularPulse(NS)), NS**2 / 12.0, rtol=1e-13)
    np.testing.assert_allclose(w.pulse_variance(w.TrapezoidalPulse(NS, 0.0, NS)), NS**2 / 6.0, rtol=1e-13)
    tailed = w.pulse_variance(w.ExponentialPulse(NS, 2.0 * NS))
    np.testing.assert_allclose(tailed, NS**2 / (8.0 * np.log(2.0)) + 4.0 * NS**2, rtol=1e-14)


def test_gates_open_at_half_height_and_area() -> None:
    for gate in (GATES[1], GATES[2]):
        peak = np.max(w.gate_transmission(gate, np.linspace(0.0, 2.0 * NS, 2001)))
        np.testing.assert_allclose(w.gate_transmission(gate, 0.0), 0.5 * peak, rtol=1e-12)
    np.testing.assert_allclose(w.gate_area(GATES[0]), 2.4 * NS, rtol=1e-14)
    np.testing.assert_allclose(w.gate_area(GATES[1]), 2.0 * NS, rtol=1e-14)  # half-height width × top
    np.testing.assert_allclose(w.gate_area(GATES[2]), 0.9 * 2.0 * NS * np.sqrt(np.pi / (4.0 * np.log(2.0))), rtol=1e-14)
    np.testing.assert_allclose(w.gate_area(GATES[3]), 1.7 * NS, rtol=1e-13)
    closing = w.gate_transmission(GATES[1], [-0.25 * NS, 0.25 * NS, 1.5 * NS, 2.0 * NS, 2.5 * NS])
    np.testing.assert_allclose(closing, [0.0, 1.0, 1.0, 0.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(w.gate_transmission(w.GaussianGate(NS, 0.7), 0.5 * NS), 0.7, rtol=1e-14)


def test_sampled_pulse_forgets_offset_and_scale() -> None:
    value = (0.0, 1.0, 4.0, 3.0, 1.0, 0.0)
    t = np.linspace(-1.0, 1.0, 101) * NS
    base = w.pulse_density(w.SampledPulse(0.2 * NS, value), t)
    padded = w.SampledPulse(0.2 * NS, (0.0, 0.0, 0.0, *(7.0 * v for v in value), 0.0))
    np.testing.assert_allclose(w.pulse_density(padded, t), base, rtol=1e-11, atol=1e-9 / NS)


@pytest.mark.parametrize("pulse", PULSES, ids=repr)
@pytest.mark.parametrize("sigma_ns", [0.05, 0.5])
def test_jitter_broadens(pulse: w.Pulse, sigma_ns: float) -> None:
    wide = w.broadened(pulse, sigma_ns * NS)
    # Variances add; the sampled forms are compensated to (step/σ)⁴ ~ 1e-6.
    np.testing.assert_allclose(w.pulse_variance(wide), w.pulse_variance(pulse) + (sigma_ns * NS) ** 2, rtol=1e-6)
    # R of the broadened pulse is the mean of R over the jitter: trapezoid rule over ±8σ with 1601 nodes. On a gate
    # without jumps R' is continuous, so its error is below (σ/100)³ R'' ~ 1e-7.
    node = np.linspace(-8.0, 8.0, 1601)
    weight = np.exp(-0.5 * node**2) * (node[1] - node[0])
    gate = GATES[1]
    u = np.linspace(*correlation_support(pulse, gate), 41)
    shifted = correlation(pulse, gate, u[:, None] + sigma_ns * NS * node) @ (weight / np.sqrt(2.0 * np.pi))
    np.testing.assert_allclose(correlation(wide, gate, u), shifted, atol=1e-6)


def test_jitter_limits() -> None:
    for pulse in PULSES:
        assert w.broadened(pulse, 0.0) is pulse
    assert w.broadened(PULSES[1], 1e-6 * NS) is PULSES[1]
    assert isinstance(w.broadened(PULSES[0], NS), w.GaussianPulse)
    with pytest.raises(ValueError, match="sigma_s"):
        w.broadened(PULSES[0], -1.0)


@pytest.mark.parametrize("pulse", PULSES[:6], ids=repr)
def test_pulse_samples_keep_area_and_centroid(pulse: w.Pulse) -> None:
    step = 0.02 * NS
    start, value = w.sample_pulse(pulse, step)
    area, centre, variance = moments(start, step, value)
    np.testing.assert_allclose(area, 1.0, rtol=1e-12)
    assert abs(centre) < 1e-12 * NS
    # Documented: step²/6 more, or step²/3 for jumping pulses; kinks between grid points change it by the same order.
    assert abs(variance - w.pulse_variance(pulse)) < 0.5 * step**2
    # R from the samples is R to the same order: ½·step²/3·|R''| < 1.5e-3 of the peak on a gate with 0.5 ns edges.
    sampled = w.SampledPulse(step, tuple(value))
    u = np.linspace(-4.0, 4.0, 81) * NS
    np.testing.assert_allclose(correlation(sampled, GATES[1], u), correlation(pulse, GATES[1], u), atol=1e-3)


@pytest.mark.parametrize("gate", GATES[:5], ids=repr)
def test_gate_samples_keep_area(gate: w.Gate) -> None:
    step = 0.02 * NS
    start, value = w.sample_gate(gate, step)
    sampled = w.SampledGate(start, step, tuple(value))
    # Hats keep the area exactly; point samples err by step²/12·Σ|Δg'| < 1e-4 of it.
    np.testing.assert_allclose(w.gate_area(sampled), w.gate_area(gate), rtol=1e-4)
    u = np.linspace(-3.0, 8.0, 111) * NS
    want = correlation(PULSES[0], gate, u)
    np.testing.assert_allclose(correlation(PULSES[0], sampled, u), want, atol=1e-3)
    assert np.all(value >= 0.0) and np.all(value <= 1.0 + 1e-12)


def test_samples_of_samples_are_themselves() -> None:
    pulse, gate = PULSES[7], GATES[5]
    assert isinstance(pulse, w.SampledPulse) and isinstance(gate, w.SampledGate)
    start, value = w.sample_pulse(pulse, pulse.step_s)
    t = start + pulse.step_s * np.arange(value.size - 1)
    np.testing.assert_allclose(value[:-1], w.pulse_density(pulse, t + 1e-9 * NS), rtol=1e-6)
    np.testing.assert_allclose(value / value[1], np.array(pulse.value) / pulse.value[1], rtol=1e-12)
    gate_start, gate_value = w.sample_gate(gate, gate.step_s)
    assert gate_start == gate.start_s and tuple(gate_value) == gate.value


def test_shapes_from_specs() -> None:
    assert w.pulse_from_spec(specs.ExponentialPulse(fwhm_s=1e-9, tail_s=2e-9)) == w.ExponentialPulse(1e-9, 2e-9)
    assert w.gate_from_spec(specs.GaussianGate(fwhm_s=1e-9, transmission=0.5)) == w.GaussianGate(1e-9, 0.5)
    measured = specs.SampledGate(start_s=0.0, step_s=1e-10, value=(0.0, 1.0, 0.0))
    assert w.gate_from_spec(measured) == w.SampledGate(0.0, 1e-10, (0.0, 1.0, 0.0))
    with pytest.raises(TypeError, match="not a pulse"):
        w.pulse_from_spec(object())
    with pytest.raises(TypeError, match="not a gate"):
        w.gate_from_spec(w.GaussianPulse(1e-9))


def test_every_spec_has_its_shape() -> None:
    for name in specs.__all__:
        # A measured curve is a sampled one by the time that a scene is loaded.
        if name not in ("Pulse", "Gate", "MeasuredPulse", "MeasuredGate"):
            fields = set(getattr(specs, name).model_fields) - {"kind"}
            assert fields == set(getattr(w, name).__dataclass_fields__)


@pytest.mark.parametrize(
    "shape",
    [
        w.GaussianPulse(0.0),
        w.RectangularPulse(-1.0),
        w.TrapezoidalPulse(0.0, 0.0, 0.0),
        w.TrapezoidalPulse(-1.0, 2.0, 1.0),
        w.ExponentialPulse(1.0, float("nan")),
        w.SampledPulse(1.0, (1.0, -2.0, 0.5)),
        w.SampledPulse(0.0, (0.0, 1.0, 0.0)),
    ],
    ids=repr,
)
def test_impossible_pulses(shape: w.Pulse) -> None:
    with pytest.raises(ValueError, match=r"positive|at least 0"):
        w.pulse_density(shape, 0.0)


def test_impossible_gates_and_steps() -> None:
    for gate in (w.RectangularGate(0.0, 1.0), w.TrapezoidalGate(1.0, 2.0, 2.0, 1.0), w.ExponentialGate(-1.0, 1.0, 1.0)):
        with pytest.raises(ValueError, match=r"width_s"):
            w.gate_transmission(gate, 0.0)
    with pytest.raises(ValueError, match="step_s"):
        w.sample_pulse(PULSES[0], 1.0)
    with pytest.raises(ValueError, match="step_s"):
        w.sample_gate(GATES[0], 0.0)
