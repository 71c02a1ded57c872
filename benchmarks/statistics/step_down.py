"""p-values of many tests at once, corrected for their number by the joint distribution of their statistics.

Sort the observed statistics T_1 >= T_2 >= …. With T*_k the statistics of one draw without any difference,

    p̃_k = max_{j<=k} P(max_{l>=j} T*_l >= T_j),

so that tests that go together (a >> b, a >> c) cost less than by Holm's bound, and a test that was decided costs no more.
The chance of any wrong rejection is at most α where the draws are exchangeable with the observation.
Source: P. Westfall and S. Young, Resampling-Based Multiple Testing, 1993, sec. 2.6; J. Romano and M. Wolf, Econometrica 73:1237,
2005.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["one_by_one", "step_down"]

Float = npt.NDArray[np.float64]

#: Statistics that agree to rounding are equal: a flip of all signs repeats the observation.
_ROUNDING = 1.0 - 1e-9


def step_down(observed: Float, draws: Float, *, extra: int = 0) -> Float:
    """p̃ (test) of observed statistics (test) and draws of them without differences (test, draw).

    Other arguments:
        extra: draws to add that are the observation itself: 1 for random draws, 0 where `draws` holds all there are.
    NaN statistics are no tests: they stay NaN.
    """
    found = np.full(observed.shape, np.nan)
    tests = np.flatnonzero(~np.isnan(observed))
    order = tests[np.argsort(observed[tests], kind="stable")]  # the least first
    largest = np.full(draws.shape[1], -np.inf)
    for k in order:
        largest = np.maximum(largest, draws[k])
        beyond = np.count_nonzero(largest >= observed[k] * _ROUNDING)
        found[k] = (beyond + extra) / (draws.shape[1] + extra)
    found[order[::-1]] = np.maximum.accumulate(found[order[::-1]])
    return found


def one_by_one(observed: Float, draws: Float, *, extra: int = 0) -> Float:
    """p (test) of each test alone, of the same arguments."""
    beyond = np.count_nonzero(draws >= observed[:, None] * _ROUNDING, axis=1)
    return np.where(np.isnan(observed), np.nan, (beyond + extra) / (draws.shape[1] + extra))
