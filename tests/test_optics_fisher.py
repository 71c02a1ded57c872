"""Tables of information, and the range bound of gated stacks, against closed forms and Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest

from beambench.optics.constants import C_M_PER_S, FWHM_PER_SIGMA
from beambench.optics.likelihood.fisher import (
    information_table,
    range_bound,
    range_sigma,
    stack_information,
    tau_bound,
)
from beambench.optics.likelihood.sample import NoiseModel, information, log_pmf
from beambench.optics.reflection.angles import Array

COUNTER = NoiseModel(0.0, 1.0, 0.0, 65535, 1e9)


def _stack(step: float, photons: float, background: float = 0.0) -> tuple[Array, Array, Array, Array]:
    """Gaussian R, σ = 1 s, `photons` in the stack: μ, ∂μ/∂τ, ∂μ/∂a, ∂μ/∂b of shape (slice, 1)."""
    t = np.arange(-8.0, 8.0 + 0.5 * step, step)[:, None]
    shape = step * np.exp(-0.5 * t * t) / np.sqrt(2.0 * np.pi)
    return photons * shape + background, photons * shape * t, shape, np.ones_like(t)


@pytest.mark.parametrize(
    "noise",
    [
        NoiseModel(2.0, 1.0, 20.0, 4095, 2e4),
        NoiseModel(3.0, 0.05, 10.0, 4095, 3e4),
        NoiseModel(1.0, 2.0, 20.0, 65535, 1e4),
        NoiseModel(0.0, 1.0, 0.0, 4095, 1e4),
        NoiseModel(5.0, 0.2, 20.0, 4095, 1e5, 2.0, 20.0),
        NoiseModel(10.0, 0.05, 20.0, 4095, 5e4, 1.6, 200.0, 0.5),
    ],
)
def test_table_matches_the_exact_information(noise: NoiseModel) -> None:
    table = information_table(noise)
    rng = np.random.default_rng(4)
    mu = np.exp(rng.uniform(np.log(1e-4), np.log(table.mu_max), 150))
    exact = np.array([information(noise, float(m)) for m in mu])
    keep = exact * mu > 1e-4  # beyond, saturation has left nothing that counts
    np.testing.assert_allclose(table(mu)[keep], exact[keep], rtol=1e-3)
    assert np.all(table(np.array([2.0, 10.0]) * table.mu_max) == 0.0)
    assert table(np.full((3, 4), 2.0)).shape == (3, 4) and np.all(np.isfinite(table([0.0, -1.0, 1e-9])))
    assert information_table(noise) is table


def test_dense_gaussian_stack_meets_the_closed_form() -> None:
    """σ_r = cσ_t/(2√N): FWHM 1 ns and N = 10,027 give .6357 mm."""
    sigma_t = 1e-9 / FWHM_PER_SIGMA
    mu, d_tau, d_a, d_b = _stack(0.25, 10_027.0)
    table = information_table(COUNTER)
    bound = range_bound(
        np.maximum(mu, 1e-9), d_tau / sigma_t, d_a, d_b, table, group_index=1.0,
        amplitude_known=True, background_known=True,
    )  # fmt: skip
    assert float(bound[0]) == pytest.approx(C_M_PER_S * sigma_t / (2.0 * np.sqrt(10_027.0)), rel=1e-3)
    assert float(bound[0]) == pytest.approx(0.6357e-3, abs=5e-8 + 1e-3 * 0.6357e-3)
    # By symmetry the nuisances are orthogonal to τ in a centred stack: profiling them costs nothing.
    free = range_bound(np.maximum(mu, 1e-9), d_tau / sigma_t, d_a, d_b, table, group_index=1.0)
    assert float(free[0]) == pytest.approx(float(bound[0]), rel=1e-6)
    assert float(range_sigma(1e-9, 1.357)) == pytest.approx(C_M_PER_S * 1e-9 / 2.714)


@pytest.mark.parametrize("photons, factor", [(100.0, 1.21), (1000.0, 1.04)])
def test_whole_stack_beats_the_moment_form(photons: float, factor: float) -> None:
    """F² = 2, delays every 0.3 σ: the stack's information over Σ(∂μ)²/(F²μ)."""
    noise = NoiseModel(1e-4, 400.0, 20.0, 65535, 1e9, 2.0, 1.0)
    mu, d_tau, d_a, d_b = _stack(0.3, photons)
    mu = np.maximum(mu, 1e-9)
    exact = stack_information(mu, d_tau, d_a, d_b, information_table(noise))[0, 0, 0]
    assert exact / float(np.sum(d_tau**2 / (2.0 * mu))) == pytest.approx(factor, abs=0.01)


def test_matrix_and_profiling_match_dense_algebra() -> None:
    rng = np.random.default_rng(1)
    noise = NoiseModel(2.0, 1.0, 20.0, 4095, 2e4)
    table = information_table(noise)
    mu = rng.uniform(1.0, 200.0, (20, 5))
    d = rng.normal(size=(3, 20, 5))
    f = np.einsum("kp,ikp,jkp->pij", table(mu), d, d)
    np.testing.assert_allclose(stack_information(mu, *d, table), f, rtol=1e-12)
    np.testing.assert_allclose(tau_bound(mu, *d, table), np.sqrt(np.linalg.inv(f)[:, 0, 0]), rtol=1e-10)
    two = np.sqrt(np.linalg.inv(f[:, :2, :2])[:, 0, 0])
    np.testing.assert_allclose(tau_bound(mu, *d, table, background_known=True), two, rtol=1e-10)
    other = np.sqrt(np.linalg.inv(f[:, ::2, ::2])[:, 0, 0])
    np.testing.assert_allclose(tau_bound(mu, *d, table, amplitude_known=True), other, rtol=1e-10)
    alone = tau_bound(mu, *d, table, amplitude_known=True, background_known=True)
    np.testing.assert_allclose(alone, f[:, 0, 0] ** -0.5, rtol=1e-12)


def test_no_information_is_infinite_not_an_error() -> None:
    table = information_table(NoiseModel(2.0, 1.0, 20.0, 4095, 2e4))
    mu, d_tau, d_a, d_b = _stack(0.5, 500.0, 2.0)
    assert np.isinf(tau_bound(mu, 0.0 * d_tau, d_a, d_b, table)[0])
    assert np.isinf(tau_bound(np.full_like(mu, 1e7), d_tau, d_a, d_b, table)[0])  # every slice saturated
    # A delay that acts exactly like the amplitude cannot be distinguished from it.
    assert np.isinf(tau_bound(mu, 3.0 * d_a, d_a, d_b, table)[0])
    # A nuisance that the stack does not see is left out.
    assert np.isfinite(tau_bound(mu, d_tau, d_a, 0.0 * d_b, table)[0])
    # Two nuisances that are the same one count once.
    twin = tau_bound(mu, d_tau, d_a, 2.0 * d_a, table)
    np.testing.assert_allclose(twin, tau_bound(mu, d_tau, d_a, d_b, table, background_known=True), rtol=1e-6)
    with pytest.raises(ValueError, match="slice, pixel"):
        stack_information(mu[:, 0], d_tau[:, 0], d_a[:, 0], d_b[:, 0], table)


def test_maximum_likelihood_meets_the_bound() -> None:
    """A one-step (Fisher scoring) estimator from the truth: variance of 4000 stacks within 4 standard errors.

    One scoring step from the true parameters has exactly the bound's covariance where score and table agree, so this
    tests both against the law that made the draws.
    """
    rng = np.random.default_rng(21)
    noise = NoiseModel(1.5, 0.7, 12.0, 1023, 1e4)
    mu, d_tau, d_a, d_b = _stack(1.0, 60.0, 0.5)
    trials = 4000
    n = rng.poisson(mu, (mu.shape[0], trials))
    dn = np.clip(np.rint(0.7 * (n + rng.normal(0.0, 1.5, n.shape)) + 12.0), 0, 1023).astype(np.int64)
    step = 1e-4 * mu
    slope = (log_pmf(noise, dn, mu + step) - log_pmf(noise, dn, mu - step)) / (2.0 * step)
    gradient = np.stack([(slope * d).sum(axis=0) for d in (d_tau, d_a, d_b)])
    table = information_table(noise)
    inverse = np.linalg.inv(stack_information(mu, d_tau, d_a, d_b, table)[0])
    tau = (inverse @ gradient)[0]
    bound = float(tau_bound(mu, d_tau, d_a, d_b, table)[0])
    assert abs(tau.mean()) < 4.0 * bound / np.sqrt(trials)
    assert tau.var() / bound**2 == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / trials))
