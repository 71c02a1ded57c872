"""Reconstruction: exact waves come back, cosines equal sparse systems, noise coefficients, priors, errors apart."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from beambench.optics.lenslets.gradients import illuminated_share, mean_gradients, square
from beambench.optics.reconstruction.cosines import (
    fried_by_cosines,
    fried_noise,
    hudgin_noise,
    southwell_by_cosines,
    southwell_noise,
)
from beambench.optics.reconstruction.modal import error_budget, least_squares, maximum_a_posteriori, stacked
from beambench.optics.reconstruction.zonal import fried, noise_propagation, southwell
from beambench.optics.turbulence.noll import noll_residual, zernike_covariance
from beambench.optics.turbulence.slopes import gradient_covariance
from beambench.optics.turbulence.strength import kolmogorov_structure

Float = NDArray[np.float64]
H = 1.5e-4


def _ring() -> NDArray[np.bool_]:
    y, x = np.indices((11, 13))
    r = np.hypot(y - 5, x - 6)
    return np.asarray((r < 5.4) & (r > 1.5))


def test_southwell_returns_quadratic_waves() -> None:
    """The mean of two slopes is the exact difference of a quadratic wave; on a ring, with a lenslet missing."""
    mask = _ring()
    mask[2, 5] = False
    zonal = southwell(mask, H)
    y, x = (a * H for a in np.nonzero(mask))
    phase = 3e3 * x - 1e3 * y + 2e7 * x**2 - 1e7 * x * y + 4e7 * y**2
    slopes = np.stack([3e3 + 4e7 * x - 1e7 * y, -1e3 - 1e7 * x + 8e7 * y], axis=1)
    got = zonal.solve(slopes)
    assert zonal.parts == 1
    assert np.abs(got - (phase - phase.mean())).max() < 1e-9 * np.ptp(phase)
    assert (
        np.isnan(zonal.on_grid(got)[5, 6])
        and zonal.on_grid(got)[2, 4] == got[np.flatnonzero(x + 13 * y >= 0)[0] + _at(mask, 2, 4)]
    )


def _at(mask: NDArray[np.bool_], row: int, col: int) -> int:
    return int(mask.ravel()[: row * mask.shape[1] + col].sum())


def test_fried_returns_bilinear_waves_without_waffle() -> None:
    mask = _ring()
    zonal = fried(mask, H)
    row, col = np.nonzero(mask)
    x, y = (col + 0.5) * H, (row + 0.5) * H
    slopes = np.stack([3e3 - 1e7 * y, -1e3 - 1e7 * x], axis=1)
    ny, nx = zonal.nodes.T * H
    phase = 3e3 * nx - 1e3 * ny - 1e7 * nx * ny
    # Least norm: each of the two families of corners has zero mean.
    odd = zonal.nodes.sum(axis=1) % 2
    for part in (0, 1):
        phase[odd == part] -= phase[odd == part].mean()
    assert zonal.parts == 2
    assert np.abs(zonal.solve(slopes) - phase).max() < 1e-9 * np.ptp(phase)


@pytest.mark.parametrize("shape", [(5, 7), (6, 6), (1, 4), (16, 9)])
def test_cosines_equal_the_sparse_systems(shape: tuple[int, int]) -> None:
    s = np.random.default_rng(1).standard_normal((*shape, 2))
    for build, fast in ((southwell, southwell_by_cosines), (fried, fried_by_cosines)):
        zonal = build(np.ones(shape, bool), H)
        slow = zonal.on_grid(zonal.solve(s.reshape(-1, 2)))
        assert np.abs(fast(s[..., 0], s[..., 1], H) - slow).max() < 1e-12 * np.abs(slow).max()


def test_least_squares_is_what_it_is() -> None:
    """Against the pseudo-inverse of the difference equations, written again: Southwell on a ring, random slopes, two stacks."""
    mask = _ring()
    s = np.random.default_rng(2).standard_normal((3, int(mask.sum()), 2))
    number = np.full(mask.shape, -1)
    number[mask] = np.arange(mask.sum())
    rows, right = [], []
    for y, x in np.argwhere(mask):
        for axis, (yy, xx) in enumerate(((y, x + 1), (y + 1, x))):
            if yy < mask.shape[0] and xx < mask.shape[1] and mask[yy, xx]:
                row = np.zeros(mask.sum())
                row[number[yy, xx]], row[number[y, x]] = 1, -1
                rows.append(row)
                right.append(H * 0.5 * (s[:, number[y, x], axis] + s[:, number[yy, xx], axis]))
    want = np.linalg.pinv(np.array(rows)) @ np.array(right)
    assert np.abs(southwell(mask, H).solve(s) - want.T).max() < 1e-12 * H * 100


@pytest.mark.parametrize("size", [(4, 4), (7, 5), (12, 12)])
def test_noise_coefficients_in_closed_form(size: tuple[int, int]) -> None:
    mask = np.ones(size, bool)
    assert noise_propagation(southwell(mask, H)) == pytest.approx(southwell_noise(*size), rel=1e-10)
    assert noise_propagation(fried(mask, H)) == pytest.approx(fried_noise(*size), rel=1e-10)


def test_published_noise_coefficients() -> None:
    """Fried 1977: .6558 + .3206 ln N within 3 % for 9 to 25 corners; its slope tends to Noll's (1978) 1/π; Southwell (1980) found
    his geometry to propagate less noise than the others; Hudgin's and his slopes tend to 1/2π."""
    for n in range(9, 26):
        assert fried_noise(n - 1, n - 1) == pytest.approx(0.6558 + 0.3206 * np.log(n), rel=0.03)
    slope = [(f(1024, 1024) - f(512, 512)) / np.log(2) for f in (fried_noise, southwell_noise, hudgin_noise)]
    assert slope == pytest.approx([1 / np.pi, 0.5 / np.pi, 0.5 / np.pi], rel=0.02)
    assert all(southwell_noise(n, n) < hudgin_noise(n, n) < fried_noise(n, n) for n in range(3, 40))


def test_noise_by_monte_carlo() -> None:
    """800 noisy frames of 10 × 10 lenslets: mean variance over h²σ² within 4 standard errors (about 3 %)."""
    rng = np.random.default_rng(5)
    zonal = southwell(np.ones((10, 10), bool), H)
    phase = zonal.solve(2e-3 * rng.standard_normal((800, 100, 2)))
    each = (phase**2).mean(axis=1) / (H * 2e-3) ** 2
    assert abs(each.mean() - southwell_noise(10, 10)) < 4 * each.std() / np.sqrt(800)


def test_what_does_not_fit_is_refused() -> None:
    zonal = southwell(np.ones((3, 3), bool), H)
    with pytest.raises(ValueError, match="shape"):
        zonal.solve(np.zeros((8, 2)))
    with pytest.raises(ValueError, match="finite"):
        zonal.solve(np.full((9, 2), np.nan))
    with pytest.raises(ValueError, match="mask"):
        fried(np.zeros((3, 3), bool), H)
    with pytest.raises(ValueError, match="pitch_m"):
        fried(np.ones((3, 3), bool), -1.0)
    with pytest.raises(ValueError, match="one shape"):
        southwell_by_cosines(np.zeros((3, 3)), np.zeros((3, 2)), H)


def _grid(across: int) -> Float:
    axis = H * (np.arange(across) - 0.5 * (across - 1))
    x, y = (a.ravel() for a in np.meshgrid(axis, axis))
    centre = np.stack([x, y], 1)
    return np.asarray(centre[illuminated_share(centre, square(H), 0.5 * across * H) > 0.999])


def test_modes_come_back() -> None:
    centre = _grid(12)
    g = stacked(mean_gradients(range(2, 37), centre, square(H), 6 * H))
    a = np.random.default_rng(3).standard_normal(35)
    assert least_squares(g) @ (g @ a) == pytest.approx(a, abs=1e-9)
    weighted = least_squares(g, np.random.default_rng(4).uniform(0.5, 2, g.shape[0]))
    assert weighted @ (g @ a) == pytest.approx(a, abs=1e-9)
    prior = zernike_covariance(range(2, 37), 1.0)
    assert maximum_a_posteriori(g, 1e-9, prior) @ (g @ a) == pytest.approx(a, abs=1e-6)
    strong = maximum_a_posteriori(g, 1e30, prior)
    assert np.abs(strong @ (g @ a)).max() < 1e-6


def test_too_few_lenslets_are_refused() -> None:
    centre = _grid(4)
    g = stacked(mean_gradients(range(2, 67), centre, square(H), 2 * H))
    with pytest.raises(ValueError, match="65 modes need as many slopes"):
        least_squares(g)
    g = stacked(mean_gradients([2, 3, 4], centre, square(H), 2 * H))
    with pytest.raises(ValueError, match="do not determine"):
        least_squares(np.concatenate([g, g[:, :1]], axis=1))
    with pytest.raises(ValueError, match="variances"):
        least_squares(g, 0.0)
    with pytest.raises(ValueError, match="positive definite"):
        maximum_a_posteriori(g, 1.0, np.diag([1.0, -1.0, 1.0]))


def test_the_errors_apart_and_together() -> None:
    """3,000 draws of 20 estimated and 100 higher modes with noise: mean square error of the wave within 4 standard errors of
    the sum of the budget; the prior lowers the sum, and least squares has no bias."""
    centre = _grid(8)
    modes = range(2, 122)
    every = stacked(mean_gradients(modes, centre, square(H), 4 * H))
    g, h = every[:, :20], every[:, 20:]
    c = zernike_covariance(modes, 1.5)
    variance = 0.3 * (g @ c[:20, :20] @ g.T).diagonal().mean()
    rng = np.random.default_rng(8)
    draw = rng.standard_normal((3000, 120)) @ np.linalg.cholesky(c).T
    slopes = draw @ every.T + np.sqrt(variance) * rng.standard_normal((3000, len(every)))
    tail = noll_residual(21, 1.5) - c.diagonal()[20:].sum()  # modes beyond the 121st
    totals = []
    for r in (least_squares(g, variance), maximum_a_posteriori(g, variance, c[:20, :20])):
        budget = error_budget(r, g, h, c, variance, noll_residual(21, 1.5))
        error = ((slopes @ r.T - draw[:, :20]) ** 2).sum(1) + (draw[:, 20:] ** 2).sum(1) + tail
        assert abs(error.mean() - budget.total) < 4 * error.std() / np.sqrt(3000)
        assert min(budget.aliasing, budget.noise) > 0
        totals.append(budget)
    assert totals[0].bias < 1e-15 and abs(totals[0].cross) < 1e-12
    assert totals[1].total < totals[0].total and totals[1].noise < totals[0].noise


def test_modes_and_structure_function_give_the_same_slopes() -> None:
    """G C Gᵀ of 1,000 modes against the covariance of lenslet gradients from D: two independent paths, 2 % in variance (the
    modes beyond the thousandth are missing)."""
    centre = _grid(6)
    g = stacked(mean_gradients(range(2, 1000), centre, square(H), 3 * H))
    r0 = 6 * H
    by_modes = g @ zernike_covariance(range(2, 1000), 1.0) @ g.T
    by_structure = gradient_covariance(lambda r: kolmogorov_structure(r, r0), centre, H)
    scale = by_structure.diagonal().mean()
    assert np.abs(by_modes - by_structure).max() < 0.03 * scale
    assert (by_modes.diagonal() < by_structure.diagonal() * 1.001).all()
