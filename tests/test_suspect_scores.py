"""Scores that cannot be honest (no error at all, or better than the bound by more than chance) leave the ranking."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.report.above_bound import above_bound
from beambench.benchmarks.report.data import cells_of
from beambench.benchmarks.report.text import closing_lines
from beambench.benchmarks.scores.tables import read_scores, write_tables
from beambench.benchmarks.scores.truth import Bound, Truth
from beambench.benchmarks.statistics.suspects import beyond, suspicion
from beambench.benchmarks.statistics.tables import inference_tables

from ._scores import range_rows

SHAPE = (16, 16)
TRUTH = Truth.plain(np.linspace(1.0, 3.0, 256).reshape(SHAPE))
BOUND = Bound(np.full(SHAPE, 0.01), "exact", scale=0.1, window=4.0)


def rows_of(
    name: str, value: Any, *, valid: Any = True, scene: str = "s", bound: Bound = BOUND
) -> list[dict[str, Any]]:
    key: dict[str, Any] = {
        "suite": "t", "scene": scene, "stress": "none", "level": math.nan, "stress2": "none", "level2": math.nan,
        "seed": 1, "condition": "matched", "estimator": name, "params": "",
    }  # fmt: skip
    answer = {
        "range": np.broadcast_to(np.asarray(value, float), SHAPE),
        "sigma": np.full(SHAPE, 0.01),
        "valid": np.broadcast_to(np.asarray(valid, bool), SHAPE),
    }
    return range_rows(key, TRUTH, bound, answer, status="ok", cpu_s=1e-3, wall_s=1e-3, peak_bytes=1e6)


def noisy(share: float, seed: int = 0) -> np.ndarray:
    """The truth with Gaussian errors of `share` times the bound."""
    return TRUTH.value + 0.01 * share * np.random.default_rng(seed).standard_normal(SHAPE)


def test_the_truth_and_what_is_near_it_are_not_ranked(tmp_path: Any) -> None:
    some = np.ones(SHAPE, bool)
    some[0, :8] = False  # 97 % coverage: no efficiency, the flag all the same
    rows = [
        *rows_of("honest", noisy(1.0)),
        *rows_of("knows", TRUTH.value),
        *rows_of("near", noisy(0.3)),
        *rows_of("near-refusing", noisy(0.3), valid=some),
        *rows_of("near-offset", noisy(0.3) + 0.004),
    ]
    ranking = inference_tables(rows)["ranking.csv"][1]
    assert [row["estimator"] for row in ranking] == ["honest"]
    write_tables(tmp_path, rows)
    table = read_scores(tmp_path)
    doubts = above_bound(cells_of(table))
    assert len(doubts) == 4 and all("is not ranked" in sentence for sentence in doubts)
    lines = closing_lines(table)
    assert lines[0].startswith("best     honest")
    assert sum(line.startswith("doubt    ") for line in lines) == 4


def test_an_efficient_estimator_is_never_suspect() -> None:
    """At the bound, over 2000 draws of 10 to 1000 elements, chance alone flags none (10⁻⁶ per row)."""
    rng = np.random.default_rng(3)
    for n in (10, 100, 1000):
        rmse = np.sqrt((rng.standard_normal((2000, n)) ** 2).mean(axis=1))
        assert not any(beyond(float(value), 1.0, n, "exact") for value in rmse)


@pytest.mark.parametrize(
    ("rmse", "bound", "n", "kind", "suspect"),
    [
        (0.0, 1.0, 4, "exact", True),
        (0.0, 0.0, 4, "exact", False),  # a scene without noise
        (0.0, math.nan, 4, "none", True),  # mixed elements
        (0.9, 1.0, 10_000, "exact", True),  # efficiency 1.23
        (0.95, 1.0, 10_000, "exact", False),
        (0.6, 1.0, 4, "exact", False),  # chance
        (0.6, 1.0, 10_000, "quasi", False),
        (0.4, 1.0, 10_000, "quasi", True),
        # Averages over the window: a truth in a part of it, or answers of the sure elements only, may err far less.
        (0.02, 5.6, 10_000, "bayes", False),
        (0.4, 1.0, 10_000, "ziv-zakai", False),
    ],
)
def test_limits_of_suspicion(rmse: float, bound: float, n: int, kind: str, suspect: bool) -> None:
    assert bool(suspicion(rmse, bound, n, kind)) is suspect
