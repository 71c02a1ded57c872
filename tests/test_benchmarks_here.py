"""Ranks on few scenes: by paired tiles, true to their level, open where a few tiles hold the error."""

from __future__ import annotations

import math

import numpy as np

from beambench.benchmarks.statistics.here import compare_here
from beambench.benchmarks.statistics.ranking import ScoreMatrix, compare_estimators
from beambench.benchmarks.statistics.tables import inference_tables

from ._api_fixtures import score_row

NAMES = ["a", "b", "c"]


def scene(rng: np.random.Generator, factors: list[float], common: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Squared errors in 64 tiles of 100 elements: a difficulty that all share, and noise of each estimator's own."""
    difficulty = np.exp(common * rng.normal(size=64))
    own = rng.chisquare(100, (len(factors), 64))
    return np.array(factors)[:, None] ** 2 * difficulty * own, np.full(64, 100.0)


def test_a_difference_of_ten_percent_on_one_scene_is_decided() -> None:
    found = compare_here(NAMES, [scene(np.random.default_rng(1), [1.0, 1.1, 1.3], common=0.3)])
    assert found is not None
    assert [pair.winner for pair in found.pairs] == ["a", "a", "b"]
    for pair, ratio in zip(found.pairs, (1 / 1.1, 1 / 1.3, 1.1 / 1.3), strict=True):
        # 64 tiles of 100 elements: ln of a ratio of root mean squares has 1/√(2·6400)·√2 = .0125; 4 of them.
        assert abs(math.log(pair.ratio / ratio)) < 0.05 and pair.low < pair.ratio < pair.high


def test_equal_estimators_are_seldom_called_different() -> None:
    """Of 200 problems without a difference at most 5 % have a winner, and 3 binomial deviations more."""
    rng = np.random.default_rng(5)
    wrong = 0
    for _ in range(200):
        found = compare_here(NAMES, [scene(rng, [1.0, 1.0, 1.0]), scene(rng, [1.0, 1.0, 1.0])])
        assert found is not None
        wrong += any(pair.winner for pair in found.pairs)
    assert wrong <= 10 + 3 * math.sqrt(10), wrong


def test_the_same_estimator_twice_is_equal() -> None:
    sums, counts = scene(np.random.default_rng(2), [1.0, 1.0])
    found = compare_here(["a", "b"], [(np.stack([sums[0], sums[0]]), counts)])
    assert found is not None and found.pairs[0].winner == "" and found.pairs[0].p == 1.0


def test_one_bad_tile_leaves_the_rank_open() -> None:
    sums, counts = scene(np.random.default_rng(3), [1.0, 2.0, 4.0], common=0.2)
    sums[2, 7] *= 1e4
    found = compare_here(NAMES, [(sums, counts)])
    assert found is not None
    assert [pair.winner for pair in found.pairs] == ["a", "", ""]
    assert math.isnan(found.low[2]) and not math.isnan(found.low[0])


def test_few_tiles_decide_nothing() -> None:
    sums, counts = scene(np.random.default_rng(4), [1.0, 9.0])
    assert compare_here(["a", "b"], [(sums[:, :10], counts[:10])]) is None


def test_scenes_are_used_where_there_are_enough() -> None:
    rng = np.random.default_rng(6)
    figures = np.exp(0.1 * rng.normal(size=(2, 8))) * np.array([[1.0], [3.0]])
    matrix = ScoreMatrix(["a", "b"], [str(k) for k in range(8)], figures, np.zeros((2, 8)), np.ones((2, 8)))
    tiles = [scene(rng, [3.0, 1.0]) for _ in range(8)]  # the other way round, to show that they are not used
    found = compare_estimators(matrix, tiles=tiles)
    assert found.basis == "scenes" and found.ranked[0].name == "a" and found.pairs[0].winner == "a"
    few = ScoreMatrix(["a", "b"], ["0"], figures[:, :1], np.zeros((2, 1)), np.ones((2, 1)))
    assert compare_estimators(few).basis == "" and compare_estimators(few).ranked[0].rank_high == 2


def test_tables_rank_by_the_tiles_of_the_run_and_say_so() -> None:
    rng = np.random.default_rng(7)
    sums, counts = scene(rng, [1.0, 1.2], common=0.2)
    rows = [
        score_row(
            estimator=name, stage="range", level=math.nan, level2=math.nan, stress2="none", rmse_full=rmse, bound=1e-9
        )
        for name, rmse in (("a", 1.0), ("b", 1.2))
    ]
    tiles = {("flat-wall", "matched", 0, name): (sums[k], counts) for k, name in enumerate(("a", "b"))}
    found = inference_tables(rows, tiles)
    ranks = {row["estimator"]: (row["rank_lo"], row["rank_hi"], row["basis"]) for row in found["ranking.csv"][1]}
    assert ranks == {"a": (1, 1, "tiles"), "b": (2, 2, "tiles")}
    assert found["pairs.csv"][1][0]["winner"] == "a"
    del tiles["flat-wall", "matched", 0, "b"]
    assert {row["basis"] for row in inference_tables(rows, tiles)["ranking.csv"][1]} == {""}


def test_captures_decide_what_scenes_leave_open() -> None:
    """Eight scenes that differ among themselves, 20 captures each: 10 % apart on all of them is sure here, and not elsewhere."""
    rng = np.random.default_rng(8)
    rows, taste = [], 0.4 * rng.normal(size=8)  # a scene prefers one or the other
    for k in range(8):
        hard = np.exp(rng.normal())
        for seed in range(20):
            for name, factor in (("a", 1.0), ("b", 1.1 * math.exp(taste[k] - taste.mean()))):
                error = hard * factor * math.exp(0.05 * rng.normal())
                rows.append(
                    score_row(
                        scene=f"s{k}", seed=seed, estimator=name, stage="range", level=math.nan, level2=math.nan,
                        stress2="none", rmse_full=error, rmse=error, bound=1e-9, n=100,
                    )
                )  # fmt: skip
    tables = inference_tables(rows)
    (pair,) = tables["pairs.csv"][1]
    assert pair["basis"] == "scenes" and pair["winner"] == "" and pair["p_adjusted"] > 0.05
    assert pair["here"] == "captures" and pair["winner_here"] == "a" and pair["p_here"] < 0.01
    ranks = {
        row["estimator"]: (row["rank_lo"], row["rank_hi"], row["here_lo"], row["here_hi"])
        for row in tables["ranking.csv"][1]
    }
    assert ranks == {"a": (1, 2, 1, 1), "b": (1, 2, 2, 2)}
    few = inference_tables([row for row in rows if row["scene"] < "s4"])["ranking.csv"][1]
    assert {(row["basis"], row["here"]) for row in few} == {("captures", "captures")}
    assert {row["here"] for row in inference_tables([row for row in rows if row["seed"] < 10])["ranking.csv"][1]} == {
        ""
    }


def test_equal_estimators_on_twenty_captures_are_seldom_called_different() -> None:
    """Ten scenes of 20 captures: 4 equal estimators, 200 times; at most 5 % wrong, and 3 binomial deviations."""
    rng = np.random.default_rng(9)
    wrong = 0
    for _ in range(200):
        scenes = []
        for _scene in range(10):
            hard = np.exp(0.3 * rng.normal(size=20))
            scenes.append((hard * rng.chisquare(30, (4, 20)), np.full(20, 100.0)))
        found = compare_here(list("abcd"), scenes)
        assert found is not None
        wrong += any(pair.winner for pair in found.pairs)
    assert wrong <= 10 + 3 * math.sqrt(10), wrong
