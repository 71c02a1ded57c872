"""Coverage and family-wise error of the statistics over scenes, on synthetic benchmarks whose truth is known.

    python -m beambench.benchmarks.checks.intervals

Each benchmark: five estimators (a best one, three equal ones, a worst one) on 12 to 24 scenes; ln rmse_full = truth +
difficulty of the scene (common to all, a factor e either way) + interaction of estimator and scene (a factor e^.2).
Columns: coverage of the 95 % intervals of each estimator's own mean and of paired differences, the share of benchmarks
with a wrong claim in the pairwise table, and the share in which the best estimator is significantly better than each other.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import numpy.typing as npt

from ..statistics.bootstrap import studentised
from ..statistics.flips import typical_interval
from ..statistics.pairs import pairwise_p

__all__ = ["TRUTH", "check", "synthetic"]

Kind = Literal["normal", "heavy", "skewed"]

#: ln of the true errors: a best estimator, three equal ones, a worst one.
TRUTH = np.array([-0.5, 0.0, 0.0, 0.0, 0.3])


def synthetic(kind: Kind, scenes: int, benchmarks: int, seed: int) -> npt.NDArray[np.float64]:
    """ln rmse_full (benchmark, estimator, scene). Effects of zero mean: normal (lognormal errors), Student's t with four
    degrees of freedom ("heavy"), or Gumbel ("skewed")."""
    rng = np.random.default_rng(seed)

    def draw(*shape: int) -> npt.NDArray[np.float64]:
        if kind == "normal":
            return rng.normal(size=shape)
        if kind == "heavy":
            return rng.standard_t(4, size=shape) / math.sqrt(2.0)
        return (rng.gumbel(size=shape) - np.euler_gamma) * math.sqrt(6.0) / math.pi

    difficulty = draw(benchmarks, 1, scenes)
    return np.asarray(TRUTH[:, None] + difficulty + 0.2 * draw(benchmarks, TRUTH.size, scenes))


def check(kind: Kind, scenes: int, *, benchmarks: int = 2000, seed: int = 7, draws: int = 999) -> dict[str, float]:
    """One line of the table: "alone", "paired" (coverage), "wrong" (family-wise error), "found" (power)."""
    logs = synthetic(kind, scenes, benchmarks, seed)
    alone = studentised(logs, draws=draws)
    low, high = typical_interval(np.delete(logs - logs[:, 1:2], 1, axis=1))
    rivals = np.delete(TRUTH, 1)
    difference, p, pairs = pairwise_p(logs)
    truth = TRUTH[pairs[:, 0]] - TRUTH[pairs[:, 1]]
    wrong = (p <= 0.05) & ((truth == 0) | (np.sign(difference) != np.sign(truth)))
    return {
        "alone": float(((alone.low <= TRUTH) & (alone.high >= TRUTH)).mean()),
        "paired": float(((low <= rivals) & (rivals <= high)).mean()),
        "wrong": float(wrong.any(axis=1).mean()),
        "found": float((p[:, pairs[:, 0] == 0] <= 0.05).mean()),
    }


def main() -> int:
    """Print the table."""
    print(f"{'effects':8} {'scenes':>6} {'alone':>7} {'paired':>7} {'wrong':>7} {'found':>7}")
    kinds: tuple[Kind, ...] = ("normal", "heavy", "skewed")
    for kind in kinds:
        for scenes in (12, 16, 24):
            row = check(kind, scenes, draws=4999)
            print(f"{kind:8} {scenes:6d} " + " ".join(f"{100 * value:6.2f}%" for value in row.values()), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
