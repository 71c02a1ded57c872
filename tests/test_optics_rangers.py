"""Laws of one-detector rangers: detector response, pile-up, counter, amplitude modulation."""

from __future__ import annotations

import numpy as np
import pytest

from beambench.optics import amcw, pile_up
from beambench.optics import time_of_flight as tof
from beambench.optics.constants import C_M_PER_S
from beambench.optics.correlation import detector_response as dr
from beambench.optics.correlation.pulses import (
    ExponentialPulse,
    GaussianPulse,
    RectangularPulse,
    SampledPulse,
    TrapezoidalPulse,
    pulse_density,
    pulse_support,
    pulse_variance,
)

PULSES = [
    GaussianPulse(1e-9),
    ExponentialPulse(0.6e-9, 0.5e-9),
    TrapezoidalPulse(0.3e-9, 1e-9, 0.6e-9),
    RectangularPulse(1.5e-9),
    SampledPulse(0.2e-9, (0.0, 1.0, 4.0, 2.0, 1.0, 0.5, 0.0)),
]


@pytest.mark.parametrize("shape", ["gaussian", "single-pole"])
@pytest.mark.parametrize("pulse", PULSES, ids=lambda p: type(p).__name__)
def test_detected_pulse_is_the_convolution_by_quadrature(pulse, shape: dr.Shape) -> None:  # type: ignore[no-untyped-def]
    rise = 300e-12
    # A quadrature that knows nothing of the closed forms: 2^18 steps over the pulse, midpoints.
    low, high = pulse_support(pulse)
    s = low + (high - low) * (np.arange(1 << 18) + 0.5) / (1 << 18)
    weight = pulse_density(pulse, s) * (high - low) / (1 << 18)
    t = np.linspace(low - 0.5e-9, low + 4e-9, 23)
    exact = np.array([(weight * dr.impulse_response(shape, rise, ti - s)).sum() for ti in t])
    found = dr.detected_density(pulse, shape, rise, t)
    # Sampled at 48 to the narrower width: lines miss a curve by (1/48)²/8 of its curvature, 5e-5; a pulse that jumps is
    # a hat wide there, which moves a corner of the answer by up to a step's share of τ: 1e-2/4.
    worst = 4e-3 if isinstance(pulse, RectangularPulse) and shape == "single-pole" else 3e-4
    assert np.abs(found - exact).max() < worst * exact.max()


@pytest.mark.parametrize("pulse", PULSES, ids=lambda p: type(p).__name__)
def test_variances_add_and_the_pole_delays_by_its_time(pulse) -> None:  # type: ignore[no-untyped-def]
    for shape in ("gaussian", "single-pole"):
        shown, delay = dr.detected_pulse(pulse, shape, 400e-12)
        total = pulse_variance(pulse) + dr.response_variance(shape, 400e-12)
        assert pulse_variance(shown) == pytest.approx(total, rel=1e-3, abs=0.0)
        assert delay == (0.0 if shape == "gaussian" else dr.pole_time(400e-12))


def test_rise_times_and_bandwidths() -> None:
    t = np.linspace(-2e-9, 4e-9, 600_001)
    for shape in ("gaussian", "single-pole"):
        step = np.cumsum(dr.impulse_response(shape, 300e-12, t)) * (t[1] - t[0])
        rise = t[np.searchsorted(step, 0.9)] - t[np.searchsorted(step, 0.1)]
        assert rise == pytest.approx(300e-12, abs=1e-13)
        # |H| at the stated bandwidth is 1/√2.
        f = dr.bandwidth_hz(shape, 300e-12)
        h = (dr.impulse_response(shape, 300e-12, t) * np.exp(-2j * np.pi * f * t)).sum() * (t[1] - t[0])
        assert abs(h) == pytest.approx(np.sqrt(0.5), rel=1e-3)
    assert dr.bandwidth_hz("single-pole", 300e-12) * 300e-12 == pytest.approx(0.35, abs=1e-3)


def test_a_detector_needs_a_rise_time() -> None:
    with pytest.raises(ValueError, match="rise_time_s"):
        dr.detected_pulse(PULSES[0], "gaussian", 0.0)


@pytest.mark.parametrize("dead", [0, 1, 5, 40])
def test_expected_counts_against_all_histories_by_enumeration_of_pulses(dead: int) -> None:
    # One pulse followed bin by bin: the chance to be live is 1 minus the chances of a count in the last `dead` bins.
    rng = np.random.default_rng(3)
    rate = rng.uniform(0, 0.6, 40)
    counts, live = pile_up.expected_counts(rate, 1.0, dead)
    chance = -np.expm1(-rate)
    if dead >= 40:  # first photon only: Π of the chances of silence before
        silence = np.concatenate([[1.0], np.cumprod(1 - chance)[:-1]])
        np.testing.assert_allclose(live, silence, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(counts, silence * chance, rtol=1e-12, atol=1e-15)
    # Simulated pulse by pulse, 40,000 of them; 5 standard errors.
    until = np.zeros(40_000, dtype=int)
    seen = np.zeros(40)
    for k in range(40):
        hit = (until <= k) & (rng.random(until.size) < chance[k])
        seen[k] = hit.sum()
        until[hit] = k + 1 + dead
    spread = np.sqrt(until.size * counts * (1 - counts))
    assert (np.abs(seen - until.size * counts) < 5 * spread + 1e-9).all()


@pytest.mark.parametrize("dead", [0, 3, 64])
def test_coates_undoes_pile_up(dead: int) -> None:
    rate = 0.02 + 0.8 * np.exp(-0.5 * ((np.arange(64) - 30) / 3.0) ** 2)
    counts, live = pile_up.expected_counts(rate, 5000.0, dead)
    back, variance = pile_up.coates_rate(counts, 5000.0, dead)
    np.testing.assert_allclose(back, rate, rtol=1e-10)
    np.testing.assert_allclose(pile_up.live_pulses(counts, 5000.0, dead), live, rtol=1e-12)
    # Its variance is the inverse of the information: live/(e^λ − 1).
    np.testing.assert_allclose(variance * pile_up.count_information(rate, live), 1.0, rtol=1e-10)
    if dead == 64:
        assert np.argmax(counts) < 30  # uncorrected, the peak is early


def test_coates_says_where_it_knows_nothing() -> None:
    rate, variance = pile_up.coates_rate(np.array([[5.0, 5.0, 0.0]]), 10.0, 3)
    assert rate[0, 0] == pytest.approx(np.log(2)) and np.isnan(rate[0, 1:]).all() and np.isnan(variance[0, 1:]).all()


def test_dead_time_is_rounded_up_to_bins() -> None:
    assert [pile_up.dead_bins(t, 1e-9, 100) for t in (0.0, 0.3e-9, 1e-9, 1.01e-9, 1.0)] == [0, 1, 1, 2, 100]
    # Generator, estimators and bounds share it, so it is counted here anew, in whole picoseconds.
    for dead_ps in range(0, 12_000, 370):
        blind = sum(1 for k in range(100) if k * 100 < dead_ps)  # bins that begin before the detector is live again
        assert pile_up.dead_bins(dead_ps * 1e-12, 1e-10, 100) == blind


def test_counter_errors_are_even_or_triangular() -> None:
    rng = np.random.default_rng(1)
    t = rng.uniform(1e-8, 1e-6, 200_000)
    locked = (tof.count_cycles(t, 1e9) + 0.5) / 1e9 - t
    assert np.abs(locked).max() <= 0.5e-9 * (1 + 1e-6)
    # rms of an even error is step/√12; 4 standard errors of 200,000 draws are 4·.447/√N = .4 %.
    assert locked.std() == pytest.approx(1e-9 / np.sqrt(12), rel=4e-3)
    free = tof.count_cycles(t, 1e9, rng.random(t.size)) / 1e9 - t
    assert free.mean() == pytest.approx(0.0, abs=4 * 0.41e-9 / np.sqrt(t.size))
    assert free.std() == pytest.approx(1e-9 / np.sqrt(6), rel=6e-3)
    fraction = 0.3
    same = tof.count_cycles(np.full(100_000, 10.3e-9), 1e9, rng.random(100_000))
    assert same.var() == pytest.approx(fraction * (1 - fraction), rel=0.02)
    assert tof.pulse_distance_eq23(20e-9, 2e8) == pytest.approx(2.0)
    assert tof.counter_range_step(1e9, 2e8) == pytest.approx(0.1)


def test_whole_and_part_cycles_give_the_distance_back() -> None:
    rng = np.random.default_rng(2)
    d = rng.uniform(0.1, 300.0, 1000)
    wave = float(amcw.modulation_wavelength(20e6, 1.36))
    assert wave == pytest.approx(C_M_PER_S / 1.36 / 20e6)
    phase = amcw.phase_of_range(d, 20e6, 1.36)
    for reference in (0.0, 1.0, -7.0):
        part = amcw.part_wave_eq25(phase + reference, reference, wave)
        assert (part >= 0).all() and (part < wave).all()
        n = amcw.whole_cycles(d + rng.uniform(-0.24, 0.24, d.size) * wave, part, wave)
        np.testing.assert_allclose(amcw.distance_eq24(n, part, wave), d, rtol=1e-9)
    # Beyond a quarter of a wavelength the whole number is wrong.
    assert (amcw.whole_cycles(d + 0.26 * wave, part, wave) == n + 1).all()


def test_phases_repeat_after_the_unambiguous_range() -> None:
    frequencies = np.array([12e6, 44e6, 150e6])
    far = amcw.unambiguous_range(frequencies, 1.357)
    turns = amcw.phase_of_range(far, frequencies, 1.357) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.rint(turns), atol=1e-9)
    assert far == pytest.approx(C_M_PER_S / (2 * 1.357 * 2e6))


def test_phase_variance_of_four_samples_is_lange_and_seitz() -> None:
    a, b, contrast = 5000.0, 1000.0, 0.3
    rng = np.random.default_rng(5)
    phi = 2 * np.pi * np.arange(4) / 4
    mean = amcw.correlation_sample(a, contrast, 0.7e-9, 2e8, phi) + b
    z = rng.poisson(mean, (100_000, 4))
    angle = np.angle((z * np.exp(1j * phi)).sum(axis=1) * np.exp(-2j * np.pi * 2e8 * 0.7e-9))
    predicted = float(amcw.phase_variance(a * contrast, a + b, 4))
    assert predicted == pytest.approx((a + b) / (2 * (a * contrast) ** 2))
    # 4 standard errors of a variance from 100,000 draws: 1.8 %; the second order of the angle adds 2 var: .5 %.
    assert angle.var() == pytest.approx(predicted, rel=0.023)
