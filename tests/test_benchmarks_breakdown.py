"""Failure maps and breakdown: planted failures are recovered within their intervals; modes, tables and one real sweep."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from beambench.benchmarks.checks.breakdown import KINDS, Kind, check_captures, check_maps, trials_at
from beambench.benchmarks.report.breakdown import breakdown_table, page_section, read_breakdown
from beambench.benchmarks.runner.session import Job, Outcome
from beambench.benchmarks.scores.truth import Bound, Truth
from beambench.benchmarks.search.bench import Answer, trials_of
from beambench.benchmarks.search.breakdown import BREAKDOWN_COLUMNS, breakdown_row, change_in_bounds, map_rows
from beambench.benchmarks.search.failure_map import EdgeMap, Point, is_log, isotonic, refine_axis, refine_grid
from beambench.benchmarks.search.failure_rate import Dispersion, Trial, dispersion, failure_rate, mode_of, rate_bounds
from beambench.scenes.errors import InputError

N = 576


@pytest.mark.parametrize("kind", KINDS)
def test_planted_breakdown_points_are_recovered(kind: Kind) -> None:
    """≥ 95 % of 200, for a rate that jumps, one that rises, and one whose captures differ more than binomially.

    The intervals are Bonferroni's, so they hold more often than 95 %; 200 draws of an event of probability .95 are 190
    or more with probability .58 only, which is why the method must be on the safe side.
    """
    held = check_maps(kind)
    assert min(held.level10, held.level50) >= 190, held
    assert held.within == 2 * held.total
    # Of three decades: the interval is about a hundredth where nothing is random, a tenth where captures differ.
    assert held.width < {"step": 0.04, "logistic": 0.12, "uneven": 0.3}[kind]


def test_planted_estimators_are_recovered_on_captures() -> None:
    """Two estimators that lose elements at a known rate, swept as a user sweeps: all four levels lie in their intervals,
    each of which holds in 95 % or more."""
    held = check_captures(2, side=6)
    assert (held.total, held.level10, held.level50, held.within) == (2, 2, 2, 4)


def test_an_axis_that_never_breaks_or_always_does() -> None:
    rng = np.random.default_rng(1)
    never = refine_axis(trials_at(lambda level: 0.001, rng), [1.0, 10.0, 100.0])
    assert math.isnan(never.edges[0].level) and never.edges[0].start == 100.0 and math.isnan(never.edges[0].end)
    always = refine_axis(trials_at(lambda level: 0.9, rng), [1.0, 10.0, 100.0])
    assert math.isnan(always.edges[0].level) and math.isnan(always.edges[0].start) and always.edges[0].end == 1.0


def test_the_first_edge_counts_where_failure_comes_and_goes() -> None:
    """Beyond a dip of the rate lies no second chance: nothing is averaged over the edge."""
    rng = np.random.default_rng(2)
    found = refine_axis(trials_at(lambda x: 0.9 if 2.0 < x < 4.0 else 0.0, rng), [0.0, 1.0, 3.0, 5.0, 6.0])
    for edge in found.edges:
        assert edge.start <= 2.0 <= edge.end and edge.end - edge.start < 0.1


def test_whole_captures_that_fail_at_random_leave_a_wide_interval() -> None:
    """Four captures cannot tell a rate of 10 %: the interval stays open or wide, though 2,304 elements were seen."""
    rng = np.random.default_rng(3)

    def evaluate(points: Sequence[Point]) -> dict[Point, list[Trial]]:
        return {p: [Trial("a", s, N, crash=N * int(rng.random() < p[0])) for s in range(4)] for p in points}

    edge = refine_axis(evaluate, [0.0, 0.25, 0.5, 0.75, 1.0]).edges[1]
    assert math.isnan(edge.start) or math.isnan(edge.end) or edge.end - edge.start > 0.3


def test_the_rate_bounds_cover() -> None:
    """Lower and upper bound at 2.5 % each: 2,000 draws miss on a side at most 4 standard errors over that."""
    rng = np.random.default_rng(4)
    for p in (0.02, 0.1, 0.5):
        missed = [0, 0]
        for _ in range(2000):
            trials = [Trial("a", seed, 200, outlier=int(rng.binomial(200, p))) for seed in range(3)]
            low, high = rate_bounds(trials, Dispersion(1.0, math.inf), 0.025)
            missed[0] += low > p
            missed[1] += high < p
        assert max(missed) / 2000 < 0.025 + 4 * math.sqrt(0.025 * 0.975 / 2000), (p, missed)


def test_overdispersion() -> None:
    rng = np.random.default_rng(5)
    one_by_one = [[Trial("a", s, N, outlier=int(rng.binomial(N, 0.3))) for s in range(8)] for _ in range(20)]
    whole = [[Trial("a", s, N, crash=N * int(rng.random() < 0.5)) for s in range(8)] for _ in range(20)]
    # χ²/df with 140 degrees of freedom: 1 ± 0.12; the prior's six pull that of the whole captures by 4 %.
    assert dispersion(one_by_one).phi < 1.5
    assert 0.7 * N < dispersion(whole).phi < 1.4 * N
    assert dispersion([[Trial("a", 0, N)]]) == dispersion([])


def test_isotonic_regression() -> None:
    assert isotonic([0.0, 0.2, 0.1, 0.5], [1, 1, 1, 1]) == pytest.approx([0.0, 0.15, 0.15, 0.5])
    assert isotonic([3.0, 2.0, 1.0], [1, 1, 2]) == pytest.approx([1.75] * 3)
    assert is_log([1.0, 10.0]) and not is_log([0.0, 10.0]) and not is_log([1.0, 2.0])


def test_a_grid_is_refined_at_its_edge_only() -> None:
    def evaluate(points: Sequence[Point]) -> dict[Point, list[Trial]]:
        return {p: [Trial("a", 0, 100, outlier=100 * int(p[0] + p[1] > 1.0))] for p in points}

    levels = [0.0, 0.5, 1.0, 1.5, 2.0]
    coarse = refine_grid(evaluate, levels, levels, depth=0)
    fine = refine_grid(evaluate, levels, levels, depth=3)
    assert len(coarse.trials) == 25
    # Halving everything three times would take 33² points; the diagonal edge crosses few cells.
    assert 25 < len(fine.trials) < 33 * 33 / 4
    area = sum((b - a) * (d - c) for a, b, c, d in fine.cells)
    assert area == pytest.approx(4.0)
    rates = {p: failure_rate(t) for p, t in fine.trials.items()}
    mixed = [c for c in fine.cells if len({rates[x, y] for x in c[:2] for y in c[2:]}) > 1]
    assert mixed and all(b - a == pytest.approx(0.0625, rel=0.25) for a, b, _, _ in mixed)


@pytest.mark.parametrize("levels", [[1.0], [1.0, 3.0, 2.0], [1.0, 1.0]])
def test_levels_run_one_way(levels: list[float]) -> None:
    with pytest.raises(InputError, match="must rise or fall throughout"):
        refine_axis(lambda points: {}, levels)


def _answer(error: list[float], valid: list[bool] | None = None, status: str = "ok") -> Answer:
    values = np.array(error)
    mask = np.ones(values.size, bool) if valid is None else np.array(valid)
    return Answer(status, [], np.where(mask, values, np.nan), mask, np.ones(values.size))


def test_modes_of_failure() -> None:
    # Elements 0 and 4 are displaced in both seeds, 1 is far off in one, 2 gives no answer, 3 is right; the third capture
    # crashed.
    answers = [
        _answer([3.0, 5.0, 0.0, 0.1, -2.0], [True, True, False, True, True]),
        _answer([2.7, 0.2, 0.0, 0.1, -2.2], [True, True, False, True, True]),
        _answer([0.0] * 5, [False] * 5, "crash:SIGSEGV"),
    ]
    trials = trials_of("wall", [1, 2, 3], answers)
    assert trials == [
        Trial("wall", 1, 5, bias=2, outlier=1, refusal=1),
        Trial("wall", 2, 5, bias=2, refusal=1),
        Trial("wall", 3, 5, crash=5),
    ]
    assert mode_of(trials) == "crash" and mode_of(trials[:2]) == "bias" and mode_of([]) == "none"
    # An element that hovers at its limit, displaced in every seed, is biased though it fails in one seed only.
    assert trials_of("a", [1, 2, 3], [_answer([1.1]), _answer([0.9]), _answer([0.9])])[0] == Trial("a", 1, 1, bias=1)
    assert trials_of("a", [1, 2, 3], [_answer([1.1]), _answer([-0.9]), _answer([0.9])])[0] == Trial(
        "a", 1, 1, outlier=1
    )
    # With one seed a displaced capture is biased, a scattered one holds outliers.
    assert trials_of("a", [1], [_answer([2.0, 2.1, 1.9])]) == [Trial("a", 1, 3, bias=3)]
    assert trials_of("a", [1], [_answer([0.0, 0.1, 9.0])]) == [Trial("a", 1, 3, outlier=1)]


def test_a_refusing_estimator_has_mode_refusal() -> None:
    def evaluate(points: Sequence[Point]) -> dict[Point, list[Trial]]:
        return {p: [Trial("a", s, 100, refusal=100 if p[0] < 0.1 else 0) for s in (1, 2)] for p in points}

    levels = [1.0, 0.1, 0.01]
    found = refine_axis(evaluate, levels)
    key = {
        "modality": "gated",
        "suite": "s",
        "estimator": "shy",
        "axis": "photons",
        "unit": "1",
        "condition": "matched",
    }
    row = breakdown_row(key, levels, found, float32_vs_64=0.0, gain_1dn=math.nan)
    assert tuple(row) == BREAKDOWN_COLUMNS and row["mode"] == "refusal"
    # The level itself is the last good one: 200 elements in two seeds are certain on either side of it.
    assert row["lo"] < 0.1 <= row["hi"] and row["lo50"] < 0.1 <= row["hi50"]
    assert row["hi"] / row["lo"] < 1.1
    assert breakdown_table([row])[0][6:] == ["refusal", "0", "–"]
    grid = map_rows({**key, "axis2": "none", "unit2": ""}, found)
    assert sum(r["refusal"] for r in grid) == 200 * sum(r["level"] < 0.1 for r in grid)


def test_an_unbroken_estimator_has_mode_none() -> None:
    found = EdgeMap({(x,): [Trial("a", 1, 1000)] for x in (1.0, 10.0)})
    done = refine_axis(lambda points: {p: found.trials[p] for p in points}, [1.0, 10.0])
    row = breakdown_row(
        {"modality": "gated", "suite": "s", "estimator": "e", "axis": "a", "unit": "1", "condition": "matched"}, [1.0, 10.0], done,
        float32_vs_64=0.0, gain_1dn=0.0,
    )  # fmt: skip
    assert row["mode"] == "none" and row["lo"] == 10.0 and math.isnan(row["level10"])
    assert breakdown_table([row])[0][4] == "over 10"


def test_change_is_in_units_of_the_bound() -> None:
    truth = {"range": Truth.plain(np.full((2, 2), 5.0))}
    bound = {"range": Bound(np.full((2, 2), 1e-3), "exact", 0.1, 1.0)}
    job = Job(0, Path(), "matched", "gated", {"row": 2, "col": 2})

    def outcome(offset: float, valid: bool = True, status: str = "ok") -> Outcome:
        mask = np.ones((2, 2), bool)
        mask[0, 0] = valid
        return Outcome(job, status, {"range": np.full((2, 2), 5.0 + offset), "valid": mask, "sigma": np.ones((2, 2))})

    assert change_in_bounds(outcome(0), outcome(0), truth, bound) == 0.0
    assert change_in_bounds(outcome(0), outcome(2e-3), truth, bound) == pytest.approx(2.0)
    # One of four elements that is lost counts with the prior's error, 1/√12 m.
    lost = change_in_bounds(outcome(0), outcome(0, valid=False), truth, bound)
    assert lost == pytest.approx(math.sqrt(1 / 12 / 4) / 1e-3)
    assert math.isnan(change_in_bounds(outcome(0), outcome(0, status="crash: x"), truth, bound))


def test_a_sweep_end_to_end(tmp_path: Path) -> None:
    """Two estimators on small captures: tables, pictures and page; levels are those of `run`, so captures agree."""
    from beambench import sweep

    small = {"scene": "flat-wall", "overrides": {"rig.camera.rows": 12, "rig.camera.cols": 12}}
    suite = {
        "suite": "mine",
        "scenes": [small],
        "estimators": ["weighted-average[background=outside]", "poisson-ml"],
        "stresses": [
            {"axis": "photons", "values": [1.0, 0.1, 0.01]},
            {"axis": "photons", "values": [1.0, 0.01], "axis2": "background", "values2": [1e6, 1e10]},
        ],
        "seeds": {"test": [1, 2]},
    }
    result = sweep(suite, out=tmp_path / "out", budget=6, depth=1)
    rows = read_breakdown(result.out)
    assert [row["estimator"] for row in rows] == ["weighted-average[background=outside]", "poisson-ml"]
    for row in rows:
        # The full signal is ample and a hundredth of it is below one photoelectron a slice.
        assert 0.01 <= row["lo"] <= row["level10"] <= row["hi"] <= 1.0 and row["mode"] in ("refusal", "outlier")
        assert row["float32_vs_64"] < 1e-3
    with open(result.out / "failure_map.csv", newline="", encoding="utf-8") as file:
        grid = list(csv.DictReader(file))
    assert {row["axis2"] for row in grid} == {"none", "background"}
    assert len({(r["level"], r["level2"]) for r in grid if r["axis2"] != "none"}) > 4
    assert {path.name for path in (result.out / "maps").iterdir()} == {
        "photons.svg", "photons.png", "photons--background.svg", "photons--background.png",
    }  # fmt: skip
    assert json.loads((result.out / "run.json").read_text())["suite"] == "mine"
    page = (result.out / "report.html").read_text(encoding="utf-8")
    assert 'id="breakdown"' in page and page_section(result.out) is not None
    assert {row["condition"] for row in [*rows, *grid]} == {"matched"}
    with pytest.raises(InputError, match="not empty"):
        sweep(suite, out=tmp_path / "out")
    with pytest.raises(InputError, match="no stress"):
        sweep({**suite, "stresses": []}, out=tmp_path / "other")


def test_a_broken_sweep_is_resumed_and_each_condition_is_swept(tmp_path: Path) -> None:
    """Half of the journal is enough: what it holds is not measured again, and the tables are the same bytes."""
    from beambench import sweep
    from beambench.benchmarks.search.bench import Bench

    small = {"scene": "flat-wall", "overrides": {"rig.camera.rows": 8, "rig.camera.cols": 8}}
    suite = {
        "suite": "mine",
        "scenes": [small],
        "estimators": ["peak", "waveform-ml"],
        "stresses": [{"axis": "photons", "values": [1.0, 0.1, 0.01]}],
        "seeds": {"test": [1, 2]},
        "conditions": ["matched", "calibrated"],
        "calibration": {"pulse_photoelectrons": 1e5, "gate_photoelectrons": 1e3},
    }
    first = sweep(suite, out=tmp_path / "out", budget=5, report=False)
    assert [(row["estimator"], row["condition"]) for row in first.rows] == [("peak", "matched"), ("peak", "calibrated")]
    assert [(note["estimator"], note["reason"]) for note in first.skipped] == [
        ("waveform-ml", "reads waveform captures, not gated")
    ]
    names = ("breakdown.csv", "failure_map.csv", "accuracy.csv", "maps/photons.svg")
    before = {name: (first.out / name).read_bytes() for name in names}
    assert before["breakdown.csv"].splitlines()[0].endswith(b",gain_1dn,condition")
    journal = first.out / "journal.jsonl"
    lines = journal.read_text().splitlines()
    journal.write_text("\n".join(lines[: len(lines) // 2]) + '\n{"key": ["torn"')
    asked = []
    with pytest.MonkeyPatch.context() as patch:
        generate = Bench._generate
        patch.setattr(Bench, "_generate", lambda self, cell: asked.append(cell) or generate(self, cell))  # type: ignore[func-returns-value]
        again = sweep(suite, out=tmp_path / "out", budget=5, report=False, resume=True)
    made = json.loads((first.out / "run.json").read_text())["captures"]
    assert {name: (again.out / name).read_bytes() for name in names} == before
    assert 0 < len(asked) == made < 20
    with pytest.raises(InputError, match="another suite"):
        sweep({**suite, "version": 2}, out=tmp_path / "out", resume=True)


def test_whole_numbers_are_halved_to_whole_numbers_until_they_are_neighbours() -> None:
    """A sweep along a count measured its levels, and ended at the first halving: 22.6 is no whole number."""
    rng = np.random.default_rng(11)
    asked: list[float] = []

    def evaluate(points: Sequence[Point]) -> dict[Point, list[Trial]]:
        asked.extend(level for (level,) in points)
        return trials_at(lambda level: 0.9 if level < 21.5 else 0.0, rng)(points)

    found = refine_axis(evaluate, [64.0, 8.0], resolution=1e-6, budget=40, whole=True)
    assert all(level == int(level) for level in asked) and len(asked) == len(set(asked))
    for edge in found.edges:
        assert {edge.start, edge.end} == {21.0, 22.0}
    grid = refine_grid(
        lambda points: {p: [trials_at(lambda level: 0.9 if level < 2.5 else 0.0, rng)([(p[0],)])[p[0],][0]] for p in points},
        [1.0, 4.0], [1.0, 2.0], depth=3, whole=(True, True),
    )  # fmt: skip
    assert {x for x, _ in grid.trials} <= {1.0, 2.0, 3.0, 4.0} and {y for _, y in grid.trials} == {1.0, 2.0}
    assert sum((b - a) * (d - c) for a, b, c, d in grid.cells) == pytest.approx(3.0)


def test_which_paths_take_whole_numbers() -> None:
    from beambench.benchmarks.suites.stress import takes_whole_numbers
    from beambench.scenes.load import load_scene

    scene = load_scene("flat-wall")
    assert takes_whole_numbers(scene, "rig.delays.count") and takes_whole_numbers(scene, "rig.pulses_per_slice")
    assert not takes_whole_numbers(scene, "rig.detector.read_noise_e") and not takes_whole_numbers(scene, "photons")
