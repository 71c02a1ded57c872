"""Eq. 14-17 and 25 of Guo et al. 2017, and the 8.894 mm that its section 5.2 gives as the range accuracy of the set-up."""

from __future__ import annotations

import math

import numpy as np

from ...optics import accuracy as law
from ...optics.constants import C_M_PER_S
from .rows import Row, judge_band, judge_exact

__all__ = ["DEPTHS_M", "RANGE_ACCURACY_M", "SIGMA_TIMES_STEP_S2", "accuracy_rows", "chance_of_round_numbers", "implied"]

RANGE_ACCURACY_M = 8.894e-3
#: Depths of Objects 1 and 2 relative to the background.
DEPTHS_M = (0.48, 0.40)
#: σ·t_step that 8.894 mm implies if the brightest slice is 256: see `implied`.
SIGMA_TIMES_STEP_S2 = 0.9e-18
_LEVELS = 256
#: The rounded speed of light used in the document: with the exact one the number would be 8.888 mm.
_C_ROUNDED = 3.0e8


def implied(accuracy_m: float, speed_m_per_s: float) -> float:
    """σ·t_step/max(I) [s²] that Eq. 16 in Eq. 17 needs for an accuracy: (2δr/c)²."""
    return (2.0 * accuracy_m / speed_m_per_s) ** 2


def _accuracy(speed_m_per_s: float, full: bool = False) -> float:
    """Eq. 17 with Eq. 16 (or with the √(2π) that it omits) at σ·t_step = .9 ns², max(I) = 256; σ itself cancels."""
    sigma, step = 1.8e-9, SIGMA_TIMES_STEP_S2 / 1.8e-9
    snr = (law.snr_gaussian_stack if full else law.snr_eq16)(sigma, step, _LEVELS)
    return float(law.range_accuracy_eq17(sigma, snr, speed_m_per_s))


def chance_of_round_numbers() -> float:
    """Probability that a random accuracy would fit some p/max as well as 8.894 mm fits .9/256.

    p is any number with at most two digits (1 … 99, any power of ten), max one of 255, 256, 4095, 4096, 65535, 65536;
    the accuracy is log-uniform and known to four digits, c is 3e8 or exact. Counted on a fine grid.
    """
    tolerance = 2.0 * 0.5e-3 / 8.894  # of (2δr/c)², from half of the last digit of δr
    mantissa = np.unique(np.arange(1, 100) / 10.0 ** (np.arange(1, 100) > 9))
    centre = np.array([p / m * k for p in mantissa for m in (255, 256, 4095, 4096, 65535, 65536)
                       for k in (1.0, (_C_ROUNDED / C_M_PER_S) ** 2)])  # fmt: skip
    position = np.log10(centre) % 1.0
    grid = (np.arange(200_000) + 0.5) / 200_000
    half = tolerance / math.log(10.0)
    order = np.sort(np.concatenate([position - 1.0, position, position + 1.0]))
    at = np.searchsorted(order, grid)
    near = np.minimum(grid - order[at - 1], order[at] - grid)
    return float(np.mean(near <= half))


def _monte_carlo() -> tuple[float, float]:
    """Standard deviation of a weighted average over that of Eq. 17 with Eq. 15, and over Eq. 17 with Eq. 16.

    A Gaussian response, σ = 2 steps, max(I) = 256 photoelectrons, photon noise only, 20,000 stacks.
    """
    k = np.arange(-16, 17, dtype=float)
    expected = _LEVELS * np.exp(-0.5 * (k / 2.0) ** 2)
    draws = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(14,))).poisson(expected, (20_000, k.size))
    found = float(np.std((draws * k).sum(axis=1) / draws.sum(axis=1)))
    right = 2.0 / float(law.snr_eq15(expected))
    printed = 2.0 / float(law.snr_eq16(2.0, 1.0, _LEVELS))
    return found / right, found / printed


def accuracy_rows() -> list[Row]:
    """Rows of Eq. 14-17 and 25."""
    counts = np.array([4.0, 64.0, 256.0, 64.0, 4.0])
    fourteen, fifteen = float(law.snr_eq14(counts, np.sqrt(counts))), float(law.snr_eq15(counts))
    noisy = float(law.snr_eq14(counts, np.sqrt(counts + 5.0**2)))
    right, printed = _monte_carlo()
    product = implied(RANGE_ACCURACY_M, _C_ROUNDED) * _LEVELS * 1e18
    mm = 1e3
    got, got_exact_c, full = (mm * _accuracy(_C_ROUNDED), mm * _accuracy(C_M_PER_S), mm * _accuracy(_C_ROUNDED, True))
    single = float(law.depth_accuracy(RANGE_ACCURACY_M, RANGE_ACCURACY_M)) * mm
    halved = fifteen / float(law.snr_eq15(0.5 * counts))  # of δr, photon noise; with electronic noise alone it is 2
    rows = [
        Row("Eq. 14", "Eq. 14 with photon noise over Eq. 15, less 1", "1", 0.0, fourteen / fifteen - 1.0, 1e-12,
            judge_exact(0.0, fourteen / fifteen - 1.0, 1e-12), "the step from Eq. 14 to Eq. 15 holds for photon noise"),
        Row("Eq. 15", "Eq. 14 over Eq. 15 with 5 electrons of read noise", "1", math.nan, noisy / fifteen, math.nan,
            "by-construction", "an example of noise that Eq. 15 neglects; moreover I must be photoelectrons: grey levels of an "
            "8-bit or intensified camera are not Poisson distributed", "intensities; read noise"),
        Row("Eq. 15", "standard deviation of a weighted average over that from Eq. 17 with Eq. 15", "1", 1.0, right, 0.02,
            judge_exact(1.0, right, 0.02),
            "Eq. 17 holds with the full sum; photon noise, 20,000 stacks, standard error .5 %"),
        Row("Eq. 16", "standard deviation of a weighted average over that from Eq. 17 with Eq. 16", "1", 1.0, printed,
            0.02, judge_exact(1.0, printed, 0.02),
            "Eq. 16 omits √(2π): a Gaussian response sums to √(2π)σ/t_step slices, so true errors are (2π)^-¼ = .632 of "
            "the printed ones; 20,000 stacks, standard error .5 %"),
        Row("Eq. 17", "range accuracy of the set-up, σ·t_step/max(I) = .9/256 ns², c = 3e8 m/s", "mm",
            mm * RANGE_ACCURACY_M, got, 5e-4, "fitted",
            "8.894 mm implies (2δr/c)² = σ·t_step/max(I); the document prints none of the three. .9 ns² and 256 levels "
            f"give all its digits, but for a random number some pair of round values would do so with probability "
            f"{chance_of_round_numbers():.2f}: a likely reading, but no evidence for σ or t_step separately",
            "σ·t_step/max(I)"),
        Row("Eq. 17", "σ·t_step that 8.894 mm implies with max(I) = 256", "ns²", math.nan, product, math.nan, "fitted",
            "determined by 8.894 mm: one value, one unknown", "σ·t_step/max(I)"),
        Row("Eq. 17", "the same accuracy with c = 299,792,458 m/s", "mm", mm * RANGE_ACCURACY_M, got_exact_c, 5e-4,
            "undetermined",
            "8.888, not 8.894, at .9/256 ns²: with this reading the document used c = 3e8 m/s; another, less round σ·t_step "
            "would give 8.894. In air, n_g = 1.00028 reduces it by another 2.5 µm", "σ·t_step/max(I)"),
        Row("Eq. 17", "the same accuracy with the √(2π) that Eq. 16 drops", "mm", mm * RANGE_ACCURACY_M, full, 5e-4,
            "undetermined",
            "error of a weighted average at .9/256 ns² if grey levels were photoelectrons; another σ·t_step "
            "would give 8.894", "σ·t_step/max(I)"),
        Row("Eq. 17", "standard deviation of a depth, the difference of two such ranges", "mm", mm * RANGE_ACCURACY_M,
            single, 5e-4, judge_exact(mm * RANGE_ACCURACY_M, single, 5e-4),
            "Eq. 25 uses the accuracy of one range for a depth, the difference of two ranges: √2 is missing"),
        Row("Eq. 17", "range accuracy at half the reflectivity over that at full, photon noise", "1", 2.0, halved, 0.1,
            judge_band(2.0, halved, 2.0, 0.1),
            "the abstract: accuracy is proportional to reflectivity. By Eq. 15 and 17 δr ∝ 1/√ρ; by Eq. 14 δr ∝ 1/ρ where "
            "electronic noise dominates (Figure 3). The document does not say which noise dominates", "electronic noise"),
    ]  # fmt: skip
    for number, (depth, published) in enumerate(zip(DEPTHS_M, (1.85, 2.22), strict=True), start=1):
        value = float(law.depth_error_percent_eq25(RANGE_ACCURACY_M, depth))
        rows.append(
            Row("Eq. 25", f"depth error of Object {number} per set-up", "%", published, value, 5e-3,
                judge_exact(published, value, 5e-3), f"8.894 mm over {depth:g} m"))  # fmt: skip
    return rows
