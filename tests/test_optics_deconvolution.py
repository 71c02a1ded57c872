"""Blur and its removal: point spreads of known waves, exact total-variation solutions, the convergence criterion, a gain in
PSNR."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from beambench.optics.deconvolution import (
    blurred_eq31,
    deblur,
    objective_eq32_as_meant,
    objective_eq32_as_printed,
    point_spread,
    total_variation,
    transfer_of,
)
from beambench.optics.turbulence.screens import kolmogorov_screen
from beambench.optics.zernike import zernike

Float = NDArray[np.float64]


def _pupil(n: int = 32) -> tuple[Float, Float, Float]:
    axis = (np.arange(n) - 0.5 * (n - 1)) / (0.5 * n)
    x, y = np.meshgrid(axis, axis)
    return x, y, (np.hypot(x, y) <= 1).astype(float)


def _image() -> Float:
    y, x = np.indices((64, 64))
    return np.asarray(0.2 + 0.5 * ((x // 8 + y // 12) % 2) + 0.3 * (np.hypot(x - 32, y - 32) < 15) + 0.1 * x / 64)


def test_point_spreads_of_known_waves() -> None:
    """A tilt of 4π across the array moves the peak by 2·2 pixels; small defocus lowers it to e^{−σ²}; light is conserved; the
    transfer of a clear pupil is its own overlap, zero beyond its diameter."""
    x, y, pupil = _pupil()
    flat = point_spread(0.0 * x, pupil)
    assert flat.sum() == pytest.approx(1.0) and np.unravel_index(flat.argmax(), flat.shape) == (32, 32)
    moved = point_spread(2 * np.pi * x * 0.5 * 2 * 32 / 32, pupil)
    assert np.unravel_index(moved.argmax(), moved.shape) == (32, 36)
    rms = 0.2
    defocus = point_spread(rms * zernike(4, x, y)[0], pupil)
    assert defocus.max() / flat.max() == pytest.approx(np.exp(-(rms**2)), rel=2e-2)
    transfer = transfer_of(flat, (64, 64))
    lag = np.pad(pupil, ((0, 32), (0, 32)))
    overlap = np.fft.ifft2(np.abs(np.fft.fft2(lag)) ** 2).real / pupil.sum()
    assert np.abs(transfer - overlap[:, :33]).max() < 1e-12
    with pytest.raises(ValueError, match="pupil"):
        point_spread(x, 0 * x)


def test_convolution_is_a_convolution() -> None:
    """Against a plain sum over shifts; a spread larger than the image is cut about its origin."""
    rng = np.random.default_rng(1)
    image, spread = rng.random((9, 12)), rng.random((5, 4))
    want = sum(spread[i, j] * np.roll(image, (i - 2, j - 2), (0, 1)) for i in range(5) for j in range(4)) / spread.sum()
    assert np.abs(blurred_eq31(image, transfer_of(spread, (9, 12))) - want).max() < 1e-13
    wide = np.zeros((41, 41))
    wide[20, 20] = 3.0
    assert np.abs(transfer_of(wide, (8, 8)) - 1).max() < 1e-13
    noise = rng.random((9, 12))
    assert blurred_eq31(image, transfer_of(spread, (9, 12)), noise) == pytest.approx(want + noise)


def test_objectives() -> None:
    """The print with p for v: at p = 0 the black image has the least value whatever was seen; as meant it has not."""
    image = _image()
    one = np.ones((64, 33), complex)
    black = np.zeros_like(image)
    assert objective_eq32_as_printed(black, one, black, 0.1) == 0.0 < objective_eq32_as_printed(image, one, black, 0.1)
    assert objective_eq32_as_meant(black, one, image, 0.1) > objective_eq32_as_meant(image, one, image, 0.1)
    assert total_variation(np.array([[0.0, 3.0], [4.0, 4.0]])) == pytest.approx(5.0 + 1.0)
    assert objective_eq32_as_meant(image, one, image, 0.1) == pytest.approx(0.1 * total_variation(image))


def test_a_step_in_closed_form() -> None:
    """Without blur a step between n₁ and n₂ columns becomes a + Δ/n₁, b − Δ/n₂ exactly; the gap bounds the error of the
    objective."""
    v = np.zeros((16, 24))
    v[:, 10:] = 1.0
    found = deblur(v, np.ones((16, 13), complex), 0.5, tolerance=1e-7, iterations=5000)
    assert found.converged and found.gap <= 1e-7 * found.objective
    assert np.abs(found.image[:, :10] - 0.05).max() < 2e-3 and np.abs(found.image[:, 10:] - (1 - 0.5 / 14)).max() < 2e-3
    exact = np.where(v > 0, 1 - 0.5 / 14, 0.05)
    least = objective_eq32_as_meant(exact, np.ones((16, 13), complex), v, 0.5)
    assert least <= found.objective <= least + found.gap * (1 + 1e-9)


def test_a_heavy_weight_leaves_the_mean() -> None:
    v = np.random.default_rng(3).random((12, 12))
    found = deblur(v, np.ones((12, 7), complex), 50.0, tolerance=1e-8, iterations=4000)
    assert np.abs(found.image - v.mean()).max() < 1e-3


def test_turbulent_blur_is_lowered() -> None:
    """D/r₀ = 4, noise of 1 %: PSNR rises by more than 6 dB (11 are reached) with the true wave, and not with the wrong one."""
    rng = np.random.default_rng(0)
    x, _, pupil = _pupil()
    phase = kolmogorov_screen(32 / 4, (32, 32), 1.0, rng)
    image = _image()
    transfer = transfer_of(point_spread(phase, pupil), image.shape)
    seen = blurred_eq31(image, transfer, 0.01 * rng.standard_normal(image.shape))

    def psnr(a: Float) -> float:
        return float(10 * np.log10(np.ptp(image) ** 2 / ((a - image) ** 2).mean()))

    found = deblur(seen, transfer, 1e-3)
    assert found.converged and psnr(found.image) > psnr(seen) + 6
    other = transfer_of(point_spread(-phase + 2 * x, pupil), image.shape)
    assert psnr(deblur(seen, other, 1e-3, iterations=200).image) < psnr(seen) + 1


def test_what_cannot_be_restored_is_refused() -> None:
    one = np.ones((8, 5), complex)
    with pytest.raises(ValueError, match="weight"):
        deblur(np.zeros((8, 8)), one, 0.0)
    with pytest.raises(ValueError, match="finite"):
        deblur(np.full((8, 8), np.nan), one, 1.0)
    assert not deblur(_image()[:8, :8], one, 1e-3, tolerance=1e-14, iterations=20).converged
