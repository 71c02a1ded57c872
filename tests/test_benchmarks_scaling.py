"""Exponents of synthetic costs and of real estimators; propagation through chains against simulation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.bounds.propagate import Stage, carry, chain, nonlinearity, numerical_jacobian
from beambench.benchmarks.checks.scaling import Cost, fit_exponent, measure_scaling
from beambench.scenes.errors import InputError


def planted(
    power: float, sizes: list[int], repeats: int, scatter: float, rng: Any, constant: float = 0.0
) -> list[Cost]:
    return [
        Cost(
            "x", "pixels", size, repeat, "cpu",
            (constant + 1e-6 * size**power) * math.exp(scatter * rng.normal()), 1.0, 1.0, "ok",
        )
        for size in sizes
        for repeat in range(repeats)
    ]  # fmt: skip


@pytest.mark.parametrize("power", [0.5, 1.0, 1.6])
def test_planted_exponents_lie_within_their_intervals(power: float) -> None:
    rng = np.random.default_rng(1)
    hits, widths = 0, []
    for _ in range(400):
        fit = fit_exponent(planted(power, [2**10, 2**12, 2**14, 2**16], 5, 0.1, rng))
        hits += fit.low <= power <= fit.high
        widths.append(fit.high - fit.low)
    # 95 % or more (the larger of two intervals): 400 trials, standard error 1.1 %, three of them.
    assert hits / 400 > 0.95 - 0.033
    assert np.median(widths) < 0.2


def test_a_constant_cost_shows_as_a_knee_and_widens_the_interval() -> None:
    rng = np.random.default_rng(2)
    sizes = [2**8, 2**10, 2**12, 2**14, 2**16]
    straight = fit_exponent(planted(1.0, sizes, 5, 0.005, rng))
    bent = fit_exponent(planted(1.0, sizes, 5, 0.005, rng, constant=4e-3))  # equal parts at 4,000 elements
    assert math.isnan(straight.knee)
    assert bent.knee == pytest.approx(4000, rel=0.5)
    assert bent.value < 0.8
    assert bent.high - bent.low > 5 * (straight.high - straight.low)
    assert straight.per_element_s == pytest.approx(1e-6, rel=0.02)
    assert straight.spread == pytest.approx(0.005, abs=0.006)


def test_a_cost_that_grows_faster_than_a_line_is_told() -> None:
    """a + b·n at a third of constant cost: the line holds; with a square in it, the excess is certain."""
    sizes = [16, 32, 64, 128, 256]

    def timed(square: float, rng: np.random.Generator) -> list[Cost]:
        return [
            Cost("x", "slices", n, k, "cpu", (4e-3 + 1e-4 * n + square * n * n) * math.exp(0.02 * rng.normal()), 1.0, 1.0, "ok")
            for n in sizes
            for k in range(5)
        ]  # fmt: skip

    rng = np.random.default_rng(9)
    hits = 0
    for _ in range(200):
        fit = fit_exponent(timed(0.0, rng))
        hits += fit.excess_low <= 1.0 <= fit.excess_high
    # 95 % of 200: standard error 1.5 %, three of them.
    assert hits / 200 > 0.95 - 0.046
    bent = fit_exponent(timed(1e-6, rng))
    assert bent.excess_low > 1.0
    assert math.isnan(fit_exponent(timed(0.0, rng)[::5]).excess_low)


def test_device_classes_and_estimators_are_never_mixed() -> None:
    rng = np.random.default_rng(3)
    costs = planted(1.0, [8, 16, 32], 2, 0.01, rng)
    other = [Cost("x", "pixels", c.size, c.repeat, "cuda", c.cpu_s / 20, 1.0, 1.0, "ok") for c in costs]
    with pytest.raises(InputError, match="device classes"):
        fit_exponent(costs + other)
    assert fit_exponent(other).device_class == "cuda"
    failed = [Cost("x", "pixels", 64, 0, "cpu", math.nan, math.nan, math.nan, "memory: over 1 MiB resident")]
    assert fit_exponent(costs + failed).value == fit_exponent(costs).value
    with pytest.raises(InputError, match="three sizes"):
        fit_exponent(costs[:4] + failed)
    with pytest.raises(InputError, match="three sizes"):
        measure_scaling("peak", sizes=[16, 32])


def test_an_estimator_is_timed_in_its_child() -> None:
    costs = measure_scaling("weighted-average", sizes=[2**14, 2**16, 2**18], slices=16, repeats=2)
    assert len(costs) == 6
    assert {cost.status for cost in costs} == {"ok"}
    assert {cost.size for cost in costs} == {2**14, 2**16, 2**18}
    assert all(cost.cpu_s > 0 and cost.peak_bytes >= 0 for cost in costs)
    fit = fit_exponent(costs)
    # Every pixel is read once: sixteen times the pixels cannot cost less than twice nor more than 64 times.
    assert 0.25 < fit.value < 1.5


def test_an_estimator_that_fails_is_a_status() -> None:
    costs = measure_scaling("no-such-estimator", sizes=[16, 32, 64], repeats=1)
    assert len(costs) == 3
    assert all(cost.status.startswith("error") for cost in costs)
    with pytest.raises(InputError, match="three sizes"):
        fit_exponent(costs)


def _polar(x: np.ndarray) -> np.ndarray:
    """(range, azimuth) -> (x, z)."""
    return np.stack([x[..., 0] * np.sin(x[..., 1]), x[..., 0] * np.cos(x[..., 1])], axis=-1)


def _triangulate(x: np.ndarray) -> np.ndarray:
    """(column, column of the axis) [px] -> (range [m], azimuth [rad]) of a camera of f = 400 px, base .15 m."""
    angle = np.arctan2(x[..., 0] - x[..., 1], 400.0)
    return np.stack([0.15 / np.tan(0.12 - angle), angle], axis=-1)


def test_a_chain_of_stages_has_the_covariance_that_simulation_finds() -> None:
    x = np.array([[20.0, 0.0], [4.0, 0.5]])
    covariance = np.array([[[0.01, 0.002], [0.002, 0.0004]], [[0.02, 0.0], [0.0, 0.001]]])
    own = np.diag([1e-6, 0.0])
    stages = [
        Stage("triangulation", _triangulate, own=lambda v: np.broadcast_to(own, (*v.shape[:-1], 2, 2))),
        Stage("cartesian", _polar),
    ]
    results = chain(stages, x, covariance)
    assert [result.name for result in results] == ["triangulation", "cartesian"]
    rng = np.random.default_rng(6)
    for k in range(2):
        draws = rng.multivariate_normal(x[k], covariance[k], 400_000)
        middle = _triangulate(draws) + np.array([1e-3, 0.0]) * rng.normal(size=(400_000, 2))
        want = np.cov(_polar(middle).T)
        # Covariance of 400,000 draws: relative error √(2/n) = .22 %; 4 of them, and second order below .5 %.
        np.testing.assert_allclose(results[1].covariance[k], want, rtol=0.015)
        assert results[0].own_share[k, 1] == 0.0
        assert 0.0 < results[0].own_share[k, 0] < 1.0
    assert results[1].sigma.shape == (2, 2)
    assert results[0].nonlinearity.max() < 0.05


def test_jacobians_by_differences_are_the_analytic_ones() -> None:
    x = np.array([[2.0, 0.3], [5.0, -0.4]])
    got = numerical_jacobian(_polar, x, [1e-2, 1e-2])
    r, a = x[:, 0], x[:, 1]
    want = np.stack([np.stack([np.sin(a), r * np.cos(a)], -1), np.stack([np.cos(a), -r * np.sin(a)], -1)], -2)
    np.testing.assert_allclose(got, want, rtol=1e-8, atol=1e-9)
    given = chain([Stage("s", _polar, jacobian=lambda _: want)], x, np.broadcast_to(np.eye(2) * 1e-6, (2, 2, 2)))
    np.testing.assert_allclose(given[0].covariance, carry(np.eye(2) * 1e-6, want), rtol=1e-12)
    with pytest.raises(ValueError, match="stage 's'"):
        chain([Stage("s", _polar, jacobian=lambda _: want[..., :1])], x, np.broadcast_to(np.eye(2), (2, 2, 2)))


def test_chained_bounds_are_the_bound_of_the_chain() -> None:
    # Invariance: the information about y = f(x) with n = m is J⁻ᵀ F J⁻¹, so carrying F⁻¹ is inverting that.
    rng = np.random.default_rng(4)
    root = rng.normal(size=(5, 3, 3))
    information = root @ np.swapaxes(root, -1, -2) + np.eye(3)
    first, second = rng.normal(size=(5, 3, 3)), rng.normal(size=(5, 3, 3))
    twice = carry(carry(np.linalg.inv(information), first), second)
    inverse = np.linalg.inv(second @ first)
    np.testing.assert_allclose(twice, np.linalg.inv(np.swapaxes(inverse, -1, -2) @ information @ inverse), rtol=1e-6)
    np.testing.assert_array_equal(twice, np.swapaxes(twice, -1, -2))


def test_what_is_unknown_stays_unknown_where_it_matters_and_only_there() -> None:
    covariance = np.array([[np.inf, 0.0], [0.0, 4.0]])
    out = carry(covariance, np.array([[1.0, 1.0], [0.0, 3.0]]))
    assert out[0, 0] == np.inf
    assert out[1, 1] == 36.0
    assert math.isnan(out[0, 1])


def test_nonlinearity_is_the_bias_over_the_error() -> None:
    def square(x: np.ndarray) -> np.ndarray:
        return x**2

    for mean, sigma in ((10.0, 0.1), (1.0, 0.5)):
        got = nonlinearity(square, np.array([mean]), np.array([[sigma**2]]))
        # E x² − x² = σ², first-order error 2xσ.
        assert got[0] == pytest.approx(sigma / (2 * mean))
    assert nonlinearity(lambda x: 3.0 * x, np.array([2.0]), np.array([[1.0]]))[0] == 0.0
