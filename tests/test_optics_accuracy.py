"""Eq. 14-17 and 25 of Guo et al. 2017 as printed, and the forms that hold."""

from __future__ import annotations

import numpy as np
import pytest

from beambench.optics import accuracy as law
from beambench.optics.constants import C_M_PER_S

K = np.arange(-40.0, 41.0)


def gaussian(sigma: float, peak: float = 300.0) -> np.ndarray:
    return np.asarray(peak * np.exp(-0.5 * (K / sigma) ** 2))


def test_eq14_with_photon_noise_is_eq15() -> None:
    stacks = np.random.default_rng(1).uniform(0.0, 1e4, (5, 30))
    assert law.snr_eq14(stacks, np.sqrt(stacks)) == pytest.approx(law.snr_eq15(stacks), rel=1e-14)
    assert law.snr_eq14([3.0, 4.0], [3.0, 4.0]) == pytest.approx(7.0 / 5.0)


def test_eq16_drops_the_root_of_two_pi() -> None:
    """Poisson summation: the relative error of Σ = √(2π)σ is 2 exp(−2π²σ²): 5e-9 at σ = 1 step, 1.4 % at half a step."""
    for sigma, tolerance in ((1.0, 3e-9), (2.0, 1e-14), (5.0, 1e-14), (0.5, 0.0075)):
        whole = law.snr_eq15(gaussian(sigma))
        assert law.snr_gaussian_stack(sigma, 1.0, 300.0) == pytest.approx(whole, rel=tolerance)
        assert law.snr_eq16(sigma, 1.0, 300.0) / law.snr_gaussian_stack(sigma, 1.0, 300.0) == pytest.approx(
            (2.0 * np.pi) ** -0.25
        )


def test_the_range_accuracy_of_the_set_up() -> None:
    """σ·t_step = .9 ns² and 256 levels give 8.894 mm with c = 3e8, for any σ; 5.62 mm with the √(2π)."""
    for sigma in (0.9e-9, 1.8e-9, 3e-9):
        step = 0.9e-18 / sigma
        printed = 1e3 * law.range_accuracy_eq17(sigma, law.snr_eq16(sigma, step, 256), 3e8)
        full = 1e3 * law.range_accuracy_eq17(sigma, law.snr_gaussian_stack(sigma, step, 256), 3e8)
        assert printed == pytest.approx(8.89391, abs=5e-6)
        assert full == pytest.approx(5.6176, abs=5e-5)
    assert law.range_accuracy_eq17(1e-9, 1.0) == pytest.approx(0.5e-9 * C_M_PER_S)
    assert law.range_accuracy_eq17(1e-9, 1.0, C_M_PER_S / 1.36) == pytest.approx(0.5e-9 * C_M_PER_S / 1.36)


def test_depth_error_of_both_objects() -> None:
    assert law.depth_error_percent_eq25(8.894e-3, [0.48, 0.40]) == pytest.approx([1.852917, 2.2235], abs=1e-6)
    assert law.depth_accuracy(8.894e-3, 8.894e-3) == pytest.approx(np.sqrt(2.0) * 8.894e-3)
    assert law.depth_accuracy(3.0, [4.0, 0.0]) == pytest.approx([5.0, 3.0])


def test_weighted_average_attains_eq17_with_photon_noise() -> None:
    """Σ I (t − t̂)²/(ΣI)² is σ²/N, by definition of σ."""
    stack = gaussian(3.0)
    assert law.weighted_average_std(stack, np.sqrt(stack), K) == pytest.approx(3.0 / law.snr_eq15(stack), rel=1e-9)


def test_weighted_average_std_with_read_noise() -> None:
    """20,000 stacks: the standard error of a standard deviation is 1/√(2n) = .5 %; tolerance 4 of them."""
    rng = np.random.default_rng(3)
    expected, read = gaussian(3.0), 4.0
    draws = rng.poisson(expected, (20_000, K.size)) + rng.normal(0.0, read, (20_000, K.size))
    found = np.std((draws * K).sum(axis=1) / draws.sum(axis=1))
    stated = law.weighted_average_std(expected, np.sqrt(expected + read**2), K)
    assert found == pytest.approx(float(stated), rel=0.02)
    assert stated > 1.2 * 3.0 / law.snr_eq15(expected)
