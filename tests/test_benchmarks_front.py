"""Front, dominated or undecided: synthetic points get their true verdict, and rarely a wrong one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beambench.benchmarks.statistics.front import (
    classify,
    front,
    interval_order,
    lower_left,
    paired_order,
    ratio_interval,
)


def test_exact_points_are_the_pareto_front() -> None:
    cost, error = [1.0, 2.0, 3.0, 4.0], [9.0, 4.0, 5.0, 1.0]
    assert front(cost, cost, cost, error, error, error) == ["front", "front", "dominated", "front"]
    assert lower_left(cost, error) == [True, True, False, True]


def test_what_intervals_cannot_tell_stays_undecided() -> None:
    # b is certainly faster than c, and seems more accurate; until that is certain, c is not on the front.
    cost, low, high = [1.0, 2.0, 3.0], [0.9, 1.8, 2.7], [1.1, 2.2, 3.3]
    assert front(cost, low, high, [9, 4, 5], [8, 3, 3.9], [10, 5, 6]) == ["front", "front", "undecided"]
    assert front(cost, low, high, [9, 4, 7], [8, 3, 6], [10, 5, 8]) == ["front", "front", "dominated"]
    # b is certainly less accurate and perhaps as fast: a may dominate b, and nothing dominates a.
    assert front([1, 1.1], [0.8, 0.9], [1.2, 1.3], [1, 5], [0.9, 4], [1.1, 6]) == ["front", "undecided"]


def test_an_unknown_interval_decides_nothing() -> None:
    nan = math.nan
    assert front([1, 9], [nan, 9], [nan, 9], [1, 9], [1, 9], [1, 9]) == ["front", "undecided"]
    assert front([1, 9], [nan, 9], [nan, 9], [1, 9], [nan, 9], [nan, 9]) == ["undecided", "undecided"]
    assert front([3.0], [nan], [nan], [2.0], [nan], [nan]) == ["front"]
    assert front([], [], [], [], [], []) == []


def test_bad_intervals_are_refused() -> None:
    with pytest.raises(ValueError, match="outside"):
        front([1.0], [2.0], [3.0], [1.0], [1.0], [1.0])
    with pytest.raises(ValueError, match="same length"):
        front([1.0, 2.0], [1.0], [1.0], [1.0], [1.0], [1.0])


def _planted(rng: np.random.Generator, rms: np.ndarray, tiles: int, shared: float) -> np.ndarray:
    """Squared errors (point, tile) of estimators that read one noise: lognormal difficulty of tiles, shared, and own."""
    hard = rng.normal(0.0, shared, tiles)
    own = rng.normal(0.0, 0.3, (rms.size, tiles))
    return np.asarray(rms[:, None] ** 2 * np.exp(hard - shared**2 / 2 + own - 0.045))


def test_planted_fronts_are_told_and_seldom_mistaken() -> None:
    """Six estimators with exact costs: three on the front, one dominated by far, one by 10 %, one by nothing (a twin).

    Any verdict of "front" on a dominated point or "dominated" on a point of the front is wrong; 5 % of 400 benchmarks
    are allowed, and three standard errors of that.
    """
    rng = np.random.default_rng(20261122)
    cost = np.array([1.0, 3.0, 9.0, 4.0, 5.0, 10.0])
    rms = np.array([4.0, 2.0, 1.0, 6.0, 2.2, 1.0])
    truth = ["front", "front", "front", "dominated", "dominated", "twin"]
    wrong, told, unpaired = 0, np.zeros(6), np.zeros(6)
    costs = interval_order(0.98 * cost, 1.02 * cost)
    for _ in range(400):
        sums = _planted(rng, rms, 64, 1.0)
        found = classify(costs, paired_order(sums))
        bad = [v for v, t in zip(found, truth, strict=True) if t != "twin" and v not in (t, "undecided")]
        wrong += bool(bad) or found[5] != "undecided"
        told += [v == t for v, t in zip(found, truth, strict=True)]
        ends = [ratio_interval(row, np.ones(64)) for row in sums]
        alone = classify(costs, interval_order([a for a, _ in ends], [b for _, b in ends]))
        unpaired += [v == t for v, t in zip(alone, truth, strict=True)]
    assert wrong / 400 <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / 400), wrong
    assert (told[:4] / 400 > 0.9).all()
    # A tenth more error shows between pairs, and not between intervals of their own.
    assert told[4] > 0.4 * 400 > 5 * unpaired[4]


def test_equal_answers_are_equal_and_few_units_tell_nothing() -> None:
    sums = np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 3.0]])
    order = paired_order(sums)
    assert order.not_below.all() and not order.below.any()
    one = paired_order(sums[:, :1] * [[1.0], [2.0]])
    assert not one.below.any() and (one.not_below == np.eye(2, dtype=bool)).all()


def test_an_rmse_lies_in_its_interval_over_tiles() -> None:
    """Chi-squared tiles of 100 pixels: the 95 % interval covers within four standard errors of 1,000 draws."""
    rng = np.random.default_rng(3)
    hits = 0
    for _ in range(1000):
        counts = rng.integers(50, 150, 64)
        low, high = ratio_interval(rng.chisquare(counts), counts)
        hits += low <= 1.0 <= high
    assert abs(hits / 1000 - 0.95) < 4 * math.sqrt(0.95 * 0.05 / 1000)
    assert all(math.isnan(end) for end in ratio_interval([1.0], [3]))
