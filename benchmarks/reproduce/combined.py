"""Table 1, both causes at once: an offset that is not subtracted *and* the radial range taken as depth; Eq. 24 as printed.

A surface at the orthogonal distance z under the angle a has its echo at z/cos a. With a level B in every slice,

    weighted average    (ΣI r + BΣr)/(ΣI + BK)
    Eq. 24 as printed   (ΣI r³ + BΣr³)/(ΣI r² + BΣr²) / cos a

and each is taken as a depth. The offset compresses the depth, the angle stretches it, and the cosine of Eq. 24 stretches
it once more: errors of opposite sign, which may cancel. B and the mean angle θ of the background are fitted to the two
numbers of Object 1; Object 2 is then a prediction. The table prints absolute values, so all four pairs of signs are tried.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .accuracy import DEPTHS_M, SIGMA_TIMES_STEP_S2
from .stacks import Rig, delays, plausible_rigs, sigma_m

__all__ = ["FILLED", "Fits", "depths", "fits"]

Array = NDArray[np.float64]

#: Mean angle of the object over that of the background.
FILLED = (0.0, 0.25, 0.5, 0.75, 0.9)
#: The delays extend this far beyond the background on the axis, in σ …
_FAR_SIGMAS = (5.0, 8.0)
#: … and contain its echo up to 3 σ at the fitted angle: a truncated echo would be a third cause.
_HELD_SIGMAS = 3.0
_GRID = 100
#: Offsets are limited to the peak of Object 1.
_LARGEST_OFFSET = 1.0


@dataclass(frozen=True)
class Fits:
    """All pairs (B, θ) that give both numbers of Object 1, one entry per rig, filled share, pair of signs and solution.

    Main fields:
        offset: B over the peak of Object 1. angle_rad: θ. error1, error2: signed depth errors in % (fit, method) of Object
        1 and 2; the methods are weighted average and Eq. 24 as printed.
        tried: combinations of rig and filled share. fitted: those of them with a solution.
    """

    offset: Array
    angle_rad: Array
    error1: Array
    error2: Array
    tried: int
    fitted: int


@dataclass(frozen=True)
class _Sums:
    """Σrⁿ of the delays and ΣI rⁿ of a unit echo of background and front, n = 0 … 3 on the last axis."""

    level: Array
    back: Array
    front: Array


def _sums(rig: Rig, depth_m: float, angle: Array, filled: float) -> _Sums:
    r = delays(rig, DEPTHS_M[0])
    powers = r[:, None] ** np.arange(4)

    def unit(z_m: float, angle: Array) -> Array:
        echo = np.exp(-0.5 * ((r - (z_m / np.cos(angle))[..., None]) / sigma_m(rig)) ** 2)
        return np.asarray(echo @ powers)

    back, front = unit(rig.background_m, angle), unit(rig.background_m - depth_m, filled * angle)
    return _Sums(powers.sum(axis=0), back, front)


def _found(sums: _Sums, rig: Rig, signal: float, offset: Array, angle: Array, filled: float) -> Array:
    def both(echo: Array, angle: Array) -> Array:
        m = echo + offset[..., None] * sums.level
        return np.stack([m[..., 1] / m[..., 0], m[..., 3] / m[..., 2] / np.cos(angle)], axis=-1)

    return both(rig.wall * sums.back, angle) - both(signal * sums.front, filled * angle)


def depths(rig: Rig, depth_m: float, signal: float, offset: Any, angle_rad: Any, filled: float) -> Array:
    """Depths by weighted average and by Eq. 24 as printed, m, on the last axis, for each offset and angle."""
    level, angle = (np.asarray(value, dtype=np.float64) for value in (offset, angle_rad))
    return _found(_sums(rig, depth_m, angle, filled), rig, signal, level, angle, filled)


def _offset(sums: _Sums, rig: Rig, wanted_m: Array, branch: Array) -> Array:
    """B at which the weighted average gives the depth `wanted_m` for Object 1, NaN where there is none.

    back(B) − front(B) = D is a quadratic equation in B, for both are (M₁ + BT₁)/(M₀ + BT₀); `branch` ± 1 is its root.
    """
    t0, t1 = sums.level[0], sums.level[1]
    back = rig.wall * sums.back
    b0, b1, f0, f1 = back[..., 0], back[..., 1], sums.front[..., 0], sums.front[..., 1]
    c2 = -wanted_m * t0**2
    c1 = b1 * t0 + t1 * f0 - f1 * t0 - t1 * b0 - wanted_m * t0 * (b0 + f0)
    c0 = b1 * f0 - f1 * b0 - wanted_m * b0 * f0
    square = c1**2 - 4.0 * c2 * c0
    root = (-c1 + branch * np.sqrt(np.maximum(square, 0.0))) / (2.0 * c2)
    return np.where((square >= 0.0) & (root > 0.0) & (root <= _LARGEST_OFFSET), root, np.nan)


def _solve(rig: Rig, errors: Array, filled: float) -> Array:
    """(B, θ) of each solution at which weighted average and Eq. 24 give relative depth `errors` (pair, 2) of Object 1."""
    end = delays(rig, DEPTHS_M[0])[-1]
    cosine = rig.background_m / (end - _HELD_SIGMAS * sigma_m(rig))
    angle = np.linspace(0.0, np.arccos(cosine), _GRID)[None, :]
    wanted, printed = (np.repeat(DEPTHS_M[0] * (1.0 + column), 2)[:, None] for column in errors.T)
    branch = np.tile([-1.0, 1.0], len(errors))[:, None]

    def excess(angle: Array, wanted: Array, printed: Array, branch: Array) -> tuple[Array, Array]:
        sums = _sums(rig, DEPTHS_M[0], angle, filled)
        offset = _offset(sums, rig, wanted, branch)
        return _found(sums, rig, 1.0, offset, angle, filled)[..., 1] - printed, offset

    value, _ = excess(angle, wanted, printed, branch)
    which, at = np.nonzero(value[:, :-1] * value[:, 1:] < 0.0)
    low, high, sign = angle[0, at], angle[0, at + 1], np.sign(value[which, at])
    given = (wanted[which, 0], printed[which, 0], branch[which, 0])
    for _ in range(24):  # a grid's step of .01 rad over 2²⁴: 1e-9 rad
        middle = 0.5 * (low + high)
        same = sign * excess(middle, *given)[0] > 0.0
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    found = 0.5 * (low + high)
    return np.stack([excess(found, *given)[1], found], axis=-1)


@lru_cache(maxsize=1)
def fits(weighted_average: float, printed: float) -> Fits:
    """Fit Object 1's two absolute errors (fractions of the depth) in every plausible rig, and predict Object 2's."""
    rigs = plausible_rigs(SIGMA_TIMES_STEP_S2, DEPTHS_M[0], far_sigmas=_FAR_SIGMAS)
    signs = np.array(list(itertools.product((-weighted_average, weighted_average), (-printed, printed))))
    pairs, first, second, fitted = [], [], [], 0
    for (key, group), filled in itertools.product(_alike(rigs), FILLED):
        mine = _solve(key, signs, filled)
        fitted += len(group) * bool(mine.size)
        offset, angle = mine.T
        for rig in group:
            pairs.append(mine)
            first.append(depths(rig, DEPTHS_M[0], 1.0, offset, angle, filled) / DEPTHS_M[0])
            second.append(depths(rig, DEPTHS_M[1], rig.weaker, offset, angle, filled) / DEPTHS_M[1])
    found = np.concatenate(pairs)
    error1, error2 = (100.0 * (np.concatenate(part) - 1.0) for part in (first, second))
    return Fits(found[:, 0], found[:, 1], error1, error2, len(rigs) * len(FILLED), fitted)


def _alike(rigs: list[Rig]) -> list[tuple[Rig, list[Rig]]]:
    """Groups of rigs that differ only in the signal of Object 2, which does not affect Object 1."""
    groups: dict[tuple[float, ...], list[Rig]] = {}
    for rig in rigs:
        key = (rig.sigma_s, rig.step_s, rig.background_m, rig.near_sigmas, rig.far_sigmas, rig.wall)
        groups.setdefault(key, []).append(rig)
    return [(group[0], group) for group in groups.values()]
