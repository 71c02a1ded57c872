"""Tests by flipped signs: exact, deaf to one wild scene, and decided on published tables that Holm's bootstrap left open."""

from __future__ import annotations

import math
from itertools import combinations, product

import numpy as np
import pytest
from scipy import stats

from beambench.benchmarks.statistics.bootstrap import studentised
from beambench.benchmarks.statistics.flips import flip_tests, typical_interval
from beambench.benchmarks.statistics.pairs import pairwise
from beambench.benchmarks.statistics.step_down import step_down


def test_p_is_that_of_all_flips_and_of_scipy() -> None:
    x = np.random.default_rng(1).normal(0.4, 1.0, (3, 9))
    alone, corrected = flip_tests(x)
    for k, row in enumerate(x):
        found = stats.permutation_test((row,), np.mean, permutation_type="samples", n_resamples=10_000)
        # |t| and |mean| order the flips alike: Σx² does not change.
        assert alone[k] == pytest.approx(found.pvalue, abs=1e-12)
    t = [abs(row.mean()) / row.std(ddof=1) for row in x]
    signs = np.array(list(product((1.0, -1.0), repeat=9)))
    flipped = np.abs((signs[:, None] * x).mean(2)) / (signs[:, None] * x).std(axis=2, ddof=1)
    best = int(np.argmax(t))
    assert corrected[best] == pytest.approx(np.mean(flipped.max(axis=1) >= t[best] * (1 - 1e-9)), abs=1e-12)
    assert np.all(corrected >= alone)


def test_a_typical_interval_is_what_its_test_does_not_reject() -> None:
    """Both limits lie where the test of a shifted centre turns at 5 %; by bisection over the shift."""
    x = np.random.default_rng(2).normal(1.0, 1.0, 10)
    low, high = typical_interval(x)
    for inside, outside in ((x.mean(), low - 2.0), (x.mean(), high + 2.0)):
        for _ in range(50):
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if flip_tests(x[None] - middle)[0][0] > 0.05 else (inside, middle)
        limit = low if inside < x.mean() else high
        # Of 1,023 means the 25th is the limit; of 512 flips 25 are 4.9 %: neighbours among the means.
        assert abs(inside - limit) < 0.05
    assert all(np.isnan(typical_interval(x[:5])))


def test_intervals_cover_whatever_the_tails() -> None:
    rng = np.random.default_rng(3)
    for values in (rng.normal(size=(4000, 10)), rng.standard_t(2, (4000, 10)), rng.uniform(-1, 1, (4000, 10))):
        low, high = typical_interval(values)
        # 4,000 intervals: 3 standard errors are 1 %.
        assert np.mean((low < 0) & (high > 0)) == pytest.approx(0.95, abs=0.011)


def test_one_wild_scene_widens_nothing() -> None:
    """Nine scenes say a factor of two; in the tenth all fail alike. The bootstrap over scenes had limits of 10^100 there."""
    figures = np.exp(np.random.default_rng(4).normal(size=10)) * np.array([[1.0], [2.0], [2.0]])
    figures[1:, :] *= np.exp(0.02 * np.random.default_rng(5).normal(size=(2, 10)))
    figures[:, 9] = 26.0
    rows = {(pair.a, pair.b): pair for pair in pairwise(["a", "b", "c"], figures)}
    assert rows["a", "b"].winner == rows["a", "c"].winner == "a" and rows["b", "c"].winner == ""
    assert 0.45 < rows["a", "b"].low < rows["a", "b"].high < 0.65
    wild = np.log(figures[0] / 1e-3)
    found = studentised(np.where(np.arange(10) < 9, 1.0 + 1e-6 * wild, 60.0))
    assert found.low > 0.99 and found.high <= 60.0


def test_equal_estimators_are_called_different_in_one_run_of_twenty() -> None:
    """Eight estimators, one of them ten times as scattered, tails of Student's t with three degrees of freedom."""
    rng = np.random.default_rng(6)
    index = list(combinations(range(8), 2))
    wrong, runs = 0, 300
    for _ in range(runs):
        logs = rng.standard_t(3, (8, 10)) * np.array([1.0, *[0.1] * 7])[:, None]
        wrong += bool((flip_tests(np.stack([logs[i] - logs[j] for i, j in index]))[1] <= 0.05).any())
    assert wrong <= 0.05 * runs + 3 * math.sqrt(0.05 * 0.95 * runs), wrong


def test_rounding_is_no_difference_and_missing_is_no_test() -> None:
    x = np.vstack([1e-16 * np.arange(-3, 5), np.full(8, 0.1), np.full(8, np.nan)])
    alone, corrected = flip_tests(x)
    assert alone[0] == 1.0 and alone[1] == 2.0**-7 and np.isnan(alone[2]) and np.isnan(corrected[2])
    assert flip_tests(np.empty((0, 8)))[1].size == 0
    many = np.random.default_rng(7).normal(3.0, 1.0, (2, 40))
    assert np.all(flip_tests(many)[1] <= 2 / 4096)


def test_step_down_by_hand() -> None:
    """Two tests, four draws: the larger against the largest of both, the smaller against its own, never below the first."""
    draws = np.array([[3.0, 1.0, 1.0, 0.0], [1.0, 4.0, 0.5, 0.2]])
    np.testing.assert_allclose(step_down(np.array([3.5, 0.4]), draws), [0.25, 0.75])
    np.testing.assert_allclose(step_down(np.array([0.9, 1.0]), draws), [0.75, 0.75])
    np.testing.assert_allclose(step_down(np.array([9.0, 9.0]), draws, extra=1), [0.2, 0.2])
