"""Slopes under turbulence: covariance, r₀ with its interval, and layers from successive gates."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad

from beambench.optics.turbulence.detection import (
    increment_strength,
    layer_strengths,
    range_weights,
    strength_from_slopes,
    without_common_tilt,
)
from beambench.optics.turbulence.screens import kolmogorov_plan
from beambench.optics.turbulence.slopes import gradient_covariance, gradient_variance
from beambench.optics.turbulence.strength import FRIED, kolmogorov_structure

Float = NDArray[np.float64]
D = 1.5e-4


def _centres(across: int) -> Float:
    axis = D * np.arange(across)
    x, y = (a.ravel() for a in np.meshgrid(axis, axis))
    return np.stack([x, y], 1)


def _unit(r: Float) -> Float:
    return kolmogorov_structure(r, 1.0)


def test_one_lenslet() -> None:
    """.162 (λ/d)² (d/r₀)^{5/3} rad² per axis for a square (Fried 1975), and by a plain double integral over both edges."""
    variance = gradient_variance(_unit, 1.0)
    assert variance / (4 * np.pi**2) == pytest.approx(0.162, abs=5e-4)

    def inner(t: float) -> float:
        return (1 - t) * (2 * FRIED * (1 + t * t) ** (5 / 6) - 2 * FRIED * t ** (5 / 3))

    assert variance == pytest.approx(quad(inner, 0, 1, epsabs=0, epsrel=1e-12)[0], rel=1e-7)
    assert gradient_variance(lambda r: kolmogorov_structure(r, 0.3), D) == pytest.approx(
        variance * D ** (-1 / 3) * 0.3 ** (-5 / 3), rel=1e-10
    )


def test_covariances_of_screens() -> None:
    """2,000 screens, 4 × 4 lenslets of 12 points: all 32 × 32 covariances within 5 standard errors plus .6 % of the variance,
    which is what trapezia over 13 points of each edge leave."""
    n, across = 12, 4
    plan = kolmogorov_plan(1.0, (n * across + 1,) * 2, D / n)
    rng = np.random.default_rng(3)
    weight = np.full(n + 1, 1.0 / n)
    weight[[0, -1]] *= 0.5
    draws = []
    for _ in range(2000):
        phase = plan.draw(rng)
        edge = [phase[:, ::n], phase[::n, :].T]
        slopes = np.empty((across, across, 2))
        for axis in (0, 1):
            mean = np.stack([weight @ edge[axis][k * n : k * n + n + 1] for k in range(across)]) / D
            slope = np.diff(mean, axis=1)
            slopes[..., axis] = slope if axis == 0 else slope.T
        draws.append(slopes.reshape(-1))
    s = np.array(draws)
    want = gradient_covariance(_unit, _centres(across), D)
    product = s[:, :, None] * s[:, None, :]
    error = product.std(axis=0) / np.sqrt(len(s))
    assert (np.abs(product.mean(axis=0) - want) < 5 * error + 0.006 * want[0, 0]).all()
    assert np.linalg.eigvalsh(want)[0] > 0


def test_strength_and_interval() -> None:
    """300 sets of 5 frames at d/r₀ = .05: the 95 % interval covers r₀^{−5/3} in 95 ± 4.5 % (3.5 σ of counting), its maximum
    has no bias beyond 4 standard errors, and the curvature's error is the scatter within 15 %."""
    rng = np.random.default_rng(4)
    unit = gradient_covariance(_unit, _centres(4), D)
    q = (D / 0.05) ** (-5 / 3)
    noise = 0.5 * q * unit[0, 0]
    root = np.linalg.cholesky(q * unit + noise * np.eye(32))
    found = [strength_from_slopes(rng.standard_normal((5, 32)) @ root.T, unit, noise) for _ in range(300)]
    inside = np.mean([f.low <= q <= f.high for f in found])
    assert abs(inside - 0.95) < 0.045
    estimate = np.array([f.q for f in found])
    assert abs(estimate.mean() - q) < 4 * estimate.std() / np.sqrt(300)
    assert np.mean([f.sigma for f in found]) == pytest.approx(estimate.std(), rel=0.15)
    best = found[0]
    assert best.r0_m == pytest.approx(best.q**-0.6) and best.r0_interval_m[0] < best.r0_m < best.r0_interval_m[1]
    assert best.gain > 10


def test_no_turbulence() -> None:
    """Noise alone: zero is in the interval, half of the maxima lie at zero, and 2·gain exceeds 2.71 in about 5 % of 200 sets."""
    rng = np.random.default_rng(6)
    unit = gradient_covariance(_unit, _centres(4), D)
    found = [strength_from_slopes(1e-3 * rng.standard_normal((3, 32)), unit, 1e-6) for _ in range(200)]
    assert 0.35 < np.mean([f.q == 0.0 for f in found]) < 0.75
    assert np.mean([2 * f.gain > 2.706 for f in found]) < 0.11
    assert np.mean([f.low == 0.0 for f in found]) > 0.92
    zero = next(f for f in found if f.q == 0.0)
    assert zero.r0_m == np.inf and zero.r0_interval_m[1] == np.inf and np.isfinite(zero.r0_interval_m[0])


def test_jitter_of_the_platform_does_not_count() -> None:
    """With a common tilt ten times as large as the turbulence, r₀ is right within 4 standard errors once the mean slope is
    removed."""
    rng = np.random.default_rng(7)
    unit = gradient_covariance(_unit, _centres(5), D)
    q = 30.0
    s = rng.standard_normal((20, 50)) @ np.linalg.cholesky(q * unit + np.eye(50)).T
    shaken = s + np.tile(10 * np.sqrt(q * unit[0, 0]) * rng.standard_normal((20, 2)), 25)
    p = without_common_tilt(25)
    assert p @ p.T == pytest.approx(np.eye(48), abs=1e-12) and np.abs(p @ np.tile([1.0, -2.0], 25)).max() < 1e-12
    good = strength_from_slopes(shaken @ p.T, p @ unit @ p.T, p @ p.T)
    same = strength_from_slopes(s @ p.T, p @ unit @ p.T, p @ p.T)
    assert good.q == pytest.approx(same.q, rel=1e-6) and abs(good.q - q) < 4 * good.sigma
    assert strength_from_slopes(shaken, unit, 1.0).low > 2 * q


def test_range_weights() -> None:
    """Against quadrature; a diffuse target's gate does not see the water at the target; a mirror's counts the path twice, in
    phase."""
    edge, gates = np.array([0.0, 1.0, 2.0, 3.0, 4.0]), np.array([1.0, 2.5, 4.0])
    w = range_weights(gates, edge, "diffuse")
    for i, r in enumerate(gates):
        for j in range(4):
            low, high = min(edge[j], r), min(edge[j + 1], r)
            want = quad(lambda z, r=r: (1 - z / r) ** (5 / 3), low, high)[0]
            assert w[i, j] == pytest.approx(want, abs=1e-9)
    assert w[2, 3] < 0.05 < 0.5 < w[2, 0]
    mirror = range_weights(gates, edge, "mirror")
    assert mirror == pytest.approx(4 * np.array([[1, 0, 0, 0], [1, 1, 0.5, 0], [1, 1, 1, 1]]))
    with pytest.raises(ValueError, match="target"):
        range_weights(gates, edge, "wall")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="ascending"):
        range_weights(gates, [1.0, 1.0], "mirror")


@pytest.mark.parametrize("target", ["mirror", "diffuse"])
def test_layers_come_back(target: str) -> None:
    """Exact strengths return exactly; with 5 % noise (1 % for a diffuse target, whose last layer is badly seen and left out of the
    comparison) the strongest layer is found in most of 200 draws, and none is negative."""
    gates = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    w = range_weights(gates, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0], target)  # type: ignore[arg-type]
    x = 1e4 * np.array([0.5, 1.0, 0.0, 8.0, 1.0])
    q = w @ x
    assert layer_strengths(q, 0.05 * q, w) == pytest.approx(x, abs=1e-6 * x.max())
    rng = np.random.default_rng(2)
    share = 0.05 if target == "mirror" else 0.01
    found = np.array([layer_strengths(q + share * q * rng.standard_normal(5), share * q, w) for _ in range(200)])
    assert (found >= 0).all() and np.mean(found[:, :4].argmax(axis=1) == 3) > 0.8
    with pytest.raises(ValueError, match="positive"):
        layer_strengths(q, 0.0 * q, w)


@pytest.mark.parametrize("shared", [True, False])
def test_increments_between_gates(shared: bool) -> None:
    """300 sets of 40 frames, the nearer turbulence the same in both gates or drawn anew: Δq without bias (4 standard errors),
    and z of unit spread (15 %); seeing the same turbulence twice lowers the error."""
    rng = np.random.default_rng(9)
    unit = gradient_covariance(_unit, _centres(3), D)
    root = np.linalg.cholesky(unit)
    q_near, q_layer = 40.0, 15.0

    def draw(q: float) -> Float:
        return np.sqrt(q) * rng.standard_normal((40, 18)) @ root.T

    found = []
    for _ in range(300):
        before = draw(q_near)
        near = before + 20.0 * rng.standard_normal((40, 18))
        far = (before if shared else draw(q_near)) + draw(q_layer) + 30.0 * rng.standard_normal((40, 18))
        found.append(increment_strength(near, far, unit, 400.0, 900.0))
    value, sigma = np.array(found).T
    assert abs(value.mean() - q_layer) < 4 * value.std() / np.sqrt(300)
    assert ((value - q_layer) / sigma).std() == pytest.approx(1.0, abs=0.15)
    assert sigma.mean() < 10.0 if shared else sigma.mean() > 10.0


def test_what_does_not_fit_is_refused() -> None:
    unit = gradient_covariance(_unit, _centres(2), D)
    with pytest.raises(ValueError, match="fit unit"):
        strength_from_slopes(np.zeros((2, 7)), unit, 1.0)
    with pytest.raises(ValueError, match="positive definite"):
        strength_from_slopes(np.zeros((2, 8)), unit, -1.0)
    with pytest.raises(ValueError, match="2 or more frames"):
        increment_strength(np.zeros((1, 8)), np.zeros((1, 8)), unit, 1.0, 1.0)
    with pytest.raises(ValueError, match="centres_m"):
        gradient_covariance(_unit, np.zeros(3), D)
