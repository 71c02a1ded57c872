"""Comparison of estimators on few scenes, by the tiles of these scenes: which is better here is decided, elsewhere not.

With fewer scenes than an interval over scenes needs, a run still tells how estimators compare on its own scenes: their errors
are known tile by tile, on the same pixels with the same noise. In scene s with sums x_isk of squared errors of estimator i
over the K_s tiles of all seeds,

    L_i = mean_s ½ ln(Σ_k x_isk/Σ_k n_sk),        L_i − L_j = ln(error of i / error of j).

Tiles are blocks: they are drawn with replacement within each scene, the same draws for all estimators. The p-value of a pair
is twice the share of draws in which its difference has the other sign, at least 2/(draws + 1), corrected by Holm for all
pairs. A pair is left open where a few tiles hold most of the error of either estimator in a scene (`concentrated`).
The statement is about new noise on these scenes, for the calibration that was drawn; not about other scenes.
Source: A. Davison and D. Hinkley, Bootstrap Methods and their Application, 1997, sec. 8.2.3 (blocks), 4.4 (p-values).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from .pairs import Pair, holm
from .pooled import concentrated

__all__ = ["LEAST_TILES", "TileComparison", "compare_by_tiles"]

Float = npt.NDArray[np.float64]

#: Fewest tiles with truth in a scene: with fewer, draws are too much alike.
LEAST_TILES = 15
_DRAWS, _SEED = 4999, 20_260_103


@dataclass(frozen=True)
class TileComparison:
    """All pairs, and the 95 % intervals (low, high) of each estimator's geometric mean error over the scenes."""

    pairs: list[Pair]
    low: Float
    high: Float


def compare_by_tiles(
    names: Sequence[str], scenes: Sequence[tuple[Float, Float]], *, alpha: float = 0.05
) -> TileComparison | None:
    """Compare estimators on the tiles of scenes; None where a scene has fewer than `LEAST_TILES` tiles with truth.

    Main arguments:
        names: of the estimators. scenes: per scene (sums (estimator, tile), counts (tile)).
    Other arguments:
        alpha: family-wise error rate of all pairs.
    """
    rng = np.random.Generator(np.random.PCG64(_SEED))
    logs = np.zeros((len(names), _DRAWS))
    middle = np.zeros(len(names))
    few = np.zeros(len(names), bool)
    for sums, counts in scenes:
        filled = counts > 0
        x, n = sums[:, filled], counts[filled]
        if n.size < LEAST_TILES:
            return None
        few |= concentrated(x) & (x.sum(axis=1) > 0)
        drawn = np.zeros((_DRAWS, n.size))
        np.add.at(drawn, (np.arange(_DRAWS)[:, None], rng.integers(0, n.size, (_DRAWS, n.size))), 1.0)
        with np.errstate(divide="ignore"):
            tiny = np.float64(1e-300)  # no error at all in a scene without noise: equal estimators stay equal
            logs += 0.5 * np.log(np.maximum(x @ drawn.T, tiny) / (drawn @ n)) / len(scenes)
            middle += 0.5 * np.log(np.maximum(x.sum(axis=1), tiny) / n.sum()) / len(scenes)
    low, high = np.exp(np.quantile(logs, [0.025, 0.975], axis=1))
    low, high = (np.where(few, np.nan, ends) for ends in (low, high))
    return TileComparison(_pairs(names, logs, middle, few, len(scenes), alpha), low, high)


def _pairs(
    names: Sequence[str], logs: Float, middle: Float, few: npt.NDArray[np.bool_], scenes: int, alpha: float
) -> list[Pair]:
    index = list(combinations(range(len(names)), 2))
    p = [math.nan if few[i] or few[j] else _p(logs[i] - logs[j]) for i, j in index]
    found = []
    for (i, j), mine, corrected in zip(index, p, holm(p) if p else [], strict=True):
        low, high = np.exp(np.quantile(logs[i] - logs[j], [0.025, 0.975]))
        winner = "" if not corrected <= alpha else names[i] if middle[i] < middle[j] else names[j]
        ratio = math.exp(middle[i] - middle[j])
        ends = (math.nan, math.nan) if few[i] or few[j] else (float(low), float(high))
        found.append(Pair(names[i], names[j], scenes, ratio, *ends, mine, float(corrected), winner))
    return found


def _p(difference: Float) -> float:
    """Two-sided: twice the smaller share of draws on one side of zero; 1 where all draws are zero."""
    below, above = int((difference <= 0).sum()), int((difference >= 0).sum())
    return min(1.0, 2.0 * (1 + min(below, above)) / (1 + difference.size))
