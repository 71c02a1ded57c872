"""Statistics of squared normalised errors: the block bootstrap behind `efficiency_lo` and `efficiency_hi`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["block_bootstrap_ratio", "block_ids"]

Float = npt.NDArray[np.float64]

_BLOCKS = 256  # at most: enough for a percentile interval, and one small table of draws serves all rows
_DRAWS = 1000
#: The draws are the same for every estimator, so that intervals of one scene move together.
_SEED = 20_260_101


def block_ids(shape: tuple[int, int]) -> npt.NDArray[np.intp]:
    """A block number for every pixel (row, col): square tiles, at most 256 in all.

    Errors of neighbours can be correlated (phosphor spread, smoothing estimators): a tile is drawn as a whole.
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
    Returns (nan, nan) with fewer than 8 blocks, where percentiles mean little.
    """
    sums = np.bincount(block, weights=value)
    counts = np.bincount(block).astype(np.float64)
    used = counts > 0
    sums, counts = sums[used], counts[used]
    if sums.size < 8:
        return float("nan"), float("nan")
    draws = np.random.Generator(np.random.PCG64(_SEED)).integers(0, sums.size, (_DRAWS, sums.size))
    means = sums[draws].sum(axis=1) / counts[draws].sum(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)
