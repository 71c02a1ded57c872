"""Breakdown levels of estimators that fail at a known level: how often the measured interval contains that level.

    python -m beambench.benchmarks.checks.breakdown                 failures drawn from a known rate: seconds
    python -m beambench.benchmarks.checks.breakdown --captures 20   estimators that lose elements, on generated captures

Failure rates of the first: a jump, a rise (logistic in the logarithm of the level), and one that varies between captures
more than by chance (beta-binomial). The second sweeps `planted.fading` under ambient light, with levels drawn at random.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from ..search.failure_map import Point, refine_axis
from ..search.failure_rate import Trial
from .gated_planted import fading_rate, registered

__all__ = ["KINDS", "Held", "check_captures", "check_maps", "trials_at"]

Kind = Literal["step", "logistic", "uneven"]
KINDS: tuple[Kind, ...] = ("step", "logistic", "uneven")

_ELEMENTS, _SEEDS = 576, 4
_SPREAD = 60.0


@dataclass(frozen=True)
class Held:
    """Of `total` faulty estimators: how often the intervals of the 10 and the 50 % level contain the true level, how often
    the level lies within its own interval, and the median width of the intervals in decades."""

    total: int
    level10: int
    level50: int
    within: int
    width: float


def trials_at(
    rate: Callable[[float], float], rng: np.random.Generator, *, spread: float = math.inf
) -> Callable[[Sequence[Point]], Mapping[Point, Sequence[Trial]]]:
    """An estimator whose failure rate is a known function of the level; `spread`: of a beta distribution over captures."""

    def evaluate(points: Sequence[Point]) -> dict[Point, list[Trial]]:
        found: dict[Point, list[Trial]] = {}
        for point in points:
            p = rate(point[0])
            trials = []
            for seed in range(_SEEDS):
                mine = float(rng.beta(p * spread, (1 - p) * spread)) if math.isfinite(spread) and 0 < p < 1 else p
                trials.append(Trial("wall", seed, _ELEMENTS, outlier=int(rng.binomial(_ELEMENTS, mine))))
            found[point] = trials
        return found

    return evaluate


def check_maps(kind: Kind, count: int = 200, *, seed: int = 20260101) -> Held:
    """Refine the axis of `count` faulty estimators, with rising and falling levels in turn."""
    rng = np.random.default_rng(seed)
    held, within, widths = {0.1: 0, 0.5: 0}, 0, []
    for number in range(count):
        rising = number % 2 == 0
        levels = [1.0, 5.6, 31.6, 178.0, 1000.0] if rising else [1.0, 0.178, 0.0316, 0.0056, 0.001]
        sign = 1 if rising else -1
        level50 = 10 ** (sign * rng.uniform(0.7, 2.4))
        level10 = level50 if kind == "step" else level50 / 10 ** (sign * rng.uniform(0.05, 0.4))

        def rate(level: float, a: float = level10, b: float = level50, sign: int = sign) -> float:
            if a == b:
                return float(sign * (math.log(level) - math.log(a)) >= 0)
            return fading_rate(level, a, b)

        found = refine_axis(trials_at(rate, rng, spread=_SPREAD if kind == "uneven" else math.inf), levels)
        for edge, truth in zip(found.edges, (level10, level50), strict=True):
            low, high = min(edge.interval), max(edge.interval)
            held[edge.target] += low <= truth <= high
            within += low <= edge.level <= high
            widths.append(math.log10(high / low))
    return Held(count, held[0.1], held[0.5], within, float(np.median(widths)))


def check_captures(count: int, *, side: int = 12, seed: int = 20260101) -> Held:
    """Sweep `count` estimators with known breakdown levels over generated captures, as `beambench sweep` does."""
    from ..search.sweep import sweep_suite

    rng = np.random.default_rng(seed)
    planted = {}
    for _ in range(count):
        level50 = float(f"{10 ** rng.uniform(4.0, 6.0):.4g}")
        level10 = float(f"{level50 / 10 ** rng.uniform(0.1, 0.5):.4g}")
        planted[f"fading[level10={level10!r},level50={level50!r}]"] = (level10, level50)
    suite = {
        "suite": "breakdown-check",
        "scenes": [{"scene": "flat-wall", "overrides": {"rig.camera.rows": side, "rig.camera.cols": side}}],
        "estimators": list(planted),
        "stresses": [{"axis": "background", "values": [1e3, 1e4, 1e5, 1e6, 1e7]}],
        "seeds": {"test": list(range(1, 1 + _SEEDS))},
        # Only the answers are made to fail; failures caused by the scene itself must not add to them.
        "failure_at": 100.0,
    }
    with registered(), tempfile.TemporaryDirectory(prefix="beambench-breakdown-check-") as folder:
        rows = sweep_suite(suite, Path(folder) / "sweep", report=False).rows
    hits, within, widths = [0, 0], 0, []
    for row in rows:
        for k, (names, truth) in enumerate(
            zip((("level10", "lo", "hi"), ("level50", "lo50", "hi50")), planted[row["estimator"]], strict=True)
        ):
            level, low, high = (float(row[name]) for name in names)
            # An open end contains all levels beyond it.
            hits[k] += not (low > truth or high < truth)
            within += low <= level <= high
            widths.append(math.log10(high / low))
    return Held(len(rows), hits[0], hits[1], within, float(np.nanmedian(widths)))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print one line per kind; return 1 where intervals contain the true level in fewer than 95 %."""
    parser = argparse.ArgumentParser(prog="python -m beambench.benchmarks.checks.breakdown", description=__doc__)
    parser.add_argument("--captures", type=int, metavar="N", help="N faulty estimators on generated captures")
    parser.add_argument("--count", type=int, default=200, help="faulty estimators of each kind")
    chosen = parser.parse_args(arguments)
    print(f"{'failures':10} {'planted':>7} {'10 % held':>10} {'50 % held':>10} {'width, decades':>15}")
    bad = False
    results = (
        [("captures", check_captures(chosen.captures))]
        if chosen.captures is not None
        else ((kind, check_maps(kind, chosen.count)) for kind in KINDS)
    )
    for name, held in results:
        shares = [100 * part / held.total for part in (held.level10, held.level50)]
        print(f"{name:10} {held.total:7d} {shares[0]:9.1f}% {shares[1]:9.1f}% {held.width:15.3f}", flush=True)
        bad |= min(shares) < 95
    return int(bad)


if __name__ == "__main__":
    raise SystemExit(main())
