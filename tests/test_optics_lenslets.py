"""Spot fields: closed forms against quadrature, and against a full Fresnel propagation of the whole array of lenslets."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad

from beambench.optics.lenslets.coherent import Detector, Lenslet, coherent_image, neighbour_cycles, spot_field
from beambench.optics.lenslets.guo import (
    centroid_x_eq28,
    centroid_y_eq29,
    dynamic_range_eq34,
    range_eq26,
    sensitivity_eq33,
    slope_eq27,
    wavefront_eq30,
)
from beambench.optics.lenslets.spots import (
    isolated_image,
    pixel_share_slopes,
    pixel_shares,
    sinc2_integral,
    slope_of_displacement,
    spot_displacement_m,
    spot_width_m,
)
from beambench.optics.turbulence.screens import kolmogorov_screen

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]
LAMBDA, FOCAL, PITCH, PIXEL = 532e-9, 6.7e-3, 150e-6, 17.8e-6
LENSLET = Lenslet(PITCH, FOCAL, LAMBDA)


def test_the_sensor_of_the_paper() -> None:
    """Width 1.335 px, pitch 8.427 px, 3.16 cycles to the neighbour: the figures of Guo's optics."""
    assert spot_width_m(LAMBDA, FOCAL, PITCH) / PIXEL == pytest.approx(1.335, abs=5e-4)
    assert neighbour_cycles(PITCH, LAMBDA, FOCAL) == pytest.approx(3.157, abs=1e-3)
    assert spot_displacement_m(1e-3, FOCAL) == pytest.approx(6.7e-6)
    assert slope_of_displacement(spot_displacement_m([1e-3, -2e-3], FOCAL), FOCAL) == pytest.approx([1e-3, -2e-3])


def test_the_integral_of_sinc2() -> None:
    for t in (-3.3, 0.0, 0.2, 1.0, 7.4):
        want = quad(lambda u: np.sinc(u) ** 2, 0, t, limit=200, epsabs=1e-13)[0]
        assert sinc2_integral(t) == pytest.approx(want, abs=1e-12)
    assert sinc2_integral(1e6) == pytest.approx(0.5, abs=1e-7)


def test_pixel_shares() -> None:
    """Against quadrature; their sum; their slope by differences; the image is the product of both axes."""
    share = pixel_shares([10.3], 1.335, 24)[0]
    for i in (0, 9, 10, 23):
        want = quad(lambda u: np.sinc((u - 10.3) / 1.335) ** 2 / 1.335, i - 0.5, i + 0.5, epsabs=1e-13)[0]
        assert share[i] == pytest.approx(want, abs=1e-12)
    assert pixel_shares([500.2], 1.335, 1001).sum() == pytest.approx(1.0, abs=2 * 1.335 / (np.pi**2 * 500))
    slope = (pixel_shares([10.3 + 1e-5], 1.335, 24) - pixel_shares([10.3 - 1e-5], 1.335, 24)) / 2e-5
    assert pixel_share_slopes([10.3], 1.335, 24) == pytest.approx(slope, abs=1e-8)
    image = isolated_image([10.3, 3.0], [5.1, 8.0], [100.0, 50.0], 1.335, (12, 24))
    want = sum(
        n * np.outer(pixel_shares([r], 1.335, 12)[0], pixel_shares([c], 1.335, 24)[0])
        for c, r, n in ((10.3, 5.1, 100.0), (3.0, 8.0, 50.0))
    )
    assert image == pytest.approx(want, abs=1e-12)
    with pytest.raises(ValueError, match="width_px"):
        pixel_shares([1.0], 0.0, 3)


def test_the_centre_of_gravity_moves_by_f_times_the_slope() -> None:
    """Mean place of the whole spot over ±4,000 px; sinc² has no finite variance, so that the window must be centred on the spot."""
    slope = 3.1e-3
    centre = 4000 + spot_displacement_m(slope, FOCAL) / PIXEL
    share = pixel_shares([centre], 1.335, 8001)[0]
    moved = (share * (np.arange(8001) - 4000)).sum() / share.sum()
    assert moved == pytest.approx(slope * FOCAL / PIXEL, abs=1e-3)


def _fresnel(field: Complex, spacing: float, distance: float) -> Complex:
    """Fresnel's transfer function on a periodic grid: conserves energy exactly, shares nothing with the lenslets' sums."""
    f = np.fft.fftfreq(len(field), spacing)
    h = np.exp(-1j * np.pi * LAMBDA * distance * f**2)
    return np.asarray(np.fft.ifft2(np.fft.fft2(field) * h[:, None] * h[None, :]))


_CELLS, _ACROSS, _GRID = 96, 5, 2048  # points per lenslet, lenslets, points of the grid


def _whole_array(phase: Float) -> Float:
    """Irradiance (grid, grid) in the focal plane of 5 × 5 lenslets, for a pupil phase (480, 480) [rad]."""
    h = PITCH / _CELLS
    x = h * (np.arange(_CELLS) - 0.5 * (_CELLS - 1))
    lens = np.tile(np.exp(-1j * np.pi * x**2 / (LAMBDA * FOCAL)), _ACROSS)
    field = np.zeros((_GRID, _GRID), complex)
    low = (_GRID - _CELLS * _ACROSS) // 2
    part = slice(low, low + _CELLS * _ACROSS)
    field[part, part] = np.exp(1j * phase) * lens[:, None] * lens[None, :]
    return np.asarray(np.abs(_fresnel(field, h, FOCAL)) ** 2 * h**2)


def _pixels(light: Float) -> Float:
    """Sums over pixels of an eighth of the pitch, 40 × 40 of them over the array."""
    low = (_GRID - _CELLS * _ACROSS) // 2
    part = light[low : low + _CELLS * _ACROSS, low : low + _CELLS * _ACROSS]
    return np.asarray(part.reshape(40, 12, 40, 12).sum(axis=(1, 3)))


def _ours(phase: Float, cells: int, reach: float, nodes: int = 6) -> Float:
    """The same image by sums over lenslets of `cells`² values; slopes by plane fit."""
    blocks = phase.reshape(_ACROSS, _CELLS, _ACROSS, _CELLS).transpose(0, 2, 1, 3).reshape(-1, _CELLS, _CELLS)
    h = PITCH / _CELLS
    x = h * (np.arange(_CELLS) - 0.5 * (_CELLS - 1))
    k = 2 * np.pi / LAMBDA
    slope = np.stack([(blocks.mean(1) @ x), (blocks.mean(2) @ x)], 1) / (x @ x) / k
    rest = blocks - k * (slope[:, 0, None, None] * x[None, None, :] + slope[:, 1, None, None] * x[None, :, None])
    size = _CELLS // cells
    u = np.exp(1j * rest).reshape(-1, cells, size, cells, size).mean(axis=(2, 4))
    axis = PITCH * (np.arange(_ACROSS) - 2.0)
    cx, cy = (a.ravel() for a in np.meshgrid(axis, axis))
    pixel = PITCH / 8
    detector = Detector((40, 40), pixel, (-19.5 * pixel, -19.5 * pixel), nodes=nodes)
    return coherent_image(u, slope, np.stack([cx, cy], 1), LENSLET, detector, reach_m=reach)


def _phase(kind: str) -> Float:
    rng = np.random.default_rng(11)
    n = _CELLS * _ACROSS
    x = PITCH / _CELLS * (np.arange(n) - 0.5 * (n - 1))
    if kind == "plane":
        return np.zeros((n, n))
    if kind == "tilt":
        return np.broadcast_to(2 * np.pi / LAMBDA * (2.5e-3 * x[None, :] - 1.5e-3 * x[:, None]), (n, n)).copy()
    if kind == "pistons":
        return np.kron(rng.uniform(0, 2 * np.pi, (_ACROSS, _ACROSS)), np.ones((_CELLS, _CELLS)))
    return kolmogorov_screen(PITCH / 0.7, (n, n), PITCH / _CELLS, rng)


@pytest.mark.parametrize("kind", ["plane", "tilt", "pistons", "turbulence"])
def test_against_full_fresnel_propagation(kind: str) -> None:
    """Every pixel within 1 % of the brightest (measured: .13 to .35 %, .67 % for turbulence at d/r₀ = .7), centres of gravity
    within .015 of a spot's width; without the factor e^{iπ|X−x_m|²/λf} pistons give errors of 5 % and more (next test)."""
    phase = _phase(kind)
    want = _pixels(_whole_array(phase))
    got = _ours(phase, 16 if kind == "turbulence" else 1, 5 * PITCH, nodes=12)
    assert np.abs(got - want).max() < 0.01 * want.max()
    assert got.sum() == pytest.approx(want.sum(), rel=7e-3)
    a, b = (_gravity(image) for image in (got, want))
    assert np.abs(a - b).max() < 0.015 * spot_width_m(LAMBDA, FOCAL, PITCH) / (PITCH / 8)


def _gravity(image: Float) -> Float:
    """Centres of gravity (2, 5, 5) in pixels within cells of 8 × 8."""
    block = image.reshape(5, 8, 5, 8)
    i = np.arange(8)
    total = block.sum(axis=(1, 3))
    return np.stack([np.einsum("rgch,h->rc", block, i) / total, np.einsum("rgch,g->rc", block, i) / total])


def test_the_factor_of_the_place_matters() -> None:
    """Random pistons: with the factor conjugated, as if it were another sign, crosstalk shifts change by more than the tolerance of
    the comparison above."""
    phase = _phase("pistons")
    right = _gravity(_ours(phase, 1, 5 * PITCH))
    alone = _gravity(_pixels(_whole_array(np.zeros_like(phase))))
    shift = right - alone
    assert np.sqrt((shift**2).mean()) > 0.03
    blocks = phase[::_CELLS, ::_CELLS].ravel()
    axis = PITCH * (np.arange(_ACROSS) - 2.0)
    pixel = PITCH / 8
    x = pixel * (np.arange(40) - 19.5)
    total = np.zeros((40, 40), complex)
    for k, (cy, cx) in enumerate((a, b) for a in axis for b in axis):
        dx, dy = x - cx, x - cy
        field = spot_field(np.exp(1j * blocks[k]).reshape(1, 1, 1), np.zeros((1, 2)), dx[None], dy[None], LENSLET)[0]
        total += field * np.exp(-1j * np.pi * (dx[None, :] ** 2 + dy[:, None] ** 2) / LENSLET.scale_m2)
    without = _gravity(np.abs(total) ** 2) - alone
    assert np.abs(without - shift).max() > 0.05


def test_one_lenslet_alone_is_the_closed_form() -> None:
    """q = 1 and a tilt: the coherent sum of one lenslet equals the product of pixel shares; q = 8 adds nothing."""
    slope = np.array([[2.2e-3, -1.1e-3]])
    detector = Detector((41, 41), PIXEL, (-20 * PIXEL, -20 * PIXEL), nodes=8)
    one = coherent_image(np.ones((1, 1, 1)), slope, np.zeros((1, 2)), LENSLET, detector, reach_m=1.0)
    eight = coherent_image(np.ones((1, 8, 8)), slope, np.zeros((1, 2)), LENSLET, detector, reach_m=1.0)
    width = spot_width_m(LAMBDA, FOCAL, PITCH) / PIXEL
    centre = 20 + slope[0] * FOCAL / PIXEL
    want = isolated_image(centre[0], centre[1], PITCH**2, width, (41, 41))
    assert one == pytest.approx(want, abs=1e-8 * want.max())
    assert eight == pytest.approx(one, abs=1e-10 * want.max())


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="do not fit"):
        coherent_image(
            np.ones((2, 1, 1)),
            np.zeros((1, 2)),
            np.zeros((2, 2)),
            LENSLET,
            Detector((4, 4), PIXEL, (0, 0)),
            reach_m=1.0,
        )


def test_printed_values_of_the_sensor() -> None:
    """Eq. 33 and 34: .002657 rad = .1522° and .011194 rad = .6414°; Eq. 26 with the group index 1.357: 4 m are 36.2 ns there and
    back."""
    assert round(sensitivity_eq33(PIXEL, FOCAL), 6) == 0.002657 and round(np.degrees(PIXEL / FOCAL), 4) == 0.1522
    assert round(dynamic_range_eq34(PITCH, FOCAL), 6) == 0.011194
    assert np.degrees(dynamic_range_eq34(PITCH, FOCAL)) == pytest.approx(0.6414, abs=1e-4)
    assert range_eq26(36.2e-9, 299792458 / 1.357) == pytest.approx(4.0, abs=2e-3)
    assert slope_eq27([6.7e-6, -13.4e-6], FOCAL) == pytest.approx([1e-3, -2e-3])


@pytest.mark.parametrize("alpha", [1.0, 2.0, 3.5])
def test_intensity_power_centroids(alpha: float) -> None:
    """A spot symmetric about its centre has it for any α; a dark window has none; huge counts at high power do not overflow."""
    y, x = np.arange(-4.0, 13.0), np.arange(-4.0, 15.0)
    window = np.exp(-0.5 * ((x[None, :] - 5.3) ** 2 + (y[:, None] - 4.1) ** 2) / 2.0)
    assert centroid_x_eq28(1e200 * window, x, alpha) == pytest.approx(5.3, abs=2e-3)
    assert centroid_y_eq29(window, y, alpha) == pytest.approx(4.1, abs=2e-3)
    stack = np.stack([window, np.zeros_like(window)])
    assert np.isnan(centroid_x_eq28(stack, x, alpha)[1])
    counts = np.array([[0.0, 3.0, 1.0]])
    assert centroid_x_eq28(counts, np.arange(3.0), alpha) == pytest.approx((3**alpha + 2) / (3**alpha + 1))
    with pytest.raises(ValueError, match="negative"):
        centroid_x_eq28(-window, x, alpha)


def test_the_printed_series() -> None:
    x = np.linspace(-0.5, 0.5, 7)
    want = 0.3 * 2 * x - 0.2 * np.sqrt(3) * (2 * x**2 - 1)
    assert wavefront_eq30([0.3, -0.2], [2, 4], x, 0 * x) == pytest.approx(want)
