"""The Pareto front of cost and error under uncertainty: each point is on the front, dominated, or undecided.

A point is *dominated* where another point is significantly better in both cost and error; it is on the *front* where every
other point is significantly no better in at least one of the two; otherwise it is *undecided*. A point that only seems
worse by chance is therefore never called dominated, and one that only seems best is never said to be on the front.

Where two points come from the same captures, their difference is known better than either value: `paired_order` compares
them on the units they share. Independent values are compared by their intervals, `interval_order`. Where a few units make
up most of a total (one outlier, one refusal), its spread cannot be estimated from these units: the pair is undecided and
the interval unknown. Neither method can account for an outlier so rare that the captures contain none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from .pooled import concentrated

__all__ = [
    "Order", "Verdict", "classify", "front", "interval_order", "lower_left", "paired_order", "ratio_interval",
]  # fmt: skip

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]
Verdict = Literal["front", "dominated", "undecided"]


@dataclass(frozen=True)
class Order:
    """What is significant about one quantity of every two points (i, j): i is smaller than j, or i is not smaller than j."""

    below: Bool
    not_below: Bool


def front(
    cost: Sequence[float], cost_lo: Sequence[float], cost_hi: Sequence[float], error: Sequence[float],
    error_lo: Sequence[float], error_hi: Sequence[float],
) -> list[Verdict]:  # fmt: skip
    """Verdict on each point from cost and error with their intervals; smaller is better in both.

    Main arguments:
        cost, error: values in any unit. `_lo`, `_hi`: their intervals; equal to the value where it is exact, NaN where
        the interval is unknown: then no comparison with it is significant.

    Raises ValueError for lists of different lengths and for a value outside its interval.
    """
    columns = [np.asarray(column, np.float64) for column in (cost, cost_lo, cost_hi, error, error_lo, error_hi)]
    if any(column.ndim != 1 or column.shape != columns[0].shape for column in columns):
        raise ValueError("All six lists must have the same length.")
    for value, low, high in (columns[:3], columns[3:]):
        if np.any((low > value) | (value > high)):
            raise ValueError("A value lies outside its interval.")
    return classify(interval_order(columns[1], columns[2]), interval_order(columns[4], columns[5]))


def classify(cost: Order, error: Order) -> list[Verdict]:
    """Verdicts from the orders of every two points in cost and in error: see the module."""
    beaten = np.asarray((cost.below & error.below).any(axis=0))
    held = cost.not_below | error.not_below
    np.fill_diagonal(held, True)
    safe = np.asarray(held.all(axis=0))
    return ["dominated" if b else "front" if s else "undecided" for b, s in zip(beaten, safe, strict=True)]


def interval_order(low: npt.ArrayLike, high: npt.ArrayLike) -> Order:
    """The order of independent values with intervals: significant where intervals do not overlap."""
    lo, hi = np.asarray(low, np.float64), np.asarray(high, np.float64)
    return Order(hi[:, None] < lo[None, :], lo[:, None] >= hi[None, :])


def paired_order(sums: npt.ArrayLike, *, error_rate: float = 0.05) -> Order:
    """The order of totals Σ_k x_ik of points i over units k that all of them share, by their paired log ratios.

    Main arguments:
        sums (point, unit): contributions, e.g. squared errors in each tile of a capture; >= 0.
    Other arguments:
        error_rate: chance that any comparison of a point is wrong (each is made at error_rate/(points − 1), two-sided).

    ln(Σa/Σb) has, by linearisation, the variance K/(K−1) Σ_k (a_k/Σa − b_k/Σb)², K units; Student's t with K − 1 degrees
    of freedom. A pair is undecided with fewer than two units, with a total that few units make up (`concentrated`), and
    with one zero and one positive total; if all units are equal, neither total is smaller.
    Source: W. G. Cochran, Sampling Techniques, 3rd ed., 1977, sec. 6.3 (ratios).
    """
    from scipy.special import stdtrit

    x = np.asarray(sums, np.float64)
    points, units = x.shape
    below, not_below = np.zeros((points, points), bool), np.zeros((points, points), bool)
    same = (x[:, None, :] == x[None, :, :]).all(axis=2)
    if units >= 2 and points >= 2:
        total = x.sum(axis=1)
        quantile = float(stdtrit(units - 1, 1.0 - 0.5 * error_rate / (points - 1)))
        with np.errstate(divide="ignore", invalid="ignore"):
            share = x / total[:, None]
            difference = np.log(total[:, None] / total[None, :])
            spread = ((share[:, None, :] - share[None, :, :]) ** 2).sum(axis=2) * units / (units - 1)
            half = quantile * np.sqrt(spread)
            few = concentrated(x)
            told = ~(few[:, None] | few[None, :])
            below, not_below = told & (difference + half < 0), told & (difference - half >= 0)
    return Order(below & ~same, not_below | same)


def ratio_interval(sums: npt.ArrayLike, counts: npt.ArrayLike) -> tuple[float, float]:
    """95 % interval of √(Σ sums/Σ counts) over units, e.g. of an rmse over tiles.

    (NaN, NaN) with fewer than two units, and where few of them make up most of the sum (`concentrated`).
    """
    from scipy.special import stdtrit

    x, n = np.asarray(sums, np.float64), np.asarray(counts, np.float64)
    x, n = x[n > 0], n[n > 0]
    total = float(x.sum())
    if x.size < 2 or bool(concentrated(x)):
        return math.nan, math.nan
    spread = float(((x / total - n / n.sum()) ** 2).sum()) * x.size / (x.size - 1)
    half = 0.5 * float(stdtrit(x.size - 1, 0.975)) * math.sqrt(spread)
    middle = math.sqrt(total / float(n.sum()))
    return middle * math.exp(-half), middle * math.exp(half)


def lower_left(cost: Sequence[float], error: Sequence[float]) -> list[bool]:
    """Points that no other beats in both values, intervals disregarded: the line that is drawn."""
    flags = [False] * len(cost)
    best = math.inf
    for i in sorted(range(len(cost)), key=lambda k: (cost[k], error[k])):
        flags[i] = error[i] < best
        best = min(best, error[i])
    return flags
