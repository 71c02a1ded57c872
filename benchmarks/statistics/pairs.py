"""Every estimator against every other on the same captures: paired differences, corrected for the number of pairs.

Estimators of a run read the same captures with the same noise, so the difficulty of a scene cancels in a paired
comparison. Errors differ by decades between scenes, so ratios are compared: the value of a scene is ln(a/b). Scenes are the
sample; tests and intervals are those of `flips`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from .bootstrap import MIN_SCENES
from .flips import flip_tests, typical_interval

__all__ = ["Pair", "holm", "pairwise", "pairwise_p"]

Float = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Pair:
    """a against b: geometric mean over scenes of a/b, its 95 % interval, p, and p corrected for all pairs by step-down.

    `winner` is the estimator with the smaller figure where `p_adjusted` <= α, else "". NaN where scenes are too few.
    """

    a: str
    b: str
    scenes: int
    ratio: float
    low: float
    high: float
    p: float
    p_adjusted: float
    winner: str


def holm(p: npt.ArrayLike) -> Float:
    """p-values (…, test) corrected by Holm's method, which controls the family-wise error rate of each row.

    Sorted ascending, p̃_(i) = max_{j<=i} min(1, (m−j+1) p_(j)); NaN tests are ignored and stay NaN. Valid for any
    dependence between tests. Source: S. Holm, Scand. J. Statist. 6:65, 1979.
    """
    x = np.asarray(p, np.float64)
    order = np.argsort(x, axis=-1)  # NaN last
    ordered = np.take_along_axis(x, order, axis=-1)
    tests = np.sum(~np.isnan(x), axis=-1, keepdims=True)
    scaled = np.minimum(ordered * np.maximum(tests - np.arange(x.shape[-1]), 1), 1.0)
    corrected = np.maximum.accumulate(np.where(np.isnan(ordered), 0.0, scaled), axis=-1)
    out = np.empty_like(x)
    np.put_along_axis(out, order, np.where(np.isnan(ordered), np.nan, corrected), axis=-1)
    return out


def pairwise_p(logs: Float) -> tuple[Float, Float, npt.NDArray[np.intp]]:
    """Mean differences and corrected p of all pairs, for many benchmarks at once.

    Main arguments:
        logs (…, estimator, scene): logarithms of the values.
    Returns (difference (…, pair), p (…, pair), pairs (pair, 2)); p is NaN for fewer than `MIN_SCENES` scenes.
    """
    pairs = np.array(list(combinations(range(logs.shape[-2]), 2)), dtype=np.intp).reshape(-1, 2)
    x = logs[..., pairs[:, 0], :] - logs[..., pairs[:, 1], :]
    p = np.full(x.shape[:-1], np.nan)
    if x.shape[-1] >= MIN_SCENES:
        for place in np.ndindex(x.shape[:-2]):
            p[place] = flip_tests(x[place])[1]
    return x.mean(axis=-1), p, pairs


def pairwise(names: list[str], figures: npt.ArrayLike, *, alpha: float = 0.05) -> list[Pair]:
    """All pairs of estimators on the scenes of a benchmark; the smaller value is the better one.

    Main arguments:
        names (estimator). figures (estimator, scene): positive, e.g. `rmse_full`, pooled over seeds.
    Other arguments:
        alpha: family-wise error rate, the chance that any claimed difference does not exist.
    Raises ValueError for values that are not positive and finite.
    """
    x = np.asarray(figures, np.float64)
    if x.shape[:1] != (len(names),) or x.ndim != 2:
        raise ValueError(f"figures must be (estimator, scene) for {len(names)} estimators, not {x.shape}")
    if not np.all(np.isfinite(x) & (x > 0)):
        raise ValueError("figures must be positive and finite")
    logs = np.log(x)
    index = list(combinations(range(len(names)), 2))
    if not index:
        return []
    differences = np.stack([logs[i] - logs[j] for i, j in index])
    mean = differences.mean(axis=1)
    p, corrected, low, high = np.full((4, len(index)), np.nan)
    if x.shape[1] >= MIN_SCENES:
        p, corrected = flip_tests(differences)
        low, high = typical_interval(differences)
    rows = []
    for k, (i, j) in enumerate(index):
        winner = "" if not corrected[k] <= alpha else names[i] if mean[k] < 0 else names[j]
        rows.append(
            Pair(
                names[i], names[j], x.shape[1], float(np.exp(mean[k])), float(np.exp(low[k])), float(np.exp(high[k])),
                float(p[k]), float(corrected[k]), winner,
            )
        )  # fmt: skip
    return rows
