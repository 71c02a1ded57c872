"""A suite of parts: every scene read by its part's estimators, one file's notation, and disagreements refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from beambench.benchmarks.run import run_suite
from beambench.benchmarks.search.sweep import sweep_suite
from beambench.benchmarks.suites.suite import cells_of, load_suite
from beambench.scenes.errors import InputError

SMALL = {"rig.camera.rows": 6, "rig.camera.cols": 5}
GATED: dict[str, Any] = {
    "suite": "walls", "seeds": {"test": [3, 4]}, "fidelity": "direct", "estimators": ["peak", "parabola"],
    "scenes": [{"scene": "flat-wall", "name": "far", "overrides": SMALL}],
    "draws": [{"axis": "distance", "low": -0.1, "high": 0.1}],
    "stresses": [{"axis": "photons", "values": [1.0, 0.01]}],
}  # fmt: skip
TIMED: dict[str, Any] = {
    "suite": "counters", "seeds": {"test": [3, 4]}, "fidelity": "direct", "estimators": ["waveform-average"],
    "scenes": ["counter"],
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for part in (GATED, TIMED):
        (tmp_path / f"{part['suite']}.json").write_text(json.dumps(part))
    (tmp_path / "both.json").write_text(json.dumps({"suite": "both", "parts": ["walls.json", "counters.json"]}))
    return tmp_path


def test_scenes_draws_and_stresses_keep_to_their_part(folder: Path) -> None:
    both = load_suite(folder / "both.json")
    assert [name for name, _ in both.scenes] == ["far", "counter"]
    assert both.suite.estimators == ("peak", "parabola", "waveform-average")
    assert {(one, name) for one in both.suite.estimators for name, _ in both.scenes if both.reads(one, name)} == {
        ("peak", "far"), ("parabola", "far"), ("waveform-average", "counter")}  # fmt: skip
    assert len(both.draws("far")) == 1 and not both.draws("counter")
    assert {(cell.scene_name, cell.stress) for cell in cells_of(both)} == {
        ("far", "none"), ("far", "photons"), ("counter", "none")}  # fmt: skip
    alone = [cell for part in ("walls", "counters") for cell in cells_of(load_suite(folder / f"{part}.json"))]
    assert [(cell.scene_name, cell.seed, cell.key, cell.scene) for cell in cells_of(both)] == [
        (cell.scene_name, cell.seed, cell.key, cell.scene) for cell in alone
    ]


def test_a_scene_keeps_the_conditions_of_its_part(folder: Path) -> None:
    calibration = {"pulse_photoelectrons": 1e4, "gate_photoelectrons": 1e3}
    both_ways = {"conditions": ["matched", "calibrated"], "calibration": calibration}
    (folder / "walls.json").write_text(json.dumps(GATED | both_ways | {"estimators": ["peak"]}))
    both = load_suite(folder / "both.json")
    assert both.suite.conditions == ("matched", "calibrated") and both.conditions("counter") == ("matched",)
    run_suite(folder / "both.json", folder / "run", overrides={"stresses": []}, report=False)
    rows = pd.read_csv(folder / "run" / "scores.csv")
    assert set(zip(rows["scene"], rows["condition"], strict=True)) == {
        ("far", "matched"), ("far", "calibrated"), ("counter", "matched")}  # fmt: skip


def test_stresses_of_parts_can_be_left_out(folder: Path) -> None:
    (folder / "both.json").write_text(
        json.dumps({"suite": "both", "parts": ["walls.json", "counters.json"], "stresses": []})
    )
    assert {cell.stress for cell in cells_of(load_suite(folder / "both.json"))} == {"none"}


def test_an_estimator_that_no_scene_lists_reads_all(folder: Path) -> None:
    mine = load_suite(folder / "both.json", {"estimators": ["peak", "threshold"]})
    assert [mine.reads(one, name) for one in ("peak", "threshold") for name in ("far", "counter")] == [
        True, False, True, True]  # fmt: skip


def test_a_run_has_rows_of_a_scenes_own_estimators_only(folder: Path) -> None:
    shared = {"stresses": []}
    run_suite(folder / "both.json", folder / "run", overrides=shared, report=False)
    rows = pd.read_csv(folder / "run" / "scores.csv")
    assert set(zip(rows["scene"], rows["estimator"], strict=True)) == {
        ("far", "peak"), ("far", "parabola"), ("counter", "waveform-average")}  # fmt: skip
    assert not rows["status"].str.startswith("skip").any()
    run_suite(folder / "walls.json", folder / "alone", overrides=shared, report=False)
    alone = pd.read_csv(folder / "alone" / "accuracy.csv").drop(columns="suite")
    joint = pd.read_csv(folder / "run" / "accuracy.csv").drop(columns="suite")
    pd.testing.assert_frame_equal(joint[joint["scene"] == "far"].reset_index(drop=True), alone)


def test_a_sweep_measures_a_stress_on_its_scenes(folder: Path) -> None:
    sweep_suite(folder / "both.json", folder / "sweep", budget=3, report=False)
    rows = pd.read_csv(folder / "sweep" / "breakdown.csv")
    assert set(rows["estimator"]) == {"peak", "parabola"} and set(rows["modality"]) == {"gated"}


@pytest.mark.parametrize(
    ("own", "other", "where"),
    [
        ({"scenes": ["flat-wall"]}, {}, "both.json: scenes"),
        ({"estimators": ["peak"]}, {}, "both.json: estimators"),
        ({"stresses": GATED["stresses"]}, {}, "both.json: stresses"),
        ({"parts": "walls.json"}, {}, "both.json: parts"),
        ({"parts": ["walls.json", "walls.json"]}, {}, "both.json: parts"),
        ({"parts": ["both.json"]}, {}, "both.json: parts"),
        ({}, {"seeds": {"test": [5]}}, "both.json: seeds"),
        ({}, {"rtol": 0.1}, "both.json: rtol"),
        ({}, {"scenes": [{"scene": "counter", "name": "far"}]}, "both.json: scenes"),
        ({}, {"scenes": 3}, "counters.json: scenes"),
        ({}, {"scenes": ["counter", 3]}, "counters.json: scenes.1"),
        ({}, {"scenes": [{"overrides": {}}]}, "counters.json: scenes.0.scene"),
        ({}, {"scenes": [{"scene": "counter", "overrides": 3}]}, "counters.json: scenes.0.overrides"),
        ({}, {"scens": ["counter"]}, "counters.json: scens"),
        ({}, {"estimators": [["peak"]]}, "counters.json: estimators.0"),
        ({}, {"estimators": 3}, "counters.json: estimators"),
        ({}, {"stresses": [4]}, "counters.json: stresses.0"),
        ({}, {"draws": [{"axis": "distance", "low": -0.1, "high": 0.1, "scenes": 3}]}, "counters.json: draws.0.scenes"),
        ({}, {"conditions": 3}, "counters.json: conditions"),
        ({}, {"calibration": 3}, "counters.json: calibration"),
        ({"calibration": 3}, {"calibration": {"pulse_photoelectrons": 10.0}}, "calibration"),
    ],
)
def test_what_does_not_fit_is_refused(folder: Path, own: dict[str, Any], other: dict[str, Any], where: str) -> None:
    (folder / "counters.json").write_text(json.dumps(TIMED | other))
    joint = {"suite": "both", "parts": ["walls.json", "counters.json"]} | own
    (folder / "both.json").write_text(json.dumps(joint))
    with pytest.raises(InputError) as found:
        load_suite(folder / "both.json")
    assert str(found.value.where).endswith(where)


def test_a_calibration_is_joined_and_a_contradiction_refused(folder: Path) -> None:
    (folder / "walls.json").write_text(json.dumps(GATED | {"calibration": {"pulse_photoelectrons": 10.0, "seed": 7}}))
    (folder / "counters.json").write_text(json.dumps(TIMED | {"calibration": {"spot_photoelectrons": 5.0, "seed": 7}}))
    joint = load_suite(folder / "both.json").suite.calibration
    assert joint is not None and (joint.pulse_photoelectrons, joint.spot_photoelectrons, joint.seed) == (10.0, 5.0, 7)
    (folder / "counters.json").write_text(json.dumps(TIMED | {"calibration": {"seed": 8}}))
    with pytest.raises(InputError, match="disagree"):
        load_suite(folder / "both.json")


def test_stresses_of_unknown_scenes_are_refused() -> None:
    with pytest.raises(InputError, match="stresses"):
        load_suite(GATED | {"stresses": [{"axis": "photons", "values": [1.0], "scenes": ["near"]}]})


def test_suites_without_these_options_keep_their_hash() -> None:
    plain = load_suite(GATED)
    entry = GATED["scenes"][0] | {"estimators": []}
    stress = GATED["stresses"][0] | {"scenes": []}
    assert load_suite(GATED | {"scenes": [entry], "stresses": [stress]}).hash == plain.hash
