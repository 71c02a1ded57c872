"""Pile-up of time-correlated single-photon counting, and its correction.

In bin k the detector is live for live_k = M − Σ_{j=k−m}^{k−1} n_j of M pulses: after a count it is dead for the m bins
that follow. A live pulse gives a count with probability 1 − exp(−λ_k), λ_k the mean photoelectrons per pulse in the bin.
With a dead time longer than the record (m ≥ number of bins) only the first photon counts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .correlation.parts import Array

__all__ = ["coates_rate", "count_information", "dead_bins", "expected_counts", "live_pulses"]


def dead_bins(dead_time_s: float, step_s: float, bins: int) -> int:
    """m, the number of bins after a count in which the detector is dead: the dead time in bins, rounded up."""
    return int(min(np.ceil(dead_time_s / step_s - 1e-9), bins))


def expected_counts(rate: ArrayLike, pulses: float, dead: int) -> tuple[Array, Array]:
    """(E n_k, E live_k), each (…, bin), for λ (…, bin) per pulse: exact, since both are linear in earlier counts.

    Main arguments:
        rate: λ, ≥ 0. pulses: M. dead: m bins.
    """
    rate = np.asarray(rate, np.float64)
    chance = -np.expm1(-rate)
    counts, live = np.zeros_like(rate), np.zeros_like(rate)
    blind = np.zeros(rate.shape[:-1])
    for k in range(rate.shape[-1]):
        live[..., k] = pulses - blind
        counts[..., k] = live[..., k] * chance[..., k]
        if dead > 0:
            blind = blind + counts[..., k]
            if k >= dead:
                blind = blind - counts[..., k - dead]
        blind = np.maximum(blind, 0.0)
    return counts, live


def live_pulses(counts: ArrayLike, pulses: ArrayLike, dead: int) -> Array:
    """live_k (…, bin) for counts n (…, bin): the pulses for which the detector is live."""
    counts = np.asarray(counts, np.float64)
    before = np.zeros_like(counts)
    if dead > 0:
        total = np.cumsum(counts, axis=-1)
        before[..., 1:] = total[..., :-1]
        if dead < counts.shape[-1]:
            before[..., dead + 1 :] -= total[..., : -dead - 1]
    return np.asarray(np.asarray(pulses, np.float64)[..., None] - before)


def coates_rate(counts: ArrayLike, pulses: ArrayLike, dead: int) -> tuple[Array, Array]:
    """(λ̂, its variance), each (…, bin): λ̂_k = −ln(1 − n_k/live_k) (Coates, J. Phys. E 1:878, 1968).

    It is the maximum-likelihood estimate of each bin; var λ̂ ≈ n_k/(live_k (live_k − n_k)). NaN where no pulse is live
    or every live pulse gave a count.
    """
    counts = np.asarray(counts, np.float64)
    live = live_pulses(counts, pulses, dead)
    with np.errstate(divide="ignore", invalid="ignore"):
        good: NDArray[np.bool_] = live > counts
        rate = np.where(good, -np.log1p(-counts / live), np.nan)
        variance = np.where(good, counts / (live * (live - counts)), np.nan)
    return rate, variance


def count_information(rate: ArrayLike, live: ArrayLike) -> Array:
    """Fisher information about λ_k of bin k given its live pulses: live/(e^λ − 1), → live/λ for small λ."""
    rate = np.clip(np.asarray(rate, np.float64), 1e-300, 700.0)  # e^700: no information is left
    return np.asarray(np.asarray(live, np.float64) / np.expm1(rate))
