"""Delays of least mean square bound by exchange: one slice after the other moves to the best of all places.

An element i with amplitude and background unknown has σ_i² = 1/(F₀₀ − F₀₁ F₁₁⁻¹ F₁₀), F = Σ_k G_ik the sum over slices of the
Fisher information G_ij = J(μ_ij) a_ij a_ijᵀ at the place j of slice k. Minimised is Σ_i w_i σ_i² (A-optimality on the range).

Source: V. V. Fedorov, Theory of Optimal Experiments, 1972, ch. 3 (exchange); R. K. Meyer and C. J. Nachtsheim, Technometrics 37:60,
1995 (coordinate by coordinate).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["exchanged", "mean_square", "profiled_variance"]

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


def mean_square(f: Float, weight: Float) -> Float:
    """Σ_i w_i σ_i² for sums f (6, i, …): (…). `weight` (i), sum 1."""
    return np.asarray(np.tensordot(weight, profiled_variance(f), axes=(0, 0)))


def exchanged(parts: Float, weight: Float, start: Int) -> tuple[Int, float]:
    """(places of the slices, their mean square) from the places `start` (slice) on.

    Main arguments:
        parts (6, i, j): information of one slice at place j about element i, as of `profiled_variance`. weight (i), sum 1.

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
            value = np.minimum(profiled_variance(rest[:, :, None] + parts), 1.0 / floor)
            score = np.tensordot(weight, value, axes=(0, 0))
            j = int(np.argmin(score))
            if score[j] < score[at[k]] * (1.0 - 1e-9):
                at[k], moved = j, True
            total = rest + parts[:, :, at[k]]
            best = float(score[at[k]])
        if not moved:
            break
    return np.sort(at), best
