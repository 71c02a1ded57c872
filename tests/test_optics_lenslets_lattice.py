"""The fast coherent sum over a regular array against the general one and against full Fresnel propagation."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from beambench.optics.lenslets.coherent import Detector, Lenslet, coherent_image
from beambench.optics.lenslets.gradients import hexagon, square
from beambench.optics.lenslets.lattice import cell_coverage, cells_of_phase, lenslet_array, regular_array
from beambench.optics.lenslets.spots import isolated_image

from .test_optics_lenslets import _ACROSS, FOCAL, LAMBDA, LENSLET, PITCH, PIXEL, _gravity, _phase, _pixels, _whole_array

Float = NDArray[np.float64]


def _centres(rows: int, cols: int) -> Float:
    y, x = np.indices((rows, cols))
    return PITCH * np.stack([x.ravel() - 0.5 * (cols - 1), y.ravel() - 0.5 * (rows - 1)], axis=1)


@pytest.mark.parametrize("fill", [1.0, 0.8])
def test_against_the_general_sum(fill: float) -> None:
    """3 × 4 lenslets with pistons, tilts and residuals, a ratio of 8.427 pixels, an offset detector: both keep 1½ pitches
    about each lenslet, and differ by less than .5 % of the brightest pixel (64 points per pitch) and 2 % (24 points)."""
    rng = np.random.default_rng(1)
    u = np.exp(1j * (rng.uniform(0, 2 * np.pi, (3, 4, 1, 1)) + 0.3 * rng.standard_normal((3, 4, 4, 4))))
    slope = rng.uniform(-2e-3, 2e-3, (3, 4, 2))
    lenslet = Lenslet(fill * PITCH, FOCAL, LAMBDA)
    detector = Detector((30, 38), PIXEL, (-18.2 * PIXEL, -14.9 * PIXEL), nodes=8)
    want = coherent_image(
        u.reshape(12, 4, 4), slope.reshape(12, 2), _centres(3, 4), lenslet, detector, reach_m=1.5 * PITCH
    )
    for points, limit in ((64, 0.005), (24, 0.02)):
        array = regular_array(lenslet, (3, 4), PITCH, detector, cells=4, samples=points, neighbours=1)
        got = array.image(u, slope)
        assert got.shape == (30, 38) and np.abs(got - want).max() < limit * want.max()
    assert np.array_equal(got, array.image(u, slope))


@pytest.mark.parametrize("shift", [0.0, 0.3])
@pytest.mark.parametrize("cells", [1, 2, 3, 4])
def test_the_compiled_sums_are_those_of_numpy(cells: int, shift: float) -> None:
    """Fields, sinc and pixels in double precision, for odd and even numbers of cells; with a shifted detector, whose pixels do not
    lie alike about the middle. Single precision sums some hundred terms: 2e-6 of the brightest."""
    rng = np.random.default_rng(2)
    u = np.exp(1j * rng.uniform(0, 2 * np.pi, (2, 4, cells, cells)))
    slope = rng.uniform(-2e-3, 2e-3, (2, 4, 2))
    slope[0, 0] = 0.0
    detector = Detector((20, 38), PIXEL, ((shift - 18.5) * PIXEL, -9.5 * PIXEL))
    array = regular_array(LENSLET, (2, 4), PITCH, detector, cells=cells, samples=16, neighbours=1)
    side = PITCH / cells
    middles = side * (np.arange(cells) - 0.5 * (cells - 1))
    field = np.zeros(array.points, complex)
    for k, (own, tilt) in enumerate(zip(u.reshape(-1, cells, cells), slope.reshape(-1, 2), strict=True)):
        wave = np.exp(2j * np.pi / LAMBDA * (tilt[0] * middles + tilt[1] * middles[:, None]))
        kernels = []
        for axis, its in ((array.x, tilt[0]), (array.y, tilt[1])):
            at = axis.offset_m[axis.member[k]]
            kernel = axis.real[axis.member[k]].astype(float) + 1j * axis.imag[axis.member[k]]
            kernels.append(kernel * np.sinc(side * (at - FOCAL * its) / LENSLET.scale_m2))
        row, col = array.y.first[k], array.x.first[k]
        size = kernels[0].shape[1]
        field[row : row + size, col : col + size] += kernels[1].T @ (own * wave) @ kernels[0]
    want = array.pixel_y.astype(float) @ np.abs(field) ** 2 @ array.pixel_x.astype(float).T
    got = array.image(u, slope)
    assert np.abs(got - want).max() < 2e-6 * want.max()


@pytest.mark.parametrize("kind", ["plane", "tilt", "pistons", "turbulence"])
def test_against_full_fresnel_propagation(kind: str) -> None:
    """Pixels within 1 % of the brightest (.7 % is the most that was seen) and centres of gravity within .015 of a spot's
    width, by a propagation that shares nothing with the sums."""
    phase = _phase(kind)
    want = _pixels(_whole_array(phase))
    pixel = PITCH / 8
    detector = Detector((40, 40), pixel, (-19.5 * pixel, -19.5 * pixel))
    array = regular_array(LENSLET, (_ACROSS, _ACROSS), PITCH, detector, cells=32, samples=48, neighbours=2)
    got = array.image(*cells_of_phase(phase, (_ACROSS, _ACROSS), 32, PITCH, LAMBDA))
    assert np.abs(got - want).max() < 0.01 * want.max()
    assert np.abs(_gravity(got) - _gravity(want)).max() < 0.015 * LAMBDA * FOCAL / PITCH / pixel


def _far_field(corners: Float, x: Float, y: Float) -> NDArray[np.complex128]:
    """∫ over a polygon of e^{−2πi (Xx + Yy)/λf}: by Gauss' theorem along its edges, in closed form for X ≠ 0 or Y ≠ 0."""
    kx, ky = -2 * np.pi * x / (LAMBDA * FOCAL), -2 * np.pi * y / (LAMBDA * FOCAL)
    total = np.zeros(np.broadcast(x, y).shape, complex)
    for p, q in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        e, middle = q - p, 0.5 * (p + q)
        half = 0.5 * (kx * e[0] + ky * e[1])
        total += (kx * e[1] - ky * e[0]) * np.exp(1j * (kx * middle[0] + ky * middle[1])) * np.sinc(half / np.pi)
    return np.asarray(-1j * total / (kx**2 + ky**2))


@pytest.mark.parametrize("shape", ["turned", "hexagon"])
def test_lenslets_of_other_shapes(shape: str) -> None:
    """Three lenslets off any grid, with pistons, against closed-form far fields of their polygons added by hand and
    integrated by 8 × 8 nodes per pixel: 1 % of the brightest pixel (24 cells a side: 1.5 %, 40: .6 %)."""
    corners = square(PITCH, 0.3) if shape == "turned" else hexagon(PITCH, 0.1)
    side = 2 * float(np.abs(corners).max())
    lenslet = Lenslet(side, FOCAL, LAMBDA)
    centre = np.array([[0.0, 0.0], [1.31 * PITCH, 0.27 * PITCH], [0.4 * PITCH, -1.2 * PITCH]])
    piston = np.exp(1j * np.array([0.3, 2.0, 4.4]))
    detector = Detector((30, 32), PIXEL, (-11.3 * PIXEL, -19.2 * PIXEL))
    share = cell_coverage(corners, side, 40)
    assert share.sum() * (side / 40) ** 2 == pytest.approx(abs(_area(corners)), rel=1e-12)
    array = lenslet_array(lenslet, centre, detector, cells=40, step_m=PITCH / 40, reach_m=2.6 * PITCH)
    got = array.image(piston[:, None, None] * share, np.zeros((3, 2)))
    node, weight = np.polynomial.legendre.leggauss(8)
    place = [detector.origin_m[a] + PIXEL * (np.arange(n)[:, None] + 0.5 * node).ravel() for a, n in ((0, 32), (1, 30))]
    x, y = place[0][None, :], place[1][:, None]
    field = sum(
        p
        * np.exp(1j * np.pi * ((x - c[0]) ** 2 + (y - c[1]) ** 2) / (LAMBDA * FOCAL))
        * _far_field(corners, x - c[0], y - c[1])
        for p, c in zip(piston, centre, strict=True)
    ) / (LAMBDA * FOCAL)
    light = (np.abs(field) ** 2).reshape(30, 8, 32, 8)
    want = 0.25 * PIXEL**2 * np.einsum("rgch,g,h->rc", light, weight, weight)
    assert np.abs(got - want).max() < 0.01 * want.max()


def _area(corners: Float) -> float:
    other = np.roll(corners, -1, axis=0)
    return float(0.5 * (corners[:, 0] * other[:, 1] - corners[:, 1] * other[:, 0]).sum())


def test_a_dark_lenslet_and_one_alone() -> None:
    """One lit lenslet of 2 × 3 is the closed form of an isolated spot, within what leaves its window of 2½ pitches."""
    u, slope = np.zeros((2, 3, 1, 1), complex), np.zeros((2, 3, 2))
    u[1, 0], slope[1, 0] = 1.0, (1e-3, -2e-3)
    detector = Detector((20, 30), PIXEL, (-14.5 * PIXEL, -9.5 * PIXEL))
    got = regular_array(LENSLET, (2, 3), PITCH, detector, cells=1, samples=24, neighbours=2).image(u, slope)
    place = (np.array([-PITCH, 0.5 * PITCH]) + FOCAL * slope[1, 0]) / PIXEL + [14.5, 9.5]
    want = isolated_image([place[0]], [place[1]], [PITCH**2], LAMBDA * FOCAL / PITCH / PIXEL, (20, 30))
    assert np.abs(got - want).max() < 2e-3 * want.max()


def test_cells_of_a_phase() -> None:
    """A tilted wave has its slope and no residual; the means of the cells, put together, are those of the phase."""
    n = 3 * 12
    x = PITCH / 12 * (np.arange(n) - 0.5 * (n - 1))
    k = 2 * np.pi / LAMBDA
    u, slope = cells_of_phase(
        np.broadcast_to(k * (1e-3 * x[None, :] - 2e-3 * x[:, None]), (n, n)), (3, 3), 4, PITCH, LAMBDA
    )
    assert slope == pytest.approx(np.broadcast_to([1e-3, -2e-3], (3, 3, 2)), abs=1e-12)
    assert np.abs(u - u[..., :1, :1]).max() < 1e-9
    rng = np.random.default_rng(2)
    phase = rng.uniform(-0.3, 0.3, (n, n))
    u, slope = cells_of_phase(phase, (3, 3), 4, PITCH, LAMBDA)
    cell = PITCH / 4 * (np.arange(4) - 1.5)
    back = np.angle(u[1, 2]) + k * (slope[1, 2, 0] * cell[None, :] + slope[1, 2, 1] * cell[:, None])
    assert back == pytest.approx(phase[12:24, 24:36].reshape(4, 3, 4, 3).mean(axis=(1, 3)), abs=1e-12)
    one, flat = cells_of_phase(phase, (3, 3), 1, PITCH, LAMBDA)
    assert one.shape == (3, 3, 1, 1) and not flat.any()


def test_what_does_not_fit_is_refused() -> None:
    detector = Detector((8, 8), PIXEL, (0.0, 0.0))
    with pytest.raises(ValueError, match="at least"):
        regular_array(LENSLET, (2, 2), PITCH, detector, cells=0)
    with pytest.raises(ValueError, match="at least"):
        regular_array(LENSLET, (2, 2), 0.5 * PITCH, detector)
    with pytest.raises(ValueError, match="step_m"):
        lenslet_array(LENSLET, np.zeros((1, 2)), detector, cells=2, step_m=0.0, reach_m=PITCH)
    with pytest.raises(ValueError, match="out of a square"):
        cell_coverage(square(2e-4), 1e-4, 4)
    array = regular_array(LENSLET, (2, 2), PITCH, detector, cells=2)
    with pytest.raises(ValueError, match="need the shape"):
        array.image(np.ones((2, 2, 3, 3)), np.zeros((2, 2, 2)))
    with pytest.raises(ValueError, match="does not divide"):
        cells_of_phase(np.zeros((10, 12)), (3, 3), 2, PITCH, LAMBDA)
