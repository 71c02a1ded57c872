"""Delays of least mean square bound by exchange: one slice after the other moves to the best of all places.

An element i with amplitude and background unknown has σ_i² = 1/(F₀₀ − F₀₁ F₁₁⁻¹ F₁₀), F = Σ_k G_ik the sum over slices of the
Fisher information G_ij = J(μ_ij) a_ij a_ijᵀ at the place j of slice k. Minimised is Σ_i w_i σ_i² (A-optimality on the range).

With nine sums, the last three G_i = Σ_k J a_i (μ − m) of the mean μ, the reader's model m is not that of the light: its range errs
by β = (F⁻¹ G)₀, and σ² + β² takes the place of σ².

Source: V. V. Fedorov, Theory of Optimal Experiments, 1972, ch. 3 (exchange); R. K. Meyer and C. J. Nachtsheim, Technometrics 37:60,
1995 (coordinate by coordinate).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["bias_square", "exchanged", "expected_square", "mean_square", "profiled_variance"]

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

#: Share of F₁₁ below which nothing is left of it but rounding, and sweeps over all slices.
_TINY, _SWEEPS = 1e-9, 8


def profiled_variance(f: Float) -> Float:
    """σ² (…) of the first parameter from sums f (6, …) = F₀₀, F₀₁, F₀₂, F₁₁, F₁₂, F₂₂; infinite where it cannot be told.

    A third parameter without information (F₂₂ = 0) is one that is known.
    """
    f00, f01, f02, f11, f12, f22 = f
    has = f22 > 0
    safe = np.where(has, f22, 1.0)
    cross = np.where(has, f01 - f02 * f12 / safe, f01)
    own = np.where(has, f11 - f12 * f12 / safe, f11)
    left = np.where(has, f00 - f02 * f02 / safe, f00)
    told = own > _TINY * f11
    left = left - np.where(told, cross * cross / np.where(told, own, 1.0), np.where(cross != 0, left, 0.0))
    good = left > _TINY * f00
    return np.asarray(np.where(good, 1.0 / np.where(good, left, 1.0), np.inf))


def bias_square(f: Float) -> tuple[Float, Float]:
    """(σ², β²) (…) of the first parameter from nine sums; both infinite where it cannot be told."""
    f01, f02, f11, f12, f22, g0, g1, g2 = f[1:]
    safe = np.where(f22 > 0, f22, np.inf)
    cross, own = f01 - f02 * f12 / safe, f11 - f12 * f12 / safe
    h0, h1 = g0 - f02 * g2 / safe, g1 - f12 * g2 / safe
    variance = profiled_variance(f[:6])
    told = (own > _TINY * f11) & np.isfinite(variance)
    rest = h0 - cross * h1 / np.where(told, own, 1.0)
    return np.where(told, variance, np.inf), np.where(told, rest * np.where(told, variance, 0.0), np.inf) ** 2


def expected_square(f: Float) -> Float:
    """E(r̂ − r)² (…): σ² from six sums, σ² + β² from nine."""
    if len(f) == 6:
        return profiled_variance(f)
    variance, bias = bias_square(f)
    return np.asarray(variance + bias)


def mean_square(f: Float, weight: Float) -> Float:
    """Σ_i w_i E(r̂_i − r_i)² for sums f (6 or 9, i, …): (…). `weight` (i), sum 1."""
    return np.asarray(np.tensordot(weight, expected_square(f), axes=(0, 0)))


def exchanged(parts: Float, weight: Float, start: Int) -> tuple[Int, float]:
    """(places of the slices, their mean square) from the places `start` (slice) on.

    Main arguments:
        parts (6 or 9, i, j): sums of one slice at place j about element i, as of `expected_square`. weight (i), sum 1.

    Each slice in turn takes the place of least mean square, the others held, until a sweep moves none. Designs that tell nothing of
    some element are left by what they tell of the others: a σ is at most that of 1e-6 of the largest information.
    """
    at = start.copy()
    floor = 1e-6 * float(parts[0].max())
    total = parts[:, :, at].sum(axis=2)
    best = np.inf
    for _ in range(_SWEEPS):
        moved = False
        for k in range(at.size):
            rest = total - parts[:, :, at[k]]
            value = np.minimum(expected_square(rest[:, :, None] + parts), 1.0 / floor)
            score = np.tensordot(weight, value, axes=(0, 0))
            j = int(np.argmin(score))
            if score[j] < score[at[k]] * (1.0 - 1e-9):
                at[k], moved = j, True
            total = rest + parts[:, :, at[k]]
            best = float(score[at[k]])
        if not moved:
            break
    return np.sort(at), best
