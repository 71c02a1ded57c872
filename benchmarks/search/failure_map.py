"""Failure maps: failure rates of an estimator along one axis, or over two, refined at the edge of breakdown.

Levels run from benign (first) to breaking (last). The breakdown level of a target rate q is where the failure rate,
rising, first passes q. No curve is fitted: a level is *below* the edge if its upper bound is under q, and *beyond* it if its
lower bound is over q. The edge lies between the last level that is certainly below and the first that is certainly beyond.
These two levels are the interval. It is halved until it is narrow, or until the rates inside it are too close to q for the
number of seeds, so that further levels would not narrow it.

Every level can err on one side only. Hence, with a budget of L levels and one-sided bounds at 0.05/L each, the interval
contains the edge with 95 % probability by Bonferroni's inequality, for any rate that rises through q once. The reported
level is where the isotonic regression of the rates (Barlow et al. 1972) passes q.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ...scenes.errors import InputError
from ..statistics.levels import is_log
from .failure_rate import Trial, dispersion, failure_rate, rate_bounds

__all__ = [
    "TARGETS", "Edge", "EdgeMap", "Evaluate", "check_levels", "find_edge", "isotonic", "refine_axis",
    "refine_grid",
]  # fmt: skip

#: Failure rates whose levels are reported.
TARGETS = (0.1, 0.5)

Point = tuple[float, ...]
#: Returns the trials at each of the given points (one level per axis).
Evaluate = Callable[[Sequence[Point]], Mapping[Point, Sequence[Trial]]]

_CONFIDENCE_ERROR = 0.05


@dataclass(frozen=True)
class Edge:
    """The level at which the failure rate passes `target`, and its interval from the benign side to the failing one.

    NaN: outside the levels. `start` is NaN if the edge may lie before the first level, `end` if it may lie after the last.
    """

    target: float
    level: float
    start: float
    end: float

    @property
    def interval(self) -> tuple[float, float]:
        """(lo, hi) in numerical order: on an axis whose levels fall, the failing side is the smaller number. An open side
        is NaN."""
        return self.start, self.end


@dataclass
class EdgeMap:
    """Measurements along one axis, or over two: the trials at every point, the edges along an axis, and the cells of a grid,
    each (first level, second, first level2, second), which cover the grid without overlap."""

    trials: dict[Point, list[Trial]] = field(default_factory=dict)
    edges: tuple[Edge, ...] = ()
    budget: int = 0
    cells: list[tuple[float, float, float, float]] = field(default_factory=list)

    def ordered(self, levels: Sequence[float]) -> list[float]:
        """The measured levels of the first axis, in the direction of `levels`."""
        return sorted({point[0] for point in self.trials}, reverse=len(levels) > 1 and levels[-1] < levels[0])


def isotonic(value: Sequence[float], weight: Sequence[float]) -> list[float]:
    """The non-decreasing sequence closest to `value` in weighted least squares: pool adjacent violators (Barlow et al. 1972)."""
    blocks: list[list[float]] = []  # mean, weight, length
    for v, w in zip(value, weight, strict=True):
        blocks.append([v, w, 1.0])
        while len(blocks) > 1 and blocks[-2][0] > blocks[-1][0]:
            mean, mass, length = blocks.pop()
            last = blocks[-1]
            last[0] = (last[0] * last[1] + mean * mass) / (last[1] + mass)
            last[1], last[2] = last[1] + mass, last[2] + length
    return [mean for mean, _, length in blocks for _ in range(int(length))]


def check_levels(levels: Sequence[float], axis: str) -> list[float]:
    """The levels as numbers.

    Raises:
        InputError: there are fewer than two, or they neither rise nor fall throughout.
    """
    rising = sorted(set(levels))
    if len(rising) < 2 or len(rising) != len(levels) or list(levels) not in (rising, rising[::-1]):
        raise InputError(
            "The levels of a failure map must rise or fall throughout, from benign to breaking.",
            where=axis,
            value=list(levels),
            allowed="at least two levels, rising or falling",
        )
    return list(map(float, levels))


def _middle(a: float, b: float, log: bool, whole: bool = False) -> float:
    """Half-way, in few digits: levels stand in tables and in the keys of random streams. `whole`: a whole number; NaN where
    there is none between."""
    exact = math.sqrt(a * b) if log else 0.5 * (a + b)
    if whole:
        low, high = math.floor(min(a, b)) + 1, math.ceil(max(a, b)) - 1
        return float(min(max(round(exact), low), high)) if low <= high else math.nan
    for digits in range(3, 17):
        rounded = float(f"{exact:.{digits}g}")
        if min(a, b) < rounded < max(a, b) and abs(rounded - exact) <= 0.05 * abs(b - a):
            return rounded
    return exact


class _Axis:
    """Levels of one axis as positions 0 … 1, from benign to breaking."""

    def __init__(self, levels: Sequence[float]) -> None:
        self.log = is_log(levels)
        self.first, self.last = levels[0], levels[-1]

    def position(self, level: float) -> float:
        if self.log:
            return math.log(level / self.first) / math.log(self.last / self.first)
        return (level - self.first) / (self.last - self.first)

    def level(self, position: float) -> float:
        if self.log:
            return float(self.first * (self.last / self.first) ** position)
        return self.first + position * (self.last - self.first)


def find_edge(levels: Sequence[float], trials: Mapping[Point, Sequence[Trial]], target: float, budget: int) -> Edge:
    """The edge from measured levels, ordered from benign to breaking.

    Main arguments:
        trials: at every (level,). target: failure rate, 0 … 1. budget: number of levels that share the
        probability of error of the interval.
    """
    start, _, end = _bracket(levels, trials, target, budget)
    axis = _Axis(levels)
    used = [level for level in levels if math.isnan(end) or axis.position(level) <= axis.position(end)]
    rate = [failure_rate(trials[level,]) for level in used]
    rising = isotonic(rate, [sum(t.n for t in trials[level,]) for level in used])
    level = math.nan
    for (a, p), (b, q) in pairwise(zip(used, rising, strict=True)):
        if p <= target < q:
            share = (target - p) / (q - p)
            # A jump across the whole step does not show its place in the step: the middle is the best guess.
            share = 0.5 if q - p > 0.75 else share
            level = axis.level(axis.position(a) + share * (axis.position(b) - axis.position(a)))
            break
    if not math.isnan(level):
        low = 0.0 if math.isnan(start) else axis.position(start)
        high = 1.0 if math.isnan(end) else axis.position(end)
        level = axis.level(min(max(axis.position(level), low), high))
    return Edge(target, level, start, end)


def _bracket(
    levels: Sequence[float], trials: Mapping[Point, Sequence[Trial]], target: float, budget: int
) -> tuple[float, list[float], float]:
    """(last level certainly below, undecided levels, first level certainly beyond); NaN if there is no such level."""
    spread = dispersion(trials[level,] for level in levels)
    alpha = _CONFIDENCE_ERROR / max(budget, len(levels))
    start, end = math.nan, math.nan
    between: list[float] = []
    for level in levels:
        low, high = rate_bounds(trials[level,], spread, alpha)
        if low > target:
            end = level
            break
        if high < target:
            start, between = level, []
        else:
            between.append(level)
    return start, between, end


def refine_axis(
    evaluate: Evaluate,
    levels: Sequence[float],
    *,
    targets: Sequence[float] = TARGETS,
    budget: int = 16,
    resolution: float = 0.01,
    axis: str = "axis",
    whole: bool = False,
) -> EdgeMap:
    """Measure failure rates along an axis and halve the levels around each edge.

    Main arguments:
        evaluate: returns the trials at given points, each (level,). levels: first levels, from benign to breaking.
    Other arguments:
        targets: failure rates whose levels are sought. budget: the most levels measured.
        resolution: share of the span (of its logarithm, where the levels span a factor of 8) below which an interval is
            not halved further. whole: levels are whole numbers, and neighbours are not halved.

    Raises:
        InputError: fewer than two levels, or levels that neither rise nor fall throughout.
    """
    first = check_levels(levels, axis)
    scale = _Axis(first)
    budget = max(budget, len(first))
    found = EdgeMap({point: list(got) for point, got in evaluate([(x,) for x in first]).items()}, budget=budget)
    while True:
        measured = found.ordered(first)
        requested: list[float] = []
        for target in targets:
            requested += _halves(_bracket(measured, found.trials, target, budget), scale, resolution, whole)
        new = [level for level in dict.fromkeys(requested) if (level,) not in found.trials]
        new = new[: budget - len(measured)]
        if not new:
            break
        found.trials |= {point: list(got) for point, got in evaluate([(x,) for x in new]).items()}
    measured = found.ordered(first)
    found.edges = tuple(find_edge(measured, found.trials, target, budget) for target in targets)
    return found


def _halves(bracket: tuple[float, list[float], float], scale: _Axis, resolution: float, whole: bool) -> list[float]:
    """The level that narrows a bracket most: the middle of the wider gap between a certain level and the next."""
    start, between, end = bracket
    chain = [level for level in (start, *between, end) if not math.isnan(level)]
    gaps = []
    for a, b in pairwise(chain):
        certain = a == start or b == end
        width = abs(scale.position(b) - scale.position(a))
        if certain and width > resolution:
            gaps.append((width, _middle(a, b, scale.log, whole)))
    gaps = [gap for gap in gaps if not math.isnan(gap[1])]
    return [max(gaps)[1]] if gaps else []


def refine_grid(
    evaluate: Evaluate,
    levels: Sequence[float],
    levels2: Sequence[float],
    *,
    targets: Sequence[float] = TARGETS,
    depth: int = 2,
    axis: str = "axis",
    axis2: str = "axis2",
    whole: tuple[bool, bool] = (False, False),
) -> EdgeMap:
    """Measure failure rates over two axes and halve, `depth` times, the cells whose corners lie on both sides of a
    target. A cell is a rectangle between measured points: far from the edge it stays coarse. `whole`: which axis takes whole
    numbers only; a cell that has none inside is not halved along it.

    Raises:
        InputError: fewer than two levels, or levels that neither rise nor fall throughout.
    """
    first, second = check_levels(levels, axis), check_levels(levels2, axis2)
    logs = is_log(first), is_log(second)
    found = EdgeMap()

    def measure(points: Sequence[Point]) -> None:
        new = [point for point in dict.fromkeys(points) if point not in found.trials]
        if new:
            found.trials.update({point: list(got) for point, got in evaluate(new).items()})

    sides = [list(pairwise(levels)) for levels in (first, second)]
    cells = [(a, b, c, d) for a, b in sides[0] for c, d in sides[1]]
    measure([(x, y) for x in first for y in second])
    for _ in range(depth):
        split = [cell for cell in cells if _crosses(cell, found, targets)]
        found.cells += [cell for cell in cells if cell not in split]
        cells, points = [], []
        for a, b, c, d in split:
            x, y = _middle(a, b, logs[0], whole[0]), _middle(c, d, logs[1], whole[1])
            along = [(a, b)] if math.isnan(x) else [(a, x), (x, b)]
            across = [(c, d)] if math.isnan(y) else [(c, y), (y, d)]
            cells += [(*side, *other) for side in along for other in across]
            points += [(p, q) for p in sorted({*sum(along, ())}) for q in sorted({*sum(across, ())})]
        measure(points)
    found.cells += cells
    found.budget = len(found.trials)
    return found


def _crosses(cell: tuple[float, float, float, float], found: EdgeMap, targets: Sequence[float]) -> bool:
    a, b, c, d = cell
    rates = np.array([failure_rate(found.trials[x, y]) for x in (a, b) for y in (c, d)])
    return any(rates.min() <= target < rates.max() for target in targets)
