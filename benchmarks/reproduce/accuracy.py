"""Eq. 16, 17 and 25 of Guo et al. 2017, and the 8.894 mm that its section 5.2 gives as the range accuracy of the set-up."""

from __future__ import annotations

import math

import numpy as np

from ...optics import accuracy as law
from ...optics.constants import C_M_PER_S
from .rows import Row, judge_exact, judge_settings

__all__ = [
    "DEPTHS_M", "RANGE_ACCURACY_M", "SIGMA_TIMES_STEP_S2", "accuracy_rows", "chance_of_round_numbers", "depth_over_range",
    "implied", "snr_over_eq16",
]  # fmt: skip

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


def _monte_carlo() -> float:
    """Standard deviation of a weighted average over that of Eq. 17 with Eq. 15.

    A Gaussian response, σ = 2 steps, max(I) = 256 photoelectrons, photon noise only, 20,000 stacks.
    """
    k = np.arange(-16, 17, dtype=float)
    expected = _LEVELS * np.exp(-0.5 * (k / 2.0) ** 2)
    draws = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(14,))).poisson(expected, (20_000, k.size))
    found = float(np.std((draws * k).sum(axis=1) / draws.sum(axis=1)))
    return found / (2.0 / float(law.snr_eq15(expected)))


def snr_over_eq16(gate_sigmas: float) -> float:
    """√ΣI over the right-hand side of Eq. 16 for the document's Gaussian pulse and rectangular gate, by summation.

    `gate_sigmas` is t_gate over σ_p. R is the gate's indicator correlated with the pulse; σ² its variance, as in Eq. 17.
    (2π)^¼ = 1.58 for a short gate, 12^¼ = 1.86 for a long one.
    """
    u = np.linspace(-0.5 * gate_sigmas - 8.0, 0.5 * gate_sigmas + 8.0, 20_001)
    step = u[1] - u[0]
    cdf = np.cumsum(np.exp(-0.5 * u**2)) * step / math.sqrt(2.0 * math.pi)
    shape = np.interp(u + 0.5 * gate_sigmas, u, cdf) - np.interp(u - 0.5 * gate_sigmas, u, cdf)
    sigma = math.sqrt(float(np.sum(shape * u**2) / np.sum(shape)))
    return math.sqrt(float(np.sum(shape))) / float(law.snr_eq16(sigma, float(step), float(shape.max())))


def depth_over_range(pixels: int) -> float:
    """Accuracy of a depth over that of one range, √(1 + 1/N): against a background averaged over N pixels."""
    return math.sqrt(1.0 + 1.0 / pixels)


def accuracy_rows() -> list[Row]:
    """Rows of Eq. 16, 17 and 25."""
    mm = 1e3
    got, got_exact_c, full = (mm * _accuracy(_C_ROUNDED), mm * _accuracy(C_M_PER_S), mm * _accuracy(_C_ROUNDED, True))
    right = _monte_carlo()
    ratios = [snr_over_eq16(width) for width in (0.1, 1.0, 3.0, 10.0, 100.0)]
    rows = [
        Row("Eq. 16", "√ΣI over the √(σ/t_step · max I) that Eq. 16 sets equal to it, short gate", "1", math.nan, ratios[0],
            0.02, judge_settings(abs(ratio - 1.0) <= 0.02 for ratio in ratios),
            f"{min(ratios):.2f} for short gates … {max(ratios):.2f} for long ones, with the Gaussian pulse and the rectangular "
            "gate of Eq. 6 and 20. Eq. 16 prints «≈» between SNR and √ΣI and «=» before the last form: judged here is that "
            "equality, which omits √(2π) … √12 under the root. As an estimate within a factor of two Eq. 16 holds"),
        Row("Eq. 17", "standard deviation of a weighted average over that from Eq. 17 with Eq. 15", "1", math.nan, right,
            0.02, judge_exact(1.0, right, 0.02),
            "Eq. 17 holds with the full sum; photon noise, 20,000 stacks, standard error .5 %"),
        Row("Eq. 17", "range accuracy of the set-up, σ·t_step/max(I) = .9/256 ns², c = 3e8 m/s", "mm",
            mm * RANGE_ACCURACY_M, got, 5e-4, "fitted",
            "8.894 mm implies (2δr/c)² = σ·t_step/max(I); the document prints none of the three. .9 ns² and 256 levels "
            f"give all its digits, but for a random number some pair of round values would do so with probability "
            f"{chance_of_round_numbers():.2f}: a likely reading, but no evidence for σ or t_step separately. With c = "
            f"299,792,458 m/s it would be {got_exact_c:.3f} mm, with the √(2π) that Eq. 16 omits {full:.2f} mm",
            "σ·t_step/max(I)"),
    ]  # fmt: skip
    for number, (depth, published) in enumerate(zip(DEPTHS_M, (1.85, 2.22), strict=True), start=1):
        value = float(law.depth_error_percent_eq25(RANGE_ACCURACY_M, depth))
        rows.append(
            Row("Eq. 25", f"depth error of Object {number} per set-up", "%", published, value, 5e-3,
                judge_exact(published, value, 5e-3), f"8.894 mm over {depth:g} m"))  # fmt: skip
    factors = {pixels: depth_over_range(pixels) for pixels in (1, 10, 1000)}
    rows.append(
        Row("Eq. 25", "accuracy of a depth of one pixel over that of a range, background of one pixel", "1", math.nan,
            factors[1], 0.01, judge_settings(value <= 1.01 for value in factors.values()),
            "Eq. 25 takes the accuracy of one range for that of a depth, the difference of two ranges: the factor is √(1 + 1/N) "
            "for a background averaged over N pixels, √2 for one and 1 for many. The document does not give N",
            "pixels of the background"))  # fmt: skip
    return rows
