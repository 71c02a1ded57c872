"""The detector's exact likelihood against independently coded numbers, closed forms and limits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import special, stats

from beambench.optics.likelihood.fisher import information_table, moment_information, quadratic_information
from beambench.optics.likelihood.sample import NoiseModel, distribution, information, log_pmf, pmf, score
from beambench.optics.reflection.angles import Array


def _edges(noise: NoiseModel) -> Array:
    """Upper edges of all codes, in electrons; the last is open."""
    edges = (np.arange(noise.adc_max_dn + 1) + 0.5 - noise.offset_dn) / noise.gain_dn_per_e
    edges[-1] = np.inf
    return edges


def _numerical(noise: NoiseModel, mu: float) -> tuple[float, Array]:
    """J and P by dense matrices P(code | n) and a central difference in μ: no code shared with the package."""
    n = np.arange(max(0, int(mu - 9.0 * np.sqrt(mu) - 10.0)), int(mu + 9.0 * np.sqrt(mu) + 30.0))
    edges = _edges(noise)
    f2, gain = noise.excess_noise_factor, noise.intensifier_gain
    if f2 == 1.0:
        x = np.minimum(n * gain, noise.full_well_e)
        below = stats.norm.cdf((edges[None, :] - x[:, None]) / noise.read_noise_e)
    else:
        z, dz = np.linspace(-8.0, 8.0, 33 if mu > 100.0 else 641, retstep=True)
        below = np.zeros((n.size, edges.size))
        # Codes out of reach are all or nothing: only the rest is worth the incomplete gamma function.
        reach = 10.0 * gain * np.sqrt(f2 * mu) + 40.0 * gain * f2
        live = np.abs(edges - gain * mu) < reach + 8.0 * noise.read_noise_e
        below[:, edges > gain * mu + reach] = 1.0
        total = np.zeros((n.size, int(live.sum())))
        for zi in z:
            at = edges[live] - zi * noise.read_noise_e
            shape = np.maximum(n, 0.5)[:, None] / (f2 - 1.0)  # n = 0, the atom at zero, is put right below
            part = special.gammainc(shape, np.maximum(at, 0.0) / (gain * (f2 - 1.0)))
            part[:, at >= noise.full_well_e] = 1.0
            total += part * stats.norm.pdf(zi) * dz
        below[:, live] = total
        below[n == 0] = stats.norm.cdf(edges / noise.read_noise_e)
        below[:, -1] = 1.0
    q = np.diff(below, axis=1, prepend=0.0)
    step = 2e-4 * mu
    minus, p, plus = (stats.poisson.pmf(n, m) @ q for m in (mu - step, mu, mu + step))
    keep = p > 1e-14
    return float(np.sum(((plus - minus)[keep] / (2.0 * step)) ** 2 / p[keep])), p


BARE = [
    NoiseModel(1.0, 1.0, 20.0, 2047, 1e5),
    NoiseModel(2.5, 0.5, 10.5, 1023, 1e5),
    NoiseModel(0.3, 2.0, 20.0, 4095, 1e5),
    NoiseModel(8.0, 1.0, 0.0, 2047, 1000.0),  # clipped at zero and at the full well
    NoiseModel(3.0, 0.03, 2.2, 40, 1e5),  # coarse codes
]


@pytest.mark.parametrize("noise", BARE)
@pytest.mark.parametrize("mu", [0.1, 1.0, 10.0, 1000.0])
def test_bare_information_against_a_numerical_likelihood(noise: NoiseModel, mu: float) -> None:
    expected, p = _numerical(noise, mu)
    assert information(noise, mu) == pytest.approx(expected, rel=1e-5)  # the central difference's own error is 1e-6
    np.testing.assert_allclose(pmf(noise, mu), p, atol=1e-13)


@pytest.mark.parametrize(
    "noise",
    [
        NoiseModel(5.0, 0.02, 20.0, 700, 1e6, 2.0, 20.0),
        NoiseModel(2.0, 0.2, 20.0, 1100, 1e6, 1.4, 5.0),
        NoiseModel(2.0, 0.1, 5.0, 500, 1e6, 3.0, 4.0),
        NoiseModel(5.0, 0.02, 20.0, 700, 19_000.0, 2.0, 20.0),  # full well near the mean at 1000
    ],
)
@pytest.mark.parametrize("mu", [0.1, 1.0, 10.0, 1000.0])
def test_intensified_information_against_a_numerical_likelihood(noise: NoiseModel, mu: float) -> None:
    expected, p = _numerical(noise, mu)
    assert information(noise, mu) == pytest.approx(expected, rel=1e-3)
    law = distribution(noise, mu)
    assert np.max(np.abs(law.p - p[law.dn])) < 1e-3 * np.max(p)
    assert law.p.sum() == pytest.approx(1.0, abs=1e-8)


def _bessel_information(mu: float) -> float:
    """F² = 2, no read noise, continuous output: density e^(−μ−x)√(μ/x) I₁(2√(μx)) and an atom e^(−μ) at zero."""
    u, w = np.polynomial.legendre.leggauss(400)
    root = np.sqrt(mu + 12.0 * np.sqrt(2.0 * mu) + 40.0)
    x, weight = (0.5 * (u + 1.0) * root) ** 2, 0.5 * w * root * (u + 1.0) * root

    def density(m: float) -> Array:
        return np.exp(-((np.sqrt(x) - np.sqrt(m)) ** 2)) * np.sqrt(m / x) * special.ive(1, 2.0 * np.sqrt(x * m))

    step = 1e-4 * mu
    slope = (density(mu + step) - density(mu - step)) / (2.0 * step)
    return float(np.exp(-mu) + np.sum(weight * slope**2 / density(mu)))


def test_a_noise_free_intensifier_tends_to_the_bessel_law() -> None:
    assert _bessel_information(1.0) * 2.0 == pytest.approx(1.42, abs=0.01)
    # Codes of 0.01 outputs blur the atom at zero with outputs under half a code: loss of the order of a code's mass.
    fine = NoiseModel(1e-4, 400.0, 20.0, 65535, 1e9, 2.0, 1.0)
    assert information(fine, 1.0) == pytest.approx(_bessel_information(1.0), rel=6e-3)
    for mu in (10.0, 100.0):
        assert information(fine, mu) == pytest.approx(_bessel_information(mu), rel=1e-3)


def test_measured_excess_over_the_moment_form() -> None:
    """F² = 2 at 1 photoelectron: ×1.42; read noise of 1 electron at 0.1: ×1.41, both with fine codes."""
    intensified = NoiseModel(1e-4, 400.0, 20.0, 65535, 1e9, 2.0, 1.0)
    assert information(intensified, 1.0) / float(moment_information(intensified, 1.0)) == pytest.approx(1.42, abs=0.01)
    bare = NoiseModel(1.0, 20.0, 400.0, 65535, 1e9)
    assert information(bare, 0.1) / float(moment_information(bare, 0.1)) == pytest.approx(1.41, abs=0.01)


@pytest.mark.parametrize("mu", [1e-3, 0.1, 1.0, 10.0, 1000.0])
def test_a_perfect_counter_has_one_over_mu(mu: float) -> None:
    assert information(NoiseModel(0.0, 1.0, 0.0, 65535, 1e9), mu) == pytest.approx(1.0 / mu, rel=1e-9)
    dark = NoiseModel(0.0, 1.0, 0.0, 65535, 1e9, dark_e=2.0)
    assert information(dark, mu) == pytest.approx(1.0 / (mu + 2.0), rel=1e-9)


@pytest.mark.parametrize("mu", [50.0, 500.0, 5000.0])
def test_gaussian_limit_under_strong_read_noise(mu: float) -> None:
    noise = NoiseModel(60.0, 1.0, 600.0, 65535, 1e9)
    gaussian = 1.0 / (mu + 3600.0 + 1.0 / 12.0)
    assert gaussian <= information(noise, mu) <= gaussian * (1.0 + 0.5 / (mu + 3600.0) + 1e-6)


@pytest.mark.parametrize("factor, gain, floor", [(1.0, 1.0, 300.0), (2.0, 20.0, 400.0), (3.0, 20.0, 400.0)])
def test_second_order_form_joins_the_exact_one(factor: float, gain: float, floor: float) -> None:
    noise = NoiseModel(3.0, 0.5, 20.0, 65535, 1e9, factor, gain)
    for mu in (floor, 2.0 * floor):
        assert float(quadratic_information(noise, mu)) == pytest.approx(information(noise, mu), rel=3e-4)


def test_slopes_are_the_derivative() -> None:
    for noise in (BARE[0], BARE[3], NoiseModel(5.0, 0.1, 20.0, 700, 1e6, 2.0, 20.0, 3.0)):
        low, mid, high = (pmf(noise, m) for m in (2.997, 3.0, 3.003))
        law = distribution(noise, 3.0)
        np.testing.assert_allclose(law.slope, ((high - low) / 0.006)[law.dn], atol=2e-6)
        assert abs(law.slope.sum()) < 1e-8 and mid.sum() == pytest.approx(1.0, abs=1e-8)


def test_moments_of_the_intensified_chain() -> None:
    """Mean Gμ + dark and variance G²F²μ + dark + σ² + 1/12K², in electrons; 1e-3 is the lattice's stated error."""
    for mu in (0.5, 20.0, 150.0, 400.0):
        noise = NoiseModel(4.0, 0.5, 50.0, 65535, 1e9, 1.7, 12.0, 5.0)
        law = distribution(noise, mu)
        x = (law.dn - 50.0) / 0.5
        mean = float(law.p @ x)
        assert mean == pytest.approx(12.0 * mu + 5.0, rel=1e-6)
        expected = 144.0 * 1.7 * mu + 5.0 + 16.0 + 1.0 / 3.0
        assert float(law.p @ (x - mean) ** 2) == pytest.approx(expected, rel=1e-3)


def test_log_pmf_and_score_agree_with_the_linear_form_and_reach_the_tails() -> None:
    noise = BARE[1]
    law = distribution(noise, 30.0)
    keep = law.p > 1e-10
    np.testing.assert_allclose(log_pmf(noise, law.dn[keep], 30.0), np.log(law.p[keep]), atol=1e-9)
    np.testing.assert_allclose(score(noise, law.dn[keep], 30.0), law.slope[keep] / law.p[keep], atol=1e-7)
    far = log_pmf(noise, np.arange(1024)[:, None], np.array([0.01, 3.0, 5000.0]))
    assert far.shape == (1024, 3) and np.all(np.isfinite(far)) and far.min() < -1000.0
    np.testing.assert_allclose(np.exp(far).sum(axis=0), 1.0, atol=1e-9)
    assert np.all(np.isnan(log_pmf(noise, 5, [0.0, -1.0]))) and log_pmf(noise, -1, 3.0) == -np.inf
    bright = NoiseModel(5.0, 0.1, 20.0, 700, 1e6, 2.0, 20.0)
    dn = distribution(bright, 8.0)
    assert float(log_pmf(bright, 36, 8.0)) == pytest.approx(np.log(dn.p[36 - dn.first_dn]))


def test_saturation_takes_the_information() -> None:
    for noise in (NoiseModel(5.0, 0.05, 20.0, 4095, 5e4), NoiseModel(5.0, 0.05, 20.0, 1023, 1e6),
                  NoiseModel(5.0, 0.05, 20.0, 4095, 5e4, 2.0, 30.0)):  # fmt: skip
        full = noise.ceiling_e / noise.intensifier_gain
        spread = np.sqrt(noise.well_variance_e2(full)) / noise.intensifier_gain
        share = [
            information(noise, float(m)) / float(quadratic_information(noise, m))
            for m in full + spread * np.arange(-6, 7)
        ]
        assert share[0] == pytest.approx(1.0, abs=2e-3) and share[-1] < 1e-5
        assert np.all(np.diff(share) < 1e-3)
        # At the clip half the samples are lost; their fraction still holds information: ½ + (∫φz over half)²/½ = ½ + 1/π, to 1/√μ.
        assert share[6] == pytest.approx(0.5 + 1.0 / np.pi, abs=0.03)


def test_random_draws_follow_the_law() -> None:
    """2·10⁵ draws of the chain, chi-squared within 5 standard deviations of its own, for both branches."""
    rng = np.random.default_rng(8)
    count = 200_000
    for noise in (
        NoiseModel(2.0, 0.5, 10.0, 60, 80.0, dark_e=1.0),
        NoiseModel(2.0, 0.5, 10.0, 120, 150.0, 2.0, 8.0, 1.0),
    ):
        mu = 7.0
        n = rng.poisson(mu, count).astype(np.float64)
        dark = rng.poisson(1.0, count)
        excess = noise.excess_noise_factor - 1.0
        if excess > 0.0:
            n = rng.gamma(np.maximum(n, 1e-9) / excess, noise.intensifier_gain * excess) * (n > 0)
        x = np.minimum(n + dark, noise.full_well_e) + rng.normal(0.0, noise.read_noise_e, count)
        dn = np.clip(np.rint(noise.gain_dn_per_e * x + noise.offset_dn), 0, noise.adc_max_dn).astype(int)
        p = pmf(noise, mu)
        keep = p * count > 10.0
        seen = np.bincount(dn, minlength=p.size)
        chi2 = float(np.sum((seen - count * p)[keep] ** 2 / (count * p[keep])))
        cells = int(keep.sum())
        assert abs(chi2 - cells) < 5.0 * np.sqrt(2.0 * cells)


@pytest.mark.parametrize("key, value", [("read_noise_e", -1.0), ("gain_dn_per_e", 0.0), ("full_well_e", np.nan),
                                        ("excess_noise_factor", 0.9), ("adc_max_dn", 0)])  # fmt: skip
def test_values_outside_physics_are_refused(key: str, value: float) -> None:
    good = {"read_noise_e": 1.0, "gain_dn_per_e": 1.0, "offset_dn": 0.0, "adc_max_dn": 255, "full_well_e": 1e4}
    with pytest.raises(ValueError, match=key):
        NoiseModel(**(good | {key: value}))
    with pytest.raises(ValueError, match="positive"):
        information(NoiseModel(**good), 0.0)


@pytest.mark.parametrize("read_noise", [40.0, 150.0, 600.0])
@pytest.mark.parametrize("mu", [0.5, 60.0, 900.0])
def test_information_at_large_read_noise_is_the_sum_over_all_codes(read_noise: float, mu: float) -> None:
    """Where code 0 is reached, codes are joined by a spline: held against every code, summed here by scipy's own laws.

    A spline of codes σ/12 apart errs by 1e-5; codes at σ/3 would err by .3 %, and end codes taken as the others by over 1 %.
    """
    from scipy.stats import norm, poisson

    noise = NoiseModel(read_noise_e=read_noise, gain_dn_per_e=1.0, offset_dn=100.0, adc_max_dn=4095, full_well_e=1e5)
    n = np.arange(0, int(mu + 12 * np.sqrt(mu) + 40))
    weight, slope = poisson.pmf(n, mu), poisson.pmf(n - 1, mu) - poisson.pmf(n, mu)
    edges = np.concatenate([[-np.inf], np.arange(4095) + 0.5 - 100.0, [np.inf]])
    # Differences of the nearer tail keep their digits.
    left, right = norm.cdf((edges[None] - n[:, None]) / read_noise), norm.sf((edges[None] - n[:, None]) / read_noise)
    cell = np.where(left[:, 1:] < 0.5, left[:, 1:] - left[:, :-1], right[:, :-1] - right[:, 1:])
    p, dp = weight @ cell, slope @ cell
    keep = p > 1e-16
    assert information(noise, mu) == pytest.approx(float(np.sum(dp[keep] ** 2 / p[keep])), rel=3e-5)


def test_the_cost_of_the_table_does_not_grow_with_the_read_noise() -> None:
    """It took 4 s of one core at 100 electrons, minutes at 1000 and more at 10,000; 20 s are ten times what it needs now."""
    import time

    # What is compiled at the first use is not counted.
    information(
        NoiseModel(read_noise_e=50.0, gain_dn_per_e=1.0, offset_dn=100.0, adc_max_dn=4095, full_well_e=1e5), 10.0
    )
    start = time.process_time()
    for read_noise in (100.0, 1000.0, 10_000.0):
        model = NoiseModel(
            read_noise_e=read_noise, gain_dn_per_e=1.0, offset_dn=100.0, adc_max_dn=65535, full_well_e=1e5
        )
        information_table(model)
    assert time.process_time() - start < 20.0
