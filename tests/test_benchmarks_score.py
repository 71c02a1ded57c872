"""Scores against numbers computed by hand, and the properties of a table of scores."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.scores.score import COLUMNS, KEY, TIMES
from beambench.benchmarks.scores.summary import summarise, wilson_interval
from beambench.benchmarks.scores.tables import read_scores, sort_rows, to_csv, write_tables
from beambench.benchmarks.scores.truth import Bound, Truth, errors_of, failure_limit
from beambench.benchmarks.statistics.pooled import block_bootstrap_ratio, block_ids

from ._scores import range_rows

CONTRACT = (
    "suite,scene,stress,level,stress2,level2,seed,condition,stage,estimator,params,modality,quantity,unit,n,coverage,"
    "failure_rate,failure_at,bias,rmse,rmse_full,mae,p95,bound,bound_kind,efficiency,efficiency_lo,efficiency_hi,z_rms,"
    "cover95,cpu_s,wall_s,throughput,peak_bytes,status"
)


def key(**changes: Any) -> dict[str, Any]:
    values: dict[str, Any] = {
        "suite": "s", "scene": "a", "stress": "none", "level": math.nan, "stress2": "none", "level2": math.nan,
        "seed": 1, "condition": "matched", "stage": "range", "estimator": "e", "params": "",
    }  # fmt: skip
    return values | changes


def flat_truth(shape: tuple[int, int], value: float = 5.0) -> Truth:
    plane = np.full(shape, value)
    return Truth.plain(plane)


def estimate(error: np.ndarray, valid: np.ndarray, sigma: float = 1.0, value: float = 5.0) -> dict[str, np.ndarray]:
    return {"range": np.where(valid, value + error, np.nan), "sigma": np.full(error.shape, sigma), "valid": valid}


def test_columns_are_those_of_the_contract_in_order() -> None:
    assert ",".join(COLUMNS) == CONTRACT
    rows = range_rows(key(), flat_truth((2, 2)), Bound(np.ones((2, 2)), "exact", 1.0, 10.0), None, status="timeout: x")
    assert tuple(rows[0]) == COLUMNS
    assert to_csv(rows, COLUMNS).splitlines()[0] == CONTRACT


def test_by_hand() -> None:
    # Errors 1, -1, 3, 20 (m) and one refusal; bound .5 everywhere; prior window 12/√12; X = ½·10, limit of failure 5.
    error = np.array([[1.0, -1.0, 3.0, 20.0, 0.0]])
    valid = np.array([[True, True, True, True, False]])
    bound = Bound(np.full((1, 5), 0.5), "exact", 10.0, 12.0)
    (row,) = range_rows(
        key(),
        flat_truth((1, 5)),
        bound,
        estimate(error, valid, 2.0),
        status="ok",
        cpu_s=0.25,
        wall_s=0.5,
        peak_bytes=8.0,
    )
    assert row["n"] == 5
    assert row["coverage"] == 0.8
    assert row["failure_at"] == 5.0  # max(5·.5, 5) = 5: the 20 and the refusal fail
    assert row["failure_rate"] == 0.4
    assert row["bias"] == pytest.approx(23 / 4)
    assert row["rmse"] == pytest.approx(math.sqrt((1 + 1 + 9 + 400) / 4))
    assert row["rmse_full"] == pytest.approx(math.sqrt((411 + 12.0**2 / 12) / 5))
    assert row["mae"] == pytest.approx(25 / 4)
    assert row["p95"] == pytest.approx(np.quantile([1, 1, 3, 20], 0.95))
    assert row["bound"] == 0.5
    assert math.isnan(row["efficiency"])  # coverage below .99
    assert row["z_rms"] == pytest.approx(math.sqrt(411 / 4) / 2)
    assert row["cover95"] == 0.75
    assert row["throughput"] == 10.0
    assert (row["cpu_s"], row["wall_s"], row["peak_bytes"], row["status"]) == (0.25, 0.5, 8.0, "ok")


def test_efficiency_counts_outliers_and_is_withheld_from_the_biased() -> None:
    shape = (32, 32)
    rng = np.random.default_rng(1)
    bound = Bound(np.full(shape, 1e-3), "exact", 1.0, 10.0)
    error = rng.normal(0, 2e-3, shape)
    (row,) = range_rows(key(), flat_truth(shape), bound, estimate(error, np.ones(shape, bool)), status="ok")
    # Mean of 1024 squared normals: relative standard error √(2/1024) = 4.4 %; 4 of them.
    assert row["efficiency"] == pytest.approx(0.25, rel=0.18)
    assert row["efficiency_lo"] < row["efficiency"] < row["efficiency_hi"]
    assert row["efficiency"] == pytest.approx(1 / ((error / 1e-3) ** 2).mean())
    error[0, 0] = 1.0
    (wild,) = range_rows(key(), flat_truth(shape), bound, estimate(error, np.ones(shape, bool)), status="ok")
    assert wild["efficiency"] < 0.002
    (biased,) = range_rows(
        key(), flat_truth(shape), bound, estimate(error * 0 + 1e-3, np.ones(shape, bool)), status="ok"
    )
    assert math.isnan(biased["efficiency"])


def test_bound_and_rmse_are_taken_on_the_same_elements() -> None:
    bound = Bound(np.array([[1.0, 2.0, 9.0]]), "exact", 100.0, 100.0)
    valid = np.array([[True, True, False]])
    (row,) = range_rows(key(), flat_truth((1, 3)), bound, estimate(np.zeros((1, 3)), valid), status="ok")
    assert row["bound"] == pytest.approx(math.sqrt((1 + 4) / 2))
    assert row["rmse"] == 0


def test_refusing_all_hard_elements_does_not_win() -> None:
    shape = (64, 64)
    rng = np.random.default_rng(2)
    hard = rng.random(shape) < 0.3
    spread = np.where(hard, 0.2, 0.01)
    bound = Bound(spread, "exact", 0.1, 4.0)  # prior 4/√12 = 1.15 m
    error = rng.normal(size=shape) * spread
    everywhere, nowhere = np.ones(shape, bool), np.zeros(shape, bool)
    (honest,) = range_rows(key(), flat_truth(shape), bound, estimate(error, everywhere), status="ok")
    (refuser,) = range_rows(key(), flat_truth(shape), bound, estimate(error, ~hard), status="ok")
    (silent,) = range_rows(key(), flat_truth(shape), bound, estimate(error, nowhere), status="ok")
    assert refuser["rmse"] < honest["rmse"]  # what refusing would win if it were scored by this
    assert honest["rmse_full"] < refuser["rmse_full"] < silent["rmse_full"]
    assert honest["failure_rate"] < refuser["failure_rate"] < silent["failure_rate"]
    assert silent["rmse_full"] == pytest.approx(bound.prior)
    assert math.isnan(silent["rmse"])


def test_mixed_elements_are_scored_apart_by_their_distance_from_the_nearer_surface() -> None:
    truth = Truth(
        np.array([[5.0, 5.5, 5.5, 5.5, np.nan]]),
        np.array([[False, True, True, True, False]]),
        (np.array([[5.0, 5.0, 5.0, 5.0, np.nan]]), np.array([[5.0, 6.0, 6.0, 6.0, np.nan]])),
    )
    answer = np.array([[5.1, 5.6, 4.8, 6.0, 7.0]])
    error = errors_of(answer, truth)
    # Between two surfaces there is nothing: such an answer is off by the way to the nearer one, here the last.
    np.testing.assert_allclose(error, [[0.1, -0.4, -0.2, 0.0, np.nan]], atol=1e-12)
    bound = Bound(np.array([[0.1, np.nan, np.nan, np.nan, np.nan]]), "exact", 0.6, 4.0)
    est = {"range": answer, "sigma": np.ones((1, 5)), "valid": np.ones((1, 5), bool)}
    plain, mixed = range_rows(key(), truth, bound, est, status="ok")
    assert (plain["quantity"], plain["n"], mixed["quantity"], mixed["n"]) == ("range", 1, "range-mixed", 3)
    assert plain["rmse"] == pytest.approx(0.1)
    assert mixed["failure_rate"] == pytest.approx(1 / 3)  # X = .3: the .4 fails
    assert mixed["rmse"] == pytest.approx(math.sqrt((0.16 + 0.04) / 3))
    assert mixed["bound_kind"] == "none"
    assert math.isnan(mixed["bound"])


@pytest.mark.parametrize("status", ["crash:SIGSEGV", "timeout: call over 1 s", "invalid: x"])
def test_a_run_that_failed_covers_nothing(status: str) -> None:
    bound = Bound(np.ones((2, 2)), "exact", 1.0, 6.0)
    est = estimate(np.zeros((2, 2)), np.ones((2, 2), bool))
    (row,) = range_rows(key(), flat_truth((2, 2)), bound, est, status=status)
    assert (row["coverage"], row["failure_rate"], row["status"]) == (0.0, 1.0, status)
    assert row["rmse_full"] == pytest.approx(6 / math.sqrt(12))
    assert math.isnan(row["rmse"])


def test_a_bound_above_the_prior_is_held_at_it_and_no_longer_called_exact() -> None:
    bound = Bound(np.array([[0.1, np.inf]]), "exact", 1.0, 2.0)
    est = estimate(np.zeros((1, 2)), np.ones((1, 2), bool))
    (row,) = range_rows(key(), flat_truth((1, 2)), bound, est, status="ok")
    assert row["bound"] == pytest.approx(math.sqrt((0.01 + 4 / 12) / 2))
    assert row["bound_kind"] == "quasi"


def test_the_suite_may_set_where_failure_begins() -> None:
    bound = Bound(np.full((1, 2), 1e-3), "exact", 10.0, 20.0)
    est = estimate(np.array([[0.0, 0.2]]), np.ones((1, 2), bool))
    (row,) = range_rows(key(), flat_truth((1, 2)), bound, est, status="ok", failure_at=0.1)
    assert (row["failure_at"], row["failure_rate"]) == (0.1, 0.5)


def test_bootstrap_interval_covers_the_mean() -> None:
    # 200 trials of 95 %: binomial standard error 1.5 %, percentile intervals of 256 blocks lose about 1 %: 4 errors.
    blocks = block_ids((64, 64)).ravel()
    assert blocks.max() < 256
    inside = 0
    for trial in range(200):
        value = np.random.default_rng(trial).normal(size=64 * 64) ** 2
        low, high = block_bootstrap_ratio(value, blocks)
        inside += low <= 1.0 <= high
    assert inside / 200 > 0.95 - 0.06
    assert all(map(math.isnan, block_bootstrap_ratio(np.ones(10), np.zeros(10, np.intp))))


def test_block_ids_are_whole_tiles() -> None:
    for shape in ((256, 256), (5, 700), (1, 1), (33, 17)):
        ids = block_ids(shape)
        assert ids.shape == shape
        assert len(np.unique(ids)) <= 256
        assert ids[0, 0] == 0


def test_wilson_interval_at_the_edges() -> None:
    assert wilson_interval(0, 10)[0] == 0
    assert wilson_interval(0, 10)[1] == pytest.approx(0.2775, abs=1e-4)  # Wilson 1927 by hand: z²/(n + z²)
    low, high = wilson_interval(5, 10)
    assert (low + high) / 2 == pytest.approx(0.5)


def table() -> list[dict[str, Any]]:
    shape = (16, 16)
    bound = Bound(np.full(shape, 0.1), "exact", 1.0, 10.0)
    rows = []
    for seed in (2, 1):
        for name in ("b", "a"):
            for level in (3.0, math.nan):
                error = np.random.default_rng(seed).normal(0, 0.1, shape)
                est = estimate(error, np.ones(shape, bool), 0.1)
                stress = "none" if math.isnan(level) else "x"
                changed = key(seed=seed, estimator=name, level=level, stress=stress)
                rows += range_rows(changed, flat_truth(shape), bound, est, status="ok", cpu_s=seed / 3)
    return rows


def test_tables_are_sorted_typed_and_whole(tmp_path: Path) -> None:
    import pandas as pd

    write_tables(tmp_path, table())
    assert {p.name for p in tmp_path.iterdir()} == {
        "scores.csv", "scores.parquet", "accuracy.csv", "summary.csv", "ranking.csv", "pairs.csv", "profiles.csv",
    }  # fmt: skip
    again = read_scores(tmp_path / "scores.csv")
    assert list(again["estimator"]) == ["a", "b"] * 4
    assert list(zip(again["stress"], again["seed"], strict=True))[::2] == [("none", 1), ("none", 2), ("x", 1), ("x", 2)]
    assert list(again["level"])[::4] == ["", "3"] and again["level2"].eq("").all()
    parquet = pd.read_parquet(tmp_path / "scores.parquet")
    assert list(parquet.columns) == list(COLUMNS)
    assert parquet["seed"].dtype == np.int64
    assert parquet["rmse"].dtype == np.float64
    np.testing.assert_allclose(parquet["rmse"], again["rmse"], rtol=1e-8)
    accuracy = list(csv.DictReader(io.StringIO((tmp_path / "accuracy.csv").read_text())))
    assert not set(accuracy[0]) & set(TIMES)
    assert set(KEY) < set(accuracy[0])


def test_rows_in_any_order_give_the_same_bytes(tmp_path: Path) -> None:
    rows = table()
    for name, order in (("a", rows), ("b", rows[::-1])):
        (tmp_path / name).mkdir()
        write_tables(tmp_path / name, order)
    for name in ("scores.csv", "accuracy.csv", "summary.csv", "scores.parquet"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_summary_pools_squares_and_has_intervals() -> None:
    rows = [row for row in sort_rows(table()) if row["estimator"] == "a" and row["stress"] == "none"]
    (pooled,) = summarise(rows)
    assert pooled["seeds"] == 2
    assert pooled["n"] == 512
    assert pooled["rmse"] == pytest.approx(math.sqrt(np.mean([row["rmse"] ** 2 for row in rows])))
    assert pooled["rmse_full_lo"] <= pooled["rmse_full"] <= pooled["rmse_full_hi"]
    assert pooled["failure_rate_lo"] == 0
    assert pooled["failure_rate_hi"] > 0.8  # two seeds without a failure say little: each counts as one element


def test_the_limit_of_failure_follows_the_bound_within_the_echo_only() -> None:
    # σ_R as range is 1 m: X = .5 m, and nothing beyond 1 m is an answer about this echo.
    bound = Bound(np.array([0.01, 0.1, 0.15, 0.2, 3.0, np.inf, np.nan]), "bayes", 1.0, 20.0)
    np.testing.assert_allclose(failure_limit(bound.sigma, bound), [0.5, 0.5, 0.75, 1.0, 1.0, 1.0, 0.5])
    # With a `failure_at` below the bound the limit is still five bounds.
    np.testing.assert_allclose(failure_limit(bound.sigma, bound, 0.02)[:3], [0.05, 0.5, 0.75])
    np.testing.assert_allclose(failure_limit(bound.sigma, bound, 2.0), [2.0, 2.0, 2.0, 2.0, 4.0, 4.0, 2.0])


@pytest.mark.parametrize("window", [6.0, 20.0])
@pytest.mark.parametrize("kind", ["exact", "bayes"])
def test_an_estimator_that_guesses_fails_at_half_of_all_elements_or_more(window: float, kind: str) -> None:
    # Bounds without light: as large as the window, or limited to the prior's error.
    shape = (64, 64)
    rng = np.random.default_rng(3)
    sigma = np.full(shape, 50.0 if kind == "exact" else window / math.sqrt(12.0))
    error = rng.uniform(-window / 2, window / 2, shape)  # truth in the middle, where a guess does best
    bound = Bound(sigma, kind, 1.0, window)
    (row,) = range_rows(key(), flat_truth(shape), bound, estimate(error, np.ones(shape, bool)), status="ok")
    # 1 − 2/W within 4 standard errors of 4096 trials.
    assert row["failure_rate"] == pytest.approx(1.0 - 2.0 / window, abs=0.03)
    assert row["failure_rate"] > 0.5


def test_peak_and_parabola_break_down_in_the_dark() -> None:
    from beambench.benchmarks.judges.bound import bound_of, truth_of
    from beambench.benchmarks.written.gated import written_capture
    from beambench.captures.hide import hide_truth
    from beambench.estimators import run_estimator
    from beambench.scenes.load import load_scene

    scene = load_scene("flat-wall", {"rig.camera.rows": 24, "rig.camera.cols": 24})
    failed: dict[str, list[float]] = {}
    kinds = []
    for amplitude in (160.0, 16.0, 1.6, 0.16):
        data = written_capture(scene, amplitude, 0.1, seed=5)
        bound, truth, hidden = bound_of(data), truth_of(data), hide_truth(data)
        kinds.append(bound.kind)
        for name in ("peak", "parabola", "poisson-ml"):
            found = run_estimator(name, hidden)
            answer = {part: found[part].values for part in ("range", "sigma", "valid")}
            (row,) = range_rows(key(estimator=name), truth, bound, answer, status="ok")
            failed.setdefault(name, []).append(row["failure_rate"])
    assert kinds == ["exact", "exact", "bayes", "bayes"]
    for name in ("peak", "parabola"):
        assert failed[name][0] < 0.1
        assert failed[name][-1] > 0.5
    assert failed["poisson-ml"][0] == 0.0 and failed["poisson-ml"][-1] > 0.5


@pytest.mark.parametrize("photons", [1.0, 0.5, 0.25])
def test_refusing_pays_in_no_ranking_even_through_the_threshold(photons: float) -> None:
    # A share of answers is wrong by anything (the threshold), the rest is good: as long as answering tells more than the
    # prior, refusing what is hard costs rmse_full and failures.
    shape = (64, 64)
    rng = np.random.default_rng(4)
    hard = rng.random(shape) < 0.5
    wild = hard & (rng.random(shape) < 0.5 * (1.0 - photons))
    error = np.where(wild, rng.uniform(-6.0, 6.0, shape), rng.normal(0, 0.1, shape))
    bound = Bound(np.where(hard, 1.0, 0.1), "bayes", 1.0, 12.0)
    everywhere = np.ones(shape, bool)
    (honest,) = range_rows(key(), flat_truth(shape), bound, estimate(error, everywhere), status="ok")
    (refuser,) = range_rows(key(), flat_truth(shape), bound, estimate(error, ~hard), status="ok")
    assert honest["rmse_full"] < refuser["rmse_full"]
    assert honest["failure_rate"] < refuser["failure_rate"]


def test_kinds_of_bounds_are_kept_and_pooled_by_the_weakest() -> None:
    rows = []
    for seed, kind in ((1, "exact"), (2, "bayes"), (3, "exact")):
        bound = Bound(np.full((16, 16), 0.1), kind, 1.0, 10.0)
        est = estimate(np.random.default_rng(seed).normal(0, 0.1, (16, 16)), np.ones((16, 16), bool), 0.1)
        rows += range_rows(key(seed=seed), flat_truth((16, 16)), bound, est, status="ok")
    assert [row["bound_kind"] for row in rows] == ["exact", "bayes", "exact"]
    (pooled,) = summarise(rows)
    assert pooled["bound_kind"] == "bayes"
    assert pooled["regular"] == pytest.approx(2 / 3)
    (alone,) = summarise(rows[:1])
    assert (alone["bound_kind"], alone["regular"]) == ("exact", 1.0)
    # Held at the prior, a Bayesian bound is still one.
    wide = Bound(np.full((2, 2), 9.0), "bayes", 1.0, 10.0)
    est = estimate(np.zeros((2, 2)), np.ones((2, 2), bool))
    (row,) = range_rows(key(), flat_truth((2, 2)), wide, est, status="ok")
    assert row["bound_kind"] == "bayes"
    assert row["bound"] == pytest.approx(wide.prior)
