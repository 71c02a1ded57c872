"""Hexagonal lenslets: their pattern, its shares in pixels, and the samples that lie in them."""

from __future__ import annotations

import numpy as np
import pytest

from beambench.optics.lenslets.gradients import hexagon
from beambench.optics.lenslets.hexagons import HexagonSpot, hexagon_coverage, hexagon_density, hexagon_spot
from beambench.optics.lenslets.lattice import cell_coverage


def test_the_pattern_is_the_fourier_transform_of_a_hexagon() -> None:
    """Gauss-Legendre nodes over x, exact over y: |∫ e^{−2πiν·x}|² over the area, at random frequencies and square to a side."""
    node, weight = np.polynomial.legendre.leggauss(200)
    x, w = 0.25 * (node + 1.0), 0.25 * weight  # 0 … ½; the other half is the mirror image
    high = 1.0 / np.sqrt(3.0) - x / np.sqrt(3.0)
    rng = np.random.default_rng(1)
    for u, v in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.7), (0.9, 0.9 * np.sqrt(3.0)), *rng.uniform(-4, 4, (20, 2))]:
        field = 2.0 * (w * np.cos(2.0 * np.pi * u * x) * 2.0 * high * np.sinc(2.0 * v * high)).sum()
        assert hexagon_density(u, v) == pytest.approx(field**2 / np.sqrt(0.75), abs=1e-12)


def test_the_pattern_has_the_hexagons_symmetry_and_all_of_the_light() -> None:
    rng = np.random.default_rng(2)
    x, y = rng.uniform(-3, 3, (2, 50))
    for angle in np.pi / 3.0 * np.arange(1, 6):
        turned = np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y
        np.testing.assert_allclose(hexagon_density(*turned), hexagon_density(x, y), atol=1e-13)
    at = np.arange(-320, 321) / 4.0  # sums are exact below 1/(2 · 1.155), of a pattern of no higher frequency
    light = hexagon_density(at[None, :], at[:, None]).sum() / 16.0
    # What is left lies on six arms, beyond 80 λf/a: some 1/80.
    assert 0.99 < light < 1.0


@pytest.mark.parametrize("width", [0.5, 1.335, 6.0])
def test_shares_are_integrals_over_pixels(width: float) -> None:
    spot = HexagonSpot(width, 12.0)
    node, weight = np.polynomial.legendre.leggauss(24)
    row, col = np.array([-4.3, -0.7, 0.3, 2.9]), np.array([-2.1, 0.05, 7.4])
    found = spot.shares(row, col)
    for i, v in enumerate(row):
        for j, u in enumerate(col):
            density = hexagon_density((u + 0.5 * node)[None, :] / width, (v + 0.5 * node)[:, None] / width) / width**2
            want = 0.25 * (density * weight * weight[:, None]).sum()
            assert found[i, j] == pytest.approx(want, abs=5e-5 * spot.shares(np.zeros(1), np.zeros(1))[0, 0])
    step = 1e-4
    for name, moved in (("d_row", (step, 0.0)), ("d_col", (0.0, step))):
        ahead, behind = (spot.shares(row + s * moved[0], col + s * moved[1]) for s in (1, -1))
        np.testing.assert_allclose(spot.shares(row, col, **{name: 1}), (ahead - behind) / (2 * step), atol=1e-5)


def test_an_image_is_the_sum_of_its_spots() -> None:
    spot = hexagon_spot(1.335, 9.0)
    one, other = spot.image([10.3], [8.8], [100.0], (20, 24)), spot.image([25.0], [-3.0], [50.0], (20, 24))
    both = spot.image([10.3, 25.0, 90.0], [8.8, -3.0, 5.0], [100.0, 50.0, 7.0], (20, 24))
    np.testing.assert_allclose(both, one + other, atol=1e-12)
    assert one[8, 10] == pytest.approx(100.0 * spot.shares(np.array([-0.8]), np.array([-0.3]))[0, 0])
    assert (one >= 0.0).all() and one[:, 20:].max() == 0.0
    with pytest.raises(ValueError, match="positive"):
        hexagon_spot(0.0, 9.0)


def test_coverage_has_the_area_the_middle_and_no_overlap() -> None:
    """Areas to 3e-4, centroids to 1e-3 of the width; hexagons side by side fill the plane once."""
    rng = np.random.default_rng(3)
    row, col = np.indices((7, 7)).reshape(2, -1)
    centre = np.stack([col - 3 + 0.5 * (row % 2), np.sqrt(0.75) * (row - 3)], axis=1) + rng.uniform(-0.1, 0.1, 2)
    sample, share = hexagon_coverage(centre, 1.0, 0.1, 120)
    np.testing.assert_allclose(share.sum(axis=1) * 0.01, np.sqrt(0.75), rtol=3e-4)
    at = 0.1 * (np.arange(120) - 59.5)
    x = (share * at[sample % 120]).sum(axis=1) / share.sum(axis=1)
    y = (share * at[sample // 120]).sum(axis=1) / share.sum(axis=1)
    np.testing.assert_allclose(np.stack([x, y], axis=1), centre, atol=2e-3)
    whole = np.bincount(sample.ravel(), share.ravel(), minlength=120**2).reshape(120, 120)
    inside = np.hypot(at[:, None], at[None, :]) < 1.8
    np.testing.assert_allclose(whole[inside], 1.0, atol=0.02)  # Gauss-Legendre nodes at a corner of three
    assert whole.sum() * 0.01 == pytest.approx(49 * np.sqrt(0.75), rel=3e-4)


def test_a_hexagon_beyond_the_grid_is_cut() -> None:
    sample, share = hexagon_coverage([[0.6, 0.0]], 1.0, 0.1, 12)
    assert share.sum() * 0.01 == pytest.approx(0.5 * np.sqrt(0.75), rel=2e-3)
    assert sample.min() >= 0 and sample.max() < 144


def test_cells_about_one_hexagon_are_lit_as_its_corners_say() -> None:
    """Against areas of clipped cells: Gauss-Legendre nodes err where an edge or a corner crosses a cell."""
    side = 2.0 / np.sqrt(3.0)
    sample, share = hexagon_coverage([[0.0, 0.0]], 1.0, side / 16, 16)
    found = np.bincount(sample[0], share[0], minlength=256).reshape(16, 16)
    np.testing.assert_allclose(found, cell_coverage(hexagon(1.0), side, 16), atol=0.01)
