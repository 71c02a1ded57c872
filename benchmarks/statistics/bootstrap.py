"""Studentised bootstrap over scenes: intervals and two-sided tests of a mean, for many problems at once.

The scenes are the sample: a statement about an estimator must hold for other scenes of the same kind, not for other
pixels of the same scenes. With x_s the value of scene s (pooled over seeds), m and e the mean and its standard error and
* a draw of scenes with replacement, t* = (m* − m)/e*. Two intervals follow from it,

    equal-tailed   [m − e·q(t*; .975), m − e·q(t*; .025)]      second-order correct under skew, short under heavy tails
    symmetric      m ∓ e·q(|t*|; .95)                          long under heavy tails, not corrected for skew,

and the returned interval is the mean of their ends. Coverage of the three on 12 scenes, 20,000 problems: normal .950 .959
.954, Student t with 3 degrees of freedom .928 .971 .960, exponential .947 .937 .941. The test is the symmetric one.
Every problem gets the same draws, so that a draw is a row of counts and the bootstrap is two matrix products.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

__all__ = ["MIN_SCENES", "Inference", "studentised"]

Float = npt.NDArray[np.float64]

#: With fewer scenes most draws are alike, and no interval is given.
MIN_SCENES = 6
_DRAWS = 4999
_SEED = 20_260_102
_CHUNK = 2048  # problems at a time: 80 MB of t*


@dataclass(frozen=True)
class Inference:
    """Mean, its standard error, interval and two-sided p-value against a mean of zero; arrays of one shape."""

    mean: Float
    error: Float
    low: Float
    high: Float
    p: Float


@lru_cache(maxsize=8)
def _weights(scenes: int, draws: int, seed: int) -> Float:
    """Shares (draw, scene) of draws with replacement."""
    rng = np.random.Generator(np.random.PCG64(seed))
    drawn = rng.integers(0, scenes, (draws, scenes))
    counts = np.zeros((draws, scenes))
    np.add.at(counts, (np.arange(draws)[:, None], drawn), 1.0)
    return counts / scenes


def studentised(values: npt.ArrayLike, *, level: float = 0.95, draws: int = _DRAWS, seed: int = _SEED) -> Inference:
    """Inference on the mean of each row of `values` (…, scene), scenes exchangeable.

    Main arguments:
        values: one figure per scene, e.g. differences of log errors. level: of the interval.
    Other arguments:
        draws, seed: of the bootstrap; draws + 1 should be a multiple of 40 so that quantiles are draws themselves.

    With fewer than `MIN_SCENES` scenes, or a NaN among them, interval and p are NaN. If all scenes agree to rounding, the
    interval is the mean itself and p is 0 or, for a mean of zero, 1. The smallest p is 1/(draws + 1). Limits lie between the least
    and the largest value: one scene that is unlike all others makes draws without it seem exact, and limits of 10^100.
    Source: B. Efron and R. Tibshirani, An Introduction to the Bootstrap, 1993, sec. 12.5 (bootstrap-t); P. Hall, The
    Bootstrap and Edgeworth Expansion, 1992, sec. 3.6 (symmetric).
    """
    x = np.asarray(values, dtype=np.float64)
    if not 0.5 < level < 1.0:
        raise ValueError(f"level must lie between 0.5 and 1, not {level!r}")
    if x.ndim == 0:
        raise ValueError("values need an axis of scenes")
    shape, scenes = x.shape[:-1], x.shape[-1]
    flat = x.reshape(-1, scenes)
    out = np.full((5, flat.shape[0]), np.nan)
    if scenes:
        out[0] = flat.mean(axis=1)
    if scenes > 1:
        out[1] = flat.std(axis=1, ddof=1) / np.sqrt(scenes)
    if scenes >= MIN_SCENES:
        weights = _weights(scenes, draws, seed)
        for first in range(0, flat.shape[0], _CHUNK):
            part = slice(first, first + _CHUNK)
            out[2:, part] = _interval(flat[part], out[0, part], out[1, part], weights, level)
    mean, error, low, high, p = (row.reshape(shape) for row in out)
    return Inference(mean, error, low, high, p)


def _interval(x: Float, mean: Float, error: Float, weights: Float, level: float) -> Float:
    scenes = x.shape[1]
    # Variations below rounding are zero: paired differences of equal estimators must not give a t from rounding noise.
    still = error <= 1e-12 * np.maximum(np.abs(x).max(axis=1), 1e-300)
    safe = np.where(still, 1.0, error)
    centred = (x - mean[:, None]) / safe[:, None]
    first = centred @ weights.T
    second = (centred * centred) @ weights.T
    spread = np.sqrt(np.maximum(second - first * first, 0.0) / (scenes - 1))
    # A draw of one scene n times has no spread; its t is infinite and is beyond every quantile.
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(spread > 1e-9, first / spread, np.sign(first) * np.inf)
    size = np.abs(t)
    tail = (1.0 - level) / 2.0
    bottom, top = _order(t, tail, 1.0 - tail)
    (both,) = _order(size, level)
    low = mean - safe * 0.5 * (top + both)
    high = mean - safe * 0.5 * (bottom - both)
    least, largest = x.min(axis=1), x.max(axis=1)
    low, high = np.clip(low, least, largest), np.clip(high, least, largest)
    observed = np.abs(mean) / safe
    beyond = np.count_nonzero(size >= observed[:, None], axis=1)
    p = (1.0 + beyond) / (1.0 + t.shape[1])
    low, high = np.where(still, mean, low), np.where(still, mean, high)
    p = np.where(still, np.where(np.abs(mean) > 0.0, 1.0 / (1.0 + t.shape[1]), 1.0), p)
    missing = np.isnan(mean)
    return np.where(missing, np.nan, np.stack([low, high, p]))


def _order(t: Float, *shares: float) -> list[Float]:
    """The order statistics of rank share·(draws + 1), per row."""
    draws = t.shape[1]
    ranks = [min(max(round(share * (draws + 1)), 1), draws) - 1 for share in shares]
    ordered = np.partition(t, ranks, axis=1)
    return [ordered[:, rank] for rank in ranks]
