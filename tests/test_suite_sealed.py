"""Sealed suites: seeds that only the key gives, captures without truth, and scores equal to those of a run with that key."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import beambench
from beambench.benchmarks.suites.sealed import read_key
from beambench.benchmarks.suites.suite import cells_of, load_suite
from beambench.captures import open_captures
from beambench.captures.hide import hide_truth
from beambench.scenes.errors import InputError

from ._folders import tree

SUITE: dict[str, Any] = {
    "suite": "challenge", "seeds": {"test": [1, 2]}, "fidelity": "direct", "estimators": ["peak", "poisson-ml"],
    "scenes": [{"scene": "flat-wall", "name": "wall", "overrides": {"rig.camera.rows": 6, "rig.camera.cols": 5}}],
    "draws": [{"axis": "distance", "low": -0.1, "high": 0.1}],
}  # fmt: skip


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "challenge.json").write_text(json.dumps(SUITE))
    (tmp_path / "a.key").write_text("ab" * 32 + "\n")
    (tmp_path / "b.key").write_text("cd" * 32)
    return tmp_path


def test_seeds_and_poses_follow_from_the_key_alone(place: Path) -> None:
    loaded = load_suite(place / "challenge.json")
    mine = load_suite(place / "challenge.json", {"estimators": ["parabola"]})
    one, other = read_key(place / "a.key"), read_key(place / "b.key")
    cells = cells_of(loaded, key=one)
    of_entry = [(cell.scene, cell.key, cell.random_seed) for cell in cells_of(mine, key=one)]
    assert [(cell.scene, cell.key, cell.random_seed) for cell in cells] == of_entry, (
        "an entry must not change the captures"
    )
    assert [cell.seed for cell in cells] == [1, 2]
    seeds = {cell.random_seed for key in (one, other) for cell in cells_of(loaded, key=key)}
    assert len(seeds) == 4 and all(0 <= seed < 2**63 for seed in seeds) and max(seeds) > 2**40
    plain = {cell.scene.target[0].shape.center_m[2] for cell in cells_of(loaded)}  # type: ignore[union-attr]
    assert plain.isdisjoint(cell.scene.target[0].shape.center_m[2] for cell in cells)  # type: ignore[union-attr]
    assert "ab" * 16 not in repr(one) and one.name != other.name


def test_what_is_given_away_tells_neither_truth_nor_seed(place: Path) -> None:
    suite, key = place / "challenge.json", read_key(place / "a.key")
    made = beambench.generate(suite, sealed=place / "a.key", out=place / "public")
    cells = cells_of(load_suite(suite), key=key)
    captures = open_captures(made.paths[0])
    for index, cell in enumerate(cells):
        capture = captures[index]
        assert capture.attrs["truth_kind"] == "none" and "truth_scene" not in capture.attrs
        assert all(np.isnan(v.values).all() for n, v in capture.variables.items()
                   if str(n).startswith("truth_") and v.dtype.kind == "f")  # fmt: skip
        told = json.dumps({**capture.attrs, **made.plan[index]}, default=str)
        assert str(cell.random_seed) not in told and key.secret.hex() not in told
    secrets = [str(cell.random_seed).encode() for cell in cells] + [key.secret.hex().encode()]
    for name, data in tree(place / "public").items():
        assert not any(secret in data or secret.decode() in name for secret in secrets)
    again = beambench.generate(suite, sealed=place / "a.key", out=place / "public", resume=True)
    assert again.paths == made.paths
    with pytest.raises(InputError, match="not the requested ones"):
        beambench.generate(suite, sealed=place / "b.key", out=place / "public", resume=True)


def test_scores_of_answers_equal_those_of_a_run_with_the_key(place: Path) -> None:
    suite = place / "challenge.json"
    store = beambench.generate(suite, sealed=place / "a.key", out=place / "public").paths[0]
    beambench.estimate(store, ["peak", "poisson-ml"], out=place / "answers")
    table = beambench.score(store, place / "answers", sealed=place / "a.key", suite=suite, out=place / "scores")
    ran = beambench.run(suite, sealed=place / "a.key", out=place / "run", report=False)
    columns = ["scene", "seed", "estimator", "n", "coverage", "bias", "rmse", "rmse_full", "bound", "z_rms"]
    expected = pd.DataFrame(ran.rows)[columns].sort_values(["estimator", "seed"]).reset_index(drop=True)
    found = table[columns].sort_values(["estimator", "seed"]).reset_index(drop=True)
    pd.testing.assert_frame_equal(found, expected, check_dtype=False, rtol=1e-6)
    assert set(found["seed"]) == {1, 2} and (found["n"] == 30).all()
    record = json.loads((place / "run" / "run.json").read_text())
    assert record["seeds"] == [1, 2] and record["sealed"] == read_key(place / "a.key").name
    assert not list((place / "run" / "pictures").iterdir()), "a picture of the truth would tell it"
    secrets = [str(cell.random_seed) for cell in cells_of(load_suite(suite), key=read_key(place / "a.key"))]
    tables = "".join(path.read_text() for path in (place / "run").glob("*.csv"))
    assert not any(secret in tables for secret in secrets)


def test_another_key_changed_data_and_missing_keys_are_refused(place: Path) -> None:
    suite = place / "challenge.json"
    store = beambench.generate(suite, sealed=place / "a.key", out=place / "public").paths[0]
    beambench.estimate(store, ["peak"], out=place / "answers")
    for arguments, message in (
        ({}, "no truth"),
        ({"sealed": place / "b.key", "suite": suite}, "another key"),
        ({"sealed": place / "a.key"}, "challenge"),
        ({"sealed": place / "a.key", "suite": "quickstart"}, "another suite"),
        ({"suite": suite}, "sealed captures only"),
    ):
        with pytest.raises(InputError, match=message):
            beambench.score(store, place / "answers", out=place / "scores", **arguments)
    changed = SUITE | {"scenes": [SUITE["scenes"][0] | {"overrides": {
        "rig.camera.rows": 6, "rig.camera.cols": 5, "rig.laser.pulse_energy_j": 3e-6}}]}  # fmt: skip
    suite.write_text(json.dumps(changed))
    with pytest.raises(InputError, match="not the one that the key gives"):
        beambench.score(store, place / "answers", sealed=place / "a.key", suite=suite, out=place / "scores")
    assert not (place / "scores").exists()


@pytest.mark.parametrize("text", ["", "ab" * 31, "xy" * 32, "ab" * 32 + "\nab", "ab" * 4000])
def test_a_file_without_a_key_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "key").write_text(text)
    with pytest.raises(InputError, match="holds no key"):
        read_key(tmp_path / "key")
    os.remove(tmp_path / "key")
    with pytest.raises(InputError, match="cannot be read"):
        read_key(tmp_path / "key")


def test_a_sealed_run_is_not_resumed_with_another_key(place: Path) -> None:
    beambench.run(
        place / "challenge.json", sealed=place / "a.key", out=place / "run", estimators=["peak"], report=False
    )
    with pytest.raises(InputError, match="sealed"):
        beambench.run(
            place / "challenge.json", sealed=place / "b.key", out=place / "run", estimators=["peak"], resume=True
        )


def test_only_a_suite_is_sealed_and_as_its_file_says(place: Path) -> None:
    with pytest.raises(InputError, match="Only a suite"):
        beambench.generate("flat-wall", sealed=place / "a.key", out=place / "x")
    with pytest.raises(InputError, match="as its file says"):
        beambench.generate(place / "challenge.json", sealed=place / "a.key", truth_electrons=True, out=place / "x")


def test_the_hidden_capture_is_the_same(place: Path) -> None:
    store = beambench.generate(place / "challenge.json", sealed=place / "a.key", out=place / "public").paths[0]
    beambench.run(
        place / "challenge.json", sealed=place / "a.key", out=place / "run", estimators=["peak"], report=False
    )
    kept = sorted((place / "run" / "captures").glob("*.zarr"))
    assert hide_truth(open_captures(store)[0]).identical(hide_truth(open_captures(kept[0])[0]))
