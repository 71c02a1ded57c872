"""Statistics over scenes on thousands of synthetic benchmarks with known truth; and estimators that must not win a ranking."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.checks.intervals import Kind, check, synthetic
from beambench.benchmarks.scores.tables import to_csv, write_tables
from beambench.benchmarks.scores.truth import Bound, Truth
from beambench.benchmarks.statistics.bootstrap import MIN_SCENES, studentised
from beambench.benchmarks.statistics.pairs import holm, pairwise, pairwise_p
from beambench.benchmarks.statistics.profiles import performance_profiles
from beambench.benchmarks.statistics.ranking import compare_estimators, score_matrix
from beambench.benchmarks.statistics.rates import clustered_interval, wilson_interval
from beambench.benchmarks.statistics.tables import inference_tables
from beambench.scenes.errors import InputError

from ._scores import range_rows

BENCHMARKS = 2000
CHANCE = 0.05 + 3.0 * math.sqrt(0.05 * 0.95 / BENCHMARKS)  # of a wrong claim, and three deviations
DRAWS = 999  # of the bootstrap, where 2,000 benchmarks are done at once


@pytest.mark.parametrize(("kind", "scenes"), [("normal", 12), ("heavy", 12), ("skewed", 16), ("normal", 24)])
def test_intervals_cover_and_the_pairwise_table_errs_rarely(kind: Kind, scenes: int) -> None:
    found = check(kind, scenes, benchmarks=BENCHMARKS, draws=DRAWS)
    # Required: 95 ± 1.5 %. 2,000 benchmarks: standard error .5 % each; the estimators of one share their scenes.
    assert found["alone"] == pytest.approx(0.95, abs=0.015)
    assert found["paired"] == pytest.approx(0.95, abs=0.015)
    assert found["wrong"] <= CHANCE
    # The known winner beats each rival, seen in nearly all benchmarks at e^.5 with interactions of e^.2.
    assert found["found"] > 0.9


GROUP: dict[str, Any] = {"modality": "gated", "stage": "range", "quantity": "range"}


def test_all_equal_estimators_are_separated_in_at_most_one_benchmark_of_twenty() -> None:
    rng = np.random.default_rng(11)
    logs = rng.normal(size=(BENCHMARKS, 1, 12)) + 0.3 * rng.normal(size=(BENCHMARKS, 6, 12))
    _, p, _ = pairwise_p(logs)
    assert 0.02 < (p <= 0.05).any(axis=1).mean() <= CHANCE  # exact, so not far below either


def test_pairing_finds_what_the_spread_between_scenes_hides() -> None:
    logs = synthetic("normal", 12, BENCHMARKS, 3)
    alone = studentised(logs, draws=DRAWS)
    unpaired = np.mean(alone.high[:, 0] < alone.low[:, 1])
    _, p, pairs = pairwise_p(logs)
    paired = np.mean(p[:, (pairs == (0, 1)).all(axis=1)] <= 0.05)
    assert unpaired < 0.2 < 0.9 < paired


def test_studentised_is_one_answer_for_a_row_and_for_a_table() -> None:
    values = np.random.default_rng(5).normal(size=(3, 4, 9))
    table = studentised(values)
    one = studentised(values[1, 2])
    assert table.mean.shape == (3, 4)
    for name in ("mean", "error", "low", "high", "p"):
        assert getattr(table, name)[1, 2] == pytest.approx(float(getattr(one, name)), rel=1e-12)
    shifted = studentised(values + 10.0)
    np.testing.assert_allclose(shifted.low, table.low + 10.0, rtol=1e-9)
    flipped = studentised(-values)
    # Ends of the mirrored problem are the mirrored ends, but for draws that are ranks from below and from above.
    np.testing.assert_allclose(flipped.low, -table.high, rtol=0.02, atol=0.02)


def test_few_scenes_missing_ones_and_no_spread() -> None:
    few = studentised(np.arange(MIN_SCENES - 1.0))
    assert few.mean == 2.0
    assert np.isnan([few.low, few.high, few.p]).all()
    assert np.isnan(studentised([1.0, 2.0, np.nan, 1.0, 3.0, 2.0, 2.0]).p)
    still = studentised(np.full((2, 8), [[0.0], [0.3]]))
    np.testing.assert_array_equal(still.low, still.mean)
    np.testing.assert_array_equal(still.high, still.mean)
    assert still.p[0] == 1.0
    assert still.p[1] == pytest.approx(1 / 5000)
    with pytest.raises(ValueError, match="level"):
        studentised([1.0, 2.0], level=1.0)


def test_holm_against_a_hand_computed_table() -> None:
    # Holm 1979: .01·4, then max(.04, .013·3), max(., .04·2), max(., .2).
    np.testing.assert_allclose(holm([0.04, 0.01, 0.2, 0.013]), [0.08, 0.04, 0.2, 0.04])
    np.testing.assert_allclose(holm([0.6, np.nan, 0.7]), [1.0, np.nan, 1.0])
    assert np.all(holm(np.full((2, 5), 0.01)) == 0.05)


def test_pairwise_names_the_winner_and_gives_ratios() -> None:
    rng = np.random.default_rng(2)
    scene = np.exp(rng.normal(size=14))
    figures = np.stack(
        [scene, 2.0 * scene * np.exp(0.05 * rng.normal(size=14)), scene * np.exp(0.3 * rng.normal(size=14))]
    )
    rows = {(pair.a, pair.b): pair for pair in pairwise(["a", "b", "c"], figures)}
    assert rows["a", "b"].winner == "a"
    assert rows["a", "b"].ratio == pytest.approx(0.5, rel=0.05)
    assert rows["a", "b"].low < 0.5 < rows["a", "b"].high
    assert rows["b", "c"].winner == "c"
    assert rows["a", "c"].winner == ""
    with pytest.raises(ValueError, match="positive"):
        pairwise(["a", "b"], [[1.0, 0.0], [1.0, 1.0]])
    assert pairwise(["a"], [[1.0, 2.0]]) == []


def test_profiles_are_the_shares_counted_by_hand() -> None:
    a, b, c = performance_profiles(["a", "b", "c"], [[1, 1, 4, 2], [2, 1, 1, 1], [8, 8, 8, math.inf]])
    assert (a.best, b.best, c.best) == (0.5, 0.75, 0.0)
    np.testing.assert_allclose(a.at([0.9, 1, 1.9, 2, 3.9, 4, 100]), [0, 0.5, 0.5, 0.75, 0.75, 1, 1])
    np.testing.assert_allclose(c.at([1, 7.9, 8, 1e9]), [0, 0, 0.75, 0.75])
    # Area over ln τ to ln 8: a has two at 0, one at ln 2, one at ln 4: (3+3+2+1)/(4·3).
    assert a.area == pytest.approx(9 / 12)
    assert b.area == pytest.approx(11 / 12)
    assert c.area == 0.0
    with pytest.raises(ValueError, match="finite"):
        performance_profiles(["a"], [[math.inf]])


def test_wilson_covers_and_keeps_its_width_at_the_ends() -> None:
    assert wilson_interval(0, 100)[0] == 0.0
    assert 0.03 < wilson_interval(0, 100)[1] < 0.04
    assert wilson_interval(8, 10) == pytest.approx((0.490, 0.943), abs=5e-4)  # Wilson 1927 by hand
    assert all(map(math.isnan, wilson_interval(0, 0)))


def test_rates_of_elements_that_fail_together_by_scene() -> None:
    rng = np.random.default_rng(4)
    hits = [0, 0]
    for _ in range(600):
        rate = rng.beta(2.0, 8.0, size=16)  # mean .2, scenes differ
        n = np.full(16, 1000)
        x = rng.binomial(n, rate)
        low, high = clustered_interval(x, n)[1:]
        hits[0] += low <= 0.2 <= high
        low, high = wilson_interval(float(x.sum()), 16_000)
        hits[1] += low <= 0.2 <= high
    # 600 trials: standard error .9 %. Taking pixels as independent is far off, which is why scenes are the units.
    assert hits[0] / 600 == pytest.approx(0.95, abs=0.03)
    assert hits[1] / 600 < 0.4
    rate, low, high = clustered_interval([0, 0, 0], [50, 50, 0])
    assert (rate, low) == (0.0, 0.0)
    assert high > 0.5  # two scenes without a failure say little
    assert all(map(math.isnan, clustered_interval([1], [4])[1:]))


def _rows(name: str, scene: int, error: np.ndarray, valid: np.ndarray, status: str = "ok") -> list[dict[str, Any]]:
    side = math.isqrt(error.size)
    plane = np.full((side, side), 5.0)
    truth = Truth.plain(plane)
    bound = Bound(np.full(plane.shape, 0.001), "exact", 0.15, 2.0)
    key = {
        "suite": "s", "scene": f"scene-{scene:02d}", "stress": "", "level": math.nan, "stress2": "", "level2": math.nan,
        "seed": 1, "condition": "matched", "stage": "range", "estimator": name, "params": "",
    }  # fmt: skip
    shape = plane.shape
    estimate = {
        "range": np.where(valid, 5.0 + error, np.nan).reshape(shape),
        "sigma": np.full(shape, 0.01),
        "valid": valid.reshape(shape),
    }
    return range_rows(key, truth, bound, estimate, status=status)


def _table(hard_sigma: float) -> list[dict[str, Any]]:
    """16 scenes; a quarter of the elements is hard. All read the same noise."""
    rng = np.random.default_rng(9)
    rows = []
    for scene in range(16):
        hard = rng.random(1024) < 0.25
        noise = rng.normal(size=1024) * np.where(hard, hard_sigma, 0.01 * math.exp(rng.normal(scale=0.5)))
        everything = np.ones(1024, bool)
        rows += _rows("honest", scene, noise, everything)
        rows += _rows("refuses-hard", scene, noise, ~hard)
        rows += _rows("refuses-hard-and-better", scene, 0.5 * noise, ~hard)
        rows += _rows("refuses-all", scene, noise, ~everything)
        rows += _rows("crashes", scene, noise, everything, status="crash:SIGSEGV")
    return rows


@pytest.mark.parametrize("hard_sigma", [0.05, 0.2, 0.5])
def test_refusing_hard_elements_wins_no_ranking(hard_sigma: float) -> None:
    # The prior's error is 2 m/√12 = .58 m: hard elements still hold some information.
    comparison = compare_estimators(score_matrix(_table(hard_sigma), **GROUP))
    order = [row.name for row in comparison.ranked]
    assert order[0] == "honest"
    assert set(order[3:]) == {"refuses-all", "crashes"}
    best = comparison.ranked[0]
    assert best.rank_low == 1
    assert best.rank_high == 1
    assert best.coverage == 1.0
    for row in comparison.ranked[1:]:
        assert row.rank_low > 1
    profiles = {profile.name: profile for profile in comparison.profiles}
    assert profiles["honest"].best == 1.0
    assert max(profile.area for name, profile in profiles.items() if name != "honest") < profiles["honest"].area
    assert all(pair.winner != "refuses-hard" for pair in comparison.pairs if "honest" in (pair.a, pair.b))
    # On what it answers it looks as good or better: rmse alone would have crowned it.
    rmse = {row["estimator"]: row["rmse"] for row in _table(hard_sigma)[:4]}
    assert rmse["refuses-hard-and-better"] < rmse["honest"]


def test_a_table_with_holes_or_doubles_is_refused() -> None:
    rows = _table(0.2)
    twice = [{**row, "seed": seed} for seed in (1, 2) for row in rows]
    with pytest.raises(InputError, match="lacks a cell"):
        score_matrix(twice[1:], **GROUP)
    with pytest.raises(InputError, match="twice"):
        score_matrix([*rows, rows[0]], **GROUP)
    with pytest.raises(InputError, match="no row to rank by"):
        score_matrix(rows, **GROUP, condition="calibrated")


def test_who_reads_a_part_of_the_scenes_only_is_not_ranked() -> None:
    """A suite may give an estimator some of its scenes: the others are ranked without it; nobody is where none reads all."""
    rows = _table(0.2)
    first, scenes = rows[0]["estimator"], sorted({row["scene"] for row in rows})
    partial = [row for row in rows if not (row["estimator"] == first and row["scene"] == scenes[0])]
    assert first not in score_matrix(partial, **GROUP).names
    assert len(score_matrix(partial, **GROUP).names) == len(score_matrix(rows, **GROUP).names) - 1
    assert first not in {row["estimator"] for row in inference_tables(partial)["ranking.csv"][1]}
    others = sorted({row["estimator"] for row in rows} - {first})
    each = {name: scenes[i % 2 :: 2] for i, name in enumerate([first, *others])}
    apart = [row for row in rows if row["scene"] in each[row["estimator"]]]
    assert inference_tables(apart)["ranking.csv"][1] == []


def test_seeds_are_pooled_as_squares_within_their_scene() -> None:
    rows = _table(0.2)
    again = [{**row, "seed": 2, "rmse_full": 3.0 * row["rmse_full"]} for row in rows]
    one, two = score_matrix(rows, **GROUP), score_matrix(rows + again, **GROUP)
    np.testing.assert_allclose(two.rmse_full, math.sqrt(5.0) * one.rmse_full, rtol=1e-12)
    assert one.scenes == two.scenes


def test_few_scenes_leave_every_rank_open() -> None:
    rows = [row for row in _table(0.2) if row["scene"] < "scene-03"]
    comparison = compare_estimators(score_matrix(rows, **GROUP))
    assert {(row.rank_low, row.rank_high) for row in comparison.ranked} == {(1, 5)}
    assert all(pair.winner == "" and math.isnan(pair.p_adjusted) for pair in comparison.pairs)


def test_tables_of_a_run_hold_ranks_pairs_and_profiles() -> None:
    rows = _table(0.2)
    tables = inference_tables([*rows, *({**row, "condition": "calibrated"} for row in rows)])
    columns, ranking = tables["ranking.csv"]
    assert len(ranking) == 10
    assert {row["condition"] for row in ranking} == {"matched", "calibrated"}
    assert next(row["estimator"] for row in ranking if row["condition"] == "matched") == "honest"
    text = to_csv(ranking, columns)
    assert text.count("\n") == 11
    again = inference_tables([*({**row, "condition": "calibrated"} for row in rows), *rows[::-1]])
    assert text == to_csv(again["ranking.csv"][1], columns), "the order of rows must not matter"
    columns, pairs = tables["pairs.csv"]
    assert len(pairs) == 20
    assert all(set(row) == set(columns) for row in pairs)
    columns, profiles = tables["profiles.csv"]
    assert all(0 <= row["share"] <= 1 <= row["factor"] for row in profiles)
    stressed = [{**row, "stress": "x", "level": 2.0} for row in rows]
    assert inference_tables(stressed)["ranking.csv"][1] == []


def test_two_tables_are_compared_over_scenes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import json

    import beambench
    from beambench import cli

    rows = [row for row in _table(0.2) if row["estimator"] in ("honest", "refuses-hard")]
    rng = np.random.default_rng(1)
    for name, factor in (("a", 1.0), ("b", 1.3)):
        (tmp_path / name).mkdir()
        changed = [
            {
                **row,
                "rmse_full": row["rmse_full"]
                * (factor if row["estimator"] == "honest" else 1.0)
                * rng.uniform(0.98, 1.02),
            }
            for row in rows
        ]
        write_tables(tmp_path / name, changed)
    overall = {row["estimator"]: row for row in beambench.compare(tmp_path / "a", tmp_path / "b").attrs["over_scenes"]}
    honest, other = overall["honest"], overall["refuses-hard"]
    assert honest["scenes"] == 16
    assert honest["error_lo"] < 1.3 < honest["error_hi"]
    assert honest["p_holm"] < 0.01
    assert other["error_lo"] < 1.0 < other["error_hi"]
    assert cli.main(["compare", str(tmp_path / "a"), str(tmp_path / "b")]) == 0
    shown = capsys.readouterr().out
    assert "error B/A over scenes" in shown and f"{honest['error_ratio']:.3f} [{honest['error_lo']:.3f}" in shown
    assert "Times are not compared" not in shown
    # Times of two kinds of machine would compare the machines: they are left out, with a message.
    for name, device in (("a", "cpu"), ("b", "cuda")):
        record = {"machine": {"device_class": device, "processor": "same", "threads_per_estimator": 1}}
        (tmp_path / name / "run.json").write_text(json.dumps(record))
    table = beambench.compare(tmp_path / "a", tmp_path / "b" / "scores.csv")
    assert table["cpu_ratio"].isna().all() and table.attrs["machines_differ"] == ["device_class cpu and cuda"]
    assert cli.main(["compare", str(tmp_path / "a"), str(tmp_path / "b")]) == 0
    assert "Times are not compared: the runs differ in device_class cpu and cuda." in capsys.readouterr().out


def test_tables_of_two_contracts_are_not_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import json

    from beambench import cli
    from beambench.benchmarks.folders.record import TABLES_VERSION

    for name, record in (("old", {"suite": "s"}), ("new", {"suite": "s", "tables_version": TABLES_VERSION})):
        (tmp_path / name).mkdir()
        write_tables(tmp_path / name, _table(0.2))
        (tmp_path / name / "run.json").write_text(json.dumps(record))
    assert cli.main(["compare", str(tmp_path / "old"), str(tmp_path / "new")]) == 2
    assert f"tables_version 1, tables_version {TABLES_VERSION}" in capsys.readouterr().err
