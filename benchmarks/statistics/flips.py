"""Exact tests and intervals of paired differences over scenes, by flipping their signs.

Where a and b are equally good, the difference x_s of scene s is as likely −x_s. Over all 2^n flips of n scenes (4,096 random ones
above 13), t = m/e of the flipped differences, m their mean and e its standard error, has the distribution that t has without a
difference. The test is exact for any n, any spread and any tails, as long as each difference is symmetric about zero. One scene
in which both err alike or wildly keeps |t| near 1 in all flips, and widens nothing.

The interval is made of the means of all subsets of scenes: for differences that are symmetric about their centre, the k-th least
of 2^n − 1 means lies above the centre with probability k/2^n.

A symmetric distribution has its mean in its middle. Where differences are skewed (exponential about a mean of zero), the tests
speak of the middle: 10 to 17 % claim that one of 8 is better, which is true of most scenes and not of the mean.
Source: R. Fisher, The Design of Experiments, 1935, sec. 21; J. Hartigan, J. Am. Stat. Assoc. 64:1303, 1969 (typical values).
"""

from __future__ import annotations

from functools import lru_cache
from itertools import product

import numpy as np
import numpy.typing as npt

from .step_down import one_by_one, step_down

__all__ = ["flip_tests", "typical_interval"]

Float = npt.NDArray[np.float64]

#: Up to so many scenes all flips are made: 2^12 differ but for the sign of all.
_ALL = 13
_DRAWS, _SEED = 4095, 20_260_104
#: Logarithms of equal errors differ by rounding: that is no difference.
_ROUNDING = 1e-12


@lru_cache(maxsize=8)
def _signs(scenes: int) -> Float:
    """Signs (flip, scene), the first of them all +1. A flip of all signs has the same |t| and is left out."""
    if scenes <= _ALL:
        return np.array([(1.0, *rest) for rest in product((1.0, -1.0), repeat=scenes - 1)])
    rng = np.random.Generator(np.random.PCG64(_SEED))
    return np.vstack([np.ones(scenes), rng.choice([1.0, -1.0], (_DRAWS, scenes))])


@lru_cache(maxsize=8)
def _shares(scenes: int) -> Float:
    """Weights (subset, scene) of the mean of each subset that holds a scene at least."""
    if scenes < _ALL:
        held = np.array(list(product((0.0, 1.0), repeat=scenes)))[1:]
    else:
        held = np.random.Generator(np.random.PCG64(_SEED)).integers(0, 2, (_DRAWS, scenes)).astype(np.float64)
        held[held.sum(axis=1) == 0, 0] = 1.0
    return np.asarray(held / held.sum(axis=1, keepdims=True))


def flip_tests(differences: npt.ArrayLike) -> tuple[Float, Float]:
    """Two-sided p (test) of each row of differences (test, scene), and p̃ (test) corrected for the number of tests.

    Rows with NaN have NaN. The smallest p of n scenes is 2^(1 − n): with 6 scenes .03.
    """
    x = np.asarray(differences, np.float64)
    x = np.where(np.abs(x) < _ROUNDING, 0.0, x)
    tests, scenes = x.shape
    if not tests:
        return np.empty(0), np.empty(0)
    mean = x @ _signs(scenes).T / scenes
    square = (x * x).mean(axis=1, keepdims=True)  # flips leave squares as they are
    spread = np.sqrt(np.maximum(square - mean * mean, 1e-24 * square) / (scenes - 1))
    size = np.abs(mean) / np.where(spread > 0, spread, 1.0)
    observed = np.where(np.isnan(x).any(axis=1), np.nan, size[:, 0])
    return one_by_one(observed, size), step_down(observed, size)


def typical_interval(values: npt.ArrayLike, *, level: float = 0.95) -> tuple[Float, Float]:
    """Limits (...) of the centre of values (..., scene): order statistics of the means of their subsets.

    NaN for fewer than 6 scenes, whose least and largest means miss too often, and where a value is NaN.
    """
    x = np.asarray(values, np.float64)
    scenes = x.shape[-1]
    tail = (1.0 - level) / 2.0
    if scenes * np.log(2.0) < -np.log(tail):
        return np.full(x.shape[:-1], np.nan), np.full(x.shape[:-1], np.nan)
    means = x @ _shares(scenes).T
    rank = max(int(tail * (means.shape[-1] + 1)), 1) - 1
    ordered = np.partition(means, [rank, means.shape[-1] - 1 - rank], axis=-1)
    return ordered[..., rank], ordered[..., means.shape[-1] - 1 - rank]
