"""Comparison of estimators on the scenes of a run: which is better here is decided, elsewhere not.

Errors on the same captures are compared block by block: the captures of a scene (its seeds: noise, pose and calibration differ), or
the tiles of its pictures where it has few captures. In scene s with sums x_isk of squared errors of estimator i over block k,

    L_i = mean_s ½ ln(Σ_k x_isk/Σ_k n_sk),        L_i − L_j = ln(error of i / error of j).

Blocks are drawn with replacement within each scene, one fewer than there are so that variances of few blocks are not too small,
the same draws for all estimators. t = (L_i − L_j)/e with e its standard deviation over draws; its distribution without a
difference is that of (L*_i − L*_j − L_i + L_j)/e; p-values of all pairs are corrected by step-down. A pair is left open where a
few blocks hold most of the error of either estimator in a scene (`concentrated`).
The statement is about new captures of these scenes (blocks that are tiles: new noise, for the pose and calibration that were
drawn); not about other scenes.
Source: A. Davison and D. Hinkley, Bootstrap Methods and their Application, 1997, sec. 8.2.3 (blocks); J. Rao and C. Wu,
J. Am. Stat. Assoc. 83:231, 1988 (one fewer).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from .pairs import Pair
from .pooled import concentrated
from .step_down import one_by_one, step_down

__all__ = ["LEAST_BLOCKS", "HereComparison", "compare_here"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Fewest blocks with truth in a scene: with fewer, draws are too much alike.
LEAST_BLOCKS = 15
_DRAWS, _SEED = 4999, 20_260_103


@dataclass(frozen=True)
class HereComparison:
    """All pairs, and the 95 % intervals (low, high) of each estimator's geometric mean error over the scenes."""

    pairs: list[Pair]
    low: Float
    high: Float


def compare_here(
    names: Sequence[str], scenes: Sequence[tuple[Float, Float]], *, alpha: float = 0.05
) -> HereComparison | None:
    """Compare estimators on the blocks of scenes; None where a scene has fewer than `LEAST_BLOCKS` blocks with truth.

    Main arguments:
        names: of the estimators. scenes: per scene (sums (estimator, block), counts (block)).
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
        if n.size < LEAST_BLOCKS:
            return None
        few |= concentrated(x) & (x.sum(axis=1) > 0)
        drawn = np.zeros((_DRAWS, n.size))
        np.add.at(drawn, (np.arange(_DRAWS)[:, None], rng.integers(0, n.size, (_DRAWS, n.size - 1))), 1.0)
        tiny = np.float64(1e-300)  # no error at all in a scene without noise: equal estimators stay equal
        logs += 0.5 * np.log(np.maximum(x @ drawn.T, tiny) / (drawn @ n)) / len(scenes)
        middle += 0.5 * np.log(np.maximum(x.sum(axis=1), tiny) / n.sum()) / len(scenes)
    low, high = np.exp(np.quantile(logs, [0.025, 0.975], axis=1))
    low, high = (np.where(few, np.nan, ends) for ends in (low, high))
    return HereComparison(_pairs(names, logs, middle, few, len(scenes), alpha), low, high)


def _pairs(names: Sequence[str], logs: Float, middle: Float, few: Bool, scenes: int, alpha: float) -> list[Pair]:
    index = np.array(list(combinations(range(len(names)), 2)), dtype=np.intp).reshape(-1, 2)
    if not len(index):
        return []
    a, b = index.T
    difference, draws = middle[a] - middle[b], logs[a] - logs[b]
    limits = np.exp(np.quantile(draws, [0.025, 0.975], axis=1))
    error = draws.std(axis=1, ddof=1)
    still = error <= 1e-12  # the same answers twice
    scale = np.where(still, 1.0, error)[:, None]
    size = np.abs(draws - difference[:, None]) / scale
    observed = np.where(still & (np.abs(difference) < 1e-12), 0.0, np.abs(difference) / scale[:, 0])
    observed = np.where(few[a] | few[b], np.nan, observed)
    alone, corrected = one_by_one(observed, size, extra=1), step_down(observed, size, extra=1)
    found = []
    for k, (i, j) in enumerate(index):
        winner = "" if not corrected[k] <= alpha else names[i] if difference[k] < 0 else names[j]
        ends = (math.nan, math.nan) if few[i] or few[j] else (float(limits[0, k]), float(limits[1, k]))
        ratio = math.exp(difference[k])
        found.append(Pair(names[i], names[j], scenes, ratio, *ends, float(alone[k]), float(corrected[k]), winner))
    return found
