"""Zernike polynomials: order, orthonormality by exact quadrature, derivatives against explicit forms, lenslet means."""

from __future__ import annotations

from math import factorial

import numpy as np
import pytest
from numpy.typing import NDArray

from beambench.optics.lenslets.gradients import hexagon, illuminated_share, mean_gradients, square
from beambench.optics.zernike import (
    noll_of,
    noll_of_osa,
    orders_of,
    orders_of_osa,
    osa_of,
    osa_of_noll,
    zernike,
    zernike_gradient,
)

Float = NDArray[np.float64]
MODES = range(1, 67)


def _disk(order: int) -> tuple[Float, Float, Float]:
    """Nodes x, y and weights that integrate polynomials of this order over the unit disk exactly, of unit sum."""
    node, weight = np.polynomial.legendre.leggauss(order // 2 + 2)
    square_radius, radial = 0.5 * (node + 1), 0.5 * weight
    angle = 2 * np.pi * np.arange(order + 2) / (order + 2)
    rho = np.sqrt(square_radius)[:, None]
    w = np.broadcast_to(radial[:, None] / angle.size, (radial.size, angle.size))
    return rho * np.cos(angle), rho * np.sin(angle), w


def _explicit(j: int, x: Float, y: Float) -> Float:
    """Noll 1976, Eq. 1 and 2, by factorials."""
    n, m = orders_of(j)
    a = abs(m)
    rho, theta = np.hypot(x, y), np.arctan2(y, x)
    radial = sum(
        (-1.0) ** s
        * factorial(n - s)
        / (factorial(s) * factorial((n + a) // 2 - s) * factorial((n - a) // 2 - s))
        * rho ** (n - 2 * s)
        for s in range((n - a) // 2 + 1)
    )
    if m == 0:
        return np.asarray(np.sqrt(n + 1) * radial)
    return np.asarray(np.sqrt(2 * (n + 1)) * radial * (np.cos(a * theta) if m > 0 else np.sin(a * theta)))


def test_the_order_is_nolls() -> None:
    """Noll 1976, Table I, and the rule that even indices are cosines; every index is met once."""
    table = [
        (0, 0),
        (1, 1),
        (1, -1),
        (2, 0),
        (2, -2),
        (2, 2),
        (3, -1),
        (3, 1),
        (3, -3),
        (3, 3),
        (4, 0),
        (4, 2),
        (4, -2),
    ]
    assert [orders_of(j) for j in range(1, 14)] == table
    for j in range(1, 1000):
        n, m = orders_of(j)
        assert noll_of(n, m) == j
        assert m == 0 or (m > 0) == (j % 2 == 0)


def test_the_osa_order() -> None:
    """ANSI Z80.28: piston, y tilt, x tilt, oblique astigmatism, defocus, …; a permutation within each radial order."""
    assert [orders_of_osa(j) for j in range(6)] == [(0, 0), (1, -1), (1, 1), (2, -2), (2, 0), (2, 2)]
    assert [osa_of_noll(j) for j in range(1, 11)] == [0, 2, 1, 4, 3, 5, 7, 8, 6, 9]
    assert sorted(osa_of_noll(j) for j in range(1, 67)) == list(range(66))
    assert all(noll_of_osa(osa_of_noll(j)) == j and osa_of(*orders_of_osa(j)) == j for j in range(1, 300))


@pytest.mark.parametrize("wrong", [0, -3])
def test_an_index_that_does_not_exist_is_refused(wrong: int) -> None:
    with pytest.raises(ValueError, match="whole number of at least 1"):
        zernike([2, wrong], 0.0, 0.0)
    with pytest.raises(ValueError, match="even"):
        noll_of(3, 2)
    with pytest.raises(ValueError, match="At least one"):
        zernike([], 0.0, 0.0)


def test_unit_rms_and_orthogonal() -> None:
    """Exact quadrature of the products of 66 modes; a wrong norm or sign of the recurrence would be of order one."""
    x, y, weight = _disk(22)
    z = zernike(MODES, x, y)
    gram = np.einsum("irt,jrt,rt->ij", z, z, weight)
    assert np.abs(gram - np.eye(len(MODES))).max() < 1e-12


def test_values_against_factorials() -> None:
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-0.7, 0.7, (2, 50))
    assert np.abs(zernike(MODES, x, y) - np.stack([_explicit(j, x, y) for j in MODES])).max() < 1e-11


def test_gradients_against_finite_differences() -> None:
    """Fourth-order central differences of the explicit form with step 1e-3: their own error is below 1e-7 here."""
    rng = np.random.default_rng(2)
    x, y = rng.uniform(-0.7, 0.7, (2, 40))
    got = zernike_gradient(MODES, x, y)
    h = 1e-3
    for row, j in enumerate(MODES):
        for axis, (dx, dy) in enumerate([(h, 0.0), (0.0, h)]):
            f = [_explicit(j, x + k * dx, y + k * dy) for k in (-2, -1, 1, 2)]
            want = (f[0] - 8 * f[1] + 8 * f[2] - f[3]) / (12 * h)
            assert np.abs(got[row, axis] - want).max() < 1e-6


def test_gradients_at_the_origin_are_finite_and_those_of_the_linear_term() -> None:
    """Tilt 2; coma √8 (3ρ³ − 2ρ) gives −2√8 along its axis; all other orders up to n = 3 vanish there."""
    g = zernike_gradient(range(1, 11), 0.0, 0.0)
    want = np.zeros((10, 2))
    want[1, 0] = want[2, 1] = 2.0
    want[7, 0] = want[6, 1] = -2.0 * np.sqrt(8.0)
    assert np.abs(g - want).max() < 1e-14


def _by_area(cx: float, cy: float, side: float, radius: float) -> Float:
    """Mean gradients (2, modes) over a whole square by an area quadrature of the exact derivatives [1/m]."""
    node, weight = np.polynomial.legendre.leggauss(12)
    x, y = cx + 0.5 * side * node, cy + 0.5 * side * node
    g = zernike_gradient(MODES, x[None, :] / radius, y[:, None] / radius)
    return np.asarray(np.einsum("jayx,y,x->aj", g, weight, weight) / 4 / radius)


def test_lenslet_means_against_area_integrals() -> None:
    rng = np.random.default_rng(3)
    centre = rng.uniform(-1e-3, 1e-3, (12, 2))
    got = mean_gradients(MODES, centre, square(1.5e-4), 1.2e-3)
    for k, (cx, cy) in enumerate(centre):
        assert got[k] == pytest.approx(_by_area(cx, cy, 1.5e-4, 1.2e-3), rel=1e-9, abs=1e-6)


def test_the_centre_of_a_lenslet_is_not_its_mean() -> None:
    """Eight lenslets across: for the tenth radial order the gradient at the centre errs by more than 15 % of its rms."""
    edge = (np.arange(8) - 3.5) * 0.25
    x, y = (a.ravel() for a in np.meshgrid(edge, edge))
    keep = np.hypot(x, y) < 0.9
    x, y = x[keep], y[keep]
    mean = mean_gradients([56], np.stack([x, y], 1), square(0.25), 1.0)[:, :, 0]
    point = zernike_gradient(56, x, y)[0].T
    assert np.sqrt(((mean - point) ** 2).mean() / (mean**2).mean()) > 0.15


def test_a_cut_lenslet_by_counting() -> None:
    """A lenslet cut by the pupil against means of 250,000 midpoints; their error along the cut is below 2e-3."""
    centre, side = np.array([[0.62, 0.71], [-0.9, 0.1], [0.0, 0.0], [2.0, 0.0]]), 0.3
    modes = [2, 4, 8, 15, 22]
    got = mean_gradients(modes, centre, square(side), 1.0, cut_by_pupil=True)
    share = illuminated_share(centre, square(side), 1.0)
    step = side * ((np.arange(500) + 0.5) / 500 - 0.5)
    for k in range(2):
        x, y = np.meshgrid(centre[k, 0] + step, centre[k, 1] + step)
        inside = np.hypot(x, y) < 1
        assert share[k] == pytest.approx(inside.mean(), abs=5e-4)
        want = zernike_gradient(modes, x[inside], y[inside]).mean(axis=2)
        assert np.abs(got[k].T - want).max() < 2e-3 * max(1.0, np.abs(want).max())
    assert share[2] == pytest.approx(1.0, abs=1e-13) and share[3] == 0.0
    whole = mean_gradients(modes, centre[2:3], square(side), 1.0)
    assert got[2] == pytest.approx(whole[0], abs=1e-12)
    assert np.isnan(got[3]).all()


def test_one_lenslet_over_the_whole_pupil() -> None:
    """The mean gradient of the disk: only modes with |m| = 1 have one; for tilt 2, for each other √(2(n+1)) on its axis."""
    got = mean_gradients(range(2, 30), np.zeros((1, 2)), square(4.0), 1.0, cut_by_pupil=True)[0]
    for row, j in enumerate(range(2, 30)):
        n, m = orders_of(j)
        want = np.zeros(2)
        if abs(m) == 1:
            want[0 if m > 0 else 1] = np.sqrt(2.0 * (n + 1))
        assert got[:, row] == pytest.approx(want, abs=1e-11)
    assert illuminated_share(np.zeros((1, 2)), square(4.0), 1.0) == pytest.approx(np.pi / 16)


def test_other_shapes_and_refusals() -> None:
    """A hexagon and a turned square see a plane wave alike, and their areas are as in geometry."""
    for corners, area in ((hexagon(2e-4), np.sqrt(3) / 2 * 4e-8), (square(2e-4, 0.3), 4e-8)):
        tilt = mean_gradients([2, 3], np.array([[1e-4, 0.0]]), corners, 1e-3)[0]
        assert tilt == pytest.approx(2e3 * np.eye(2), abs=1e-9)
        share = illuminated_share(np.zeros((1, 2)), corners, 1e-5)
        assert share == pytest.approx(np.pi * 1e-10 / area)
    with pytest.raises(ValueError, match="shape"):
        mean_gradients([2], np.zeros(2), square(1.0), 1.0)
    with pytest.raises(ValueError, match="pupil_radius_m"):
        mean_gradients([2], np.zeros((1, 2)), square(1.0), 0.0)
    with pytest.raises(ValueError, match="area"):
        mean_gradients([2], np.zeros((1, 2)), square(0.0), 1.0)
