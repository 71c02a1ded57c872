"""Statistics shared by rows and pooled rows: totals that few units make up, significant bias, the kind of a pooled bound,
and the block bootstrap of `efficiency_lo` and `efficiency_hi`."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

__all__ = ["bias_is_real", "block_bootstrap_ratio", "block_ids", "concentrated", "weakest_kind"]

Float = npt.NDArray[np.float64]

#: Effective number of units that a total needs before its spread over units is meaningful; two thirds of few units.
_LEAST_UNITS = 10.0
_LEAST_SHARE = 2.0 / 3.0
#: The efficiency is NaN where the bias exceeds this share of the rmse by this many standard errors.
_LARGEST_BIAS = 0.1
_STANDARD_ERRORS = 3.0
#: Kinds of bounds, from the weakest to the strongest.
_WEAKEST_FIRST = ("none", "ziv-zakai", "bayes", "quasi", "exact")

_BLOCKS = (
    256  # largest number of blocks: enough for a percentile interval, and one small table of draws serves all rows
)
_DRAWS = 1000
#: The draws are the same for every estimator, so that intervals of one scene are comparable.
_SEED = 20_260_101


def concentrated(sums: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """True where too few units make up a total Σ_k x_k for its spread over units to be meaningful, (...) of sums (..., unit).

    The effective number of units, 1/Σ_k (x_k/Σx)², must be at least 10, or two thirds of the units if there are fewer than
    15. Otherwise linearised variances and bootstraps describe a handful of outliers: two estimators with the same error
    distribution were called different in up to half of all draws. Totals of zero count as concentrated.
    Source: effective number, L. Kish, Survey Sampling, 1965, sec. 11.2; the limit by simulation (docs/decisions 0018).
    """
    x = np.asarray(sums, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = x / x.sum(axis=-1, keepdims=True)
        effective = 1.0 / (share**2).sum(axis=-1)
    return np.asarray(~(effective >= min(_LEAST_UNITS, _LEAST_SHARE * x.shape[-1])))


def bias_is_real(bias: float, rmse: float, n: float) -> bool:
    """True where |bias| exceeds a tenth of the rmse by 3 standard errors, rmse/√n.

    Main arguments:
        bias, rmse: of n independent elements. For elements with correlated errors the standard error is larger than this.
    """
    return bool(abs(bias) > rmse * (_LARGEST_BIAS + _STANDARD_ERRORS / math.sqrt(n))) if n > 0 else False


def weakest_kind(kinds: Iterable[str]) -> str:
    """Kind of a pooled bound: the weakest of the kinds; an unknown kind counts as "none"."""
    return min((kind if kind in _WEAKEST_FIRST else "none" for kind in kinds), key=_WEAKEST_FIRST.index)


def block_ids(shape: tuple[int, int]) -> npt.NDArray[np.intp]:
    """A block number for every pixel (row, col): square tiles, at most 256 in all.

    Errors of neighbouring pixels can be correlated (phosphor spread, smoothing estimators): a tile is drawn as a whole.
    """
    side = max(1, int(np.ceil(np.sqrt(shape[0] * shape[1] / _BLOCKS))))
    while -(-shape[0] // side) * -(-shape[1] // side) > _BLOCKS:
        side += 1
    per_row = -(-shape[1] // side)
    rows, cols = np.arange(shape[0]) // side, np.arange(shape[1]) // side
    return (rows[:, None] * per_row + cols[None, :]).astype(np.intp)


def block_bootstrap_ratio(value: Float, block: npt.NDArray[np.intp]) -> tuple[float, float]:
    """95 % percentile interval of mean(value) over blocks drawn with replacement (Efron and Tibshirani 1993, ch. 13).

    Main arguments:
        value (n): e.g. squared normalised errors. block (n): the block of each.
    Returns (nan, nan) with fewer than 8 blocks, where percentiles are unreliable, and where few blocks make up most of the
    sum (`concentrated`): the draws would show how often those few were drawn, not how often such errors occur.
    """
    sums = np.bincount(block, weights=value)
    counts = np.bincount(block).astype(np.float64)
    used = counts > 0
    sums, counts = sums[used], counts[used]
    if sums.size < 8 or bool(concentrated(sums)):
        return float("nan"), float("nan")
    draws = np.random.Generator(np.random.PCG64(_SEED)).integers(0, sums.size, (_DRAWS, sums.size))
    means = sums[draws].sum(axis=1) / counts[draws].sum(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)
