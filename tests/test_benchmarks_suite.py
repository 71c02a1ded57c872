"""Suite files: loaded, overridden, hashed and refused with a message that helps."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest

from beambench.benchmarks.folders.journal import Journal, default_folder
from beambench.benchmarks.folders.kinds import RUN
from beambench.benchmarks.folders.workplace import output_folder, workplace
from beambench.benchmarks.runner.estimator_labels import check_estimators
from beambench.benchmarks.suites.suite import SUITES, capture_key, cells_of, list_suites, load_suite
from beambench.estimators import get_estimator, parse_label
from beambench.scenes.errors import InputError


def suite(**changes: Any) -> dict[str, Any]:
    data: dict[str, Any] = {
        "suite": "small", "version": 1, "title": "Small", "scenes": ["flat-wall"],
        "seeds": {"dev": [1], "test": [2, 3]}, "estimators": ["peak"], "limits": {"time_s": 5.0, "memory_bytes": 2**30},
    }  # fmt: skip
    return data | changes


def test_every_suite_that_ships_loads_and_names_known_estimators() -> None:
    assert "quickstart" in list_suites()
    for name in list_suites():
        loaded = load_suite(name)
        assert loaded.suite.suite == name
        assert check_estimators(loaded.suite.estimators)
        assert cells_of(loaded)


def test_the_quickstart_is_as_large_as_promised() -> None:
    loaded = load_suite("quickstart")
    gated = [scene for _, scene in loaded.scenes if scene.modality == "gated"]
    assert len(gated) >= 3
    assert [scene.modality for _, scene in loaded.scenes if scene.modality != "gated"] == ["laser_line", "wavefront"]
    assert set(loaded.suite.conditions) == {"matched", "calibrated"}
    for scene in gated:
        assert scene.rig.camera.rows >= 256
        assert scene.rig.camera.cols >= 256
        assert scene.rig.delays.count * len(scene.rig.gates) >= 64


def test_nobody_is_skipped_in_the_quickstart() -> None:
    loaded = load_suite("quickstart")
    for name, scene in loaded.scenes:
        readers = [label for label in loaded.suite.estimators if loaded.reads(label, name)]
        assert len(readers) >= 2
        assert {get_estimator(parse_label(label)[0]).modality for label in readers} == {scene.modality}
    everywhere = {label for name, _ in loaded.scenes for label in loaded.suite.estimators if loaded.reads(label, name)}
    assert everywhere == set(loaded.suite.estimators)


def test_cells_are_scenes_by_levels_by_seeds() -> None:
    stresses = [
        {"axis": "rig.ambient_e_per_s", "values": [0.0, 1e6]},
        {
            "axis": "rig.pulses_per_slice",
            "values": [10, 20],
            "axis2": "rig.detector.read_noise_e",
            "values2": [1.0, 5.0],
        },
    ]
    cells = cells_of(load_suite(suite(stresses=stresses)))
    assert len(cells) == 2 * (1 + 2 + 4)
    assert math.isnan(cells[0].level)
    assert cells[0].stress == "none"
    grid = [cell for cell in cells if cell.stress2 != "none"]
    assert {(c.level, c.level2) for c in grid} == {(10.0, 1.0), (10.0, 5.0), (20.0, 1.0), (20.0, 5.0)}
    assert {c.scene.rig.pulses_per_slice for c in grid} == {10, 20}
    assert len({c.key for c in cells}) == 7  # one key per (scene, stress, level), whatever the seed


def test_keys_are_of_named_axes_and_never_change() -> None:
    assert capture_key("flat-wall", "none", math.nan) == 169694216592984
    assert capture_key("flat-wall", "a", 1.0) != capture_key("flat-wall", "a", 2.0)
    assert 0 <= capture_key("x", "y", 0.5) < 2**48


def test_the_split_chooses_the_seeds() -> None:
    loaded = load_suite(suite())
    assert [c.seed for c in cells_of(loaded, "dev")] == [1]
    assert [c.seed for c in cells_of(loaded)] == [2, 3]
    with pytest.raises(InputError, match="no dev seeds"):
        cells_of(load_suite(suite(seeds={"test": [1]})), "dev")


def test_overrides_reach_the_suite_and_every_scene() -> None:
    plain = load_suite(suite())
    loaded = load_suite(suite(), {"seeds.test": [9], "rig.camera.rows": 16, "target.wall.material.albedo": 0.25})
    assert loaded.suite.seeds.test == (9,)
    assert loaded.scenes[0][1].rig.camera.rows == 16
    assert loaded.scenes[0][1].target[0].material.albedo == 0.25  # type: ignore[union-attr]
    assert loaded.hash != plain.hash


def test_the_hash_is_of_the_content(tmp_path: Path) -> None:
    import json

    path = tmp_path / "mine.json"
    path.write_text(json.dumps(suite()))
    assert load_suite(path).hash == load_suite(suite(title="Other words")).hash
    assert load_suite(path).hash != load_suite(suite(version=2)).hash


def test_a_scene_may_be_listed_twice_under_two_names() -> None:
    entry = {"scene": "flat-wall", "name": "dim", "overrides": {"target.wall.material.albedo": 0.05}}
    loaded = load_suite(suite(scenes=["flat-wall", entry]))
    assert [name for name, _ in loaded.scenes] == ["flat-wall", "dim"]
    with pytest.raises(InputError, match="same name"):
        load_suite(suite(scenes=["flat-wall", "flat-wall"]))


@pytest.mark.parametrize(
    "change",
    [
        {"target.0.shape.file": "{}"},
        {"target.wall.shape": {"kind": "mesh", "file": "{}", "extent_m": 1.0}},
        {"target": [{"name": "wall", "shape": {"kind": "mesh", "file": "{}", "extent_m": 1.0}}]},
        {"target.0.texture.file": "../{}"},
    ],
)
def test_the_overrides_of_a_suite_file_name_no_file_outside_its_folder(tmp_path: Path, change: dict[str, Any]) -> None:
    import json

    secret = tmp_path / "secret.obj"
    secret.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "suites").mkdir()
    path = tmp_path / "suites" / "mine.json"
    text = json.dumps(suite(scenes=[{"scene": "flat-wall", "overrides": change}]))
    path.write_text(text.replace("{}", str(secret)))
    with pytest.raises(InputError, match="lie in its folder"):
        load_suite(path)


def test_the_overrides_of_a_suite_file_find_meshes_beside_it(tmp_path: Path) -> None:
    import json

    folder = tmp_path / "suites"
    folder.mkdir()
    (folder / "tile.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    shape = {"kind": "mesh", "file": "tile.obj", "size_m": 1.0, "center_m": [0, 0, 2], "rotation_deg": [0, 0, 0]}
    path = folder / "mine.json"
    path.write_text(json.dumps(suite(scenes=[{"scene": "flat-wall", "overrides": {"target.wall.shape": shape}}])))
    loaded = load_suite(path).scenes[0][1].target[0].shape
    assert Path(loaded.file) == (folder / "tile.obj").resolve()  # type: ignore[union-attr]


WALL = {"scene": "flat-wall", "overrides": {"rig.camera.rows": 8, "rig.camera.cols": 8}}
DIM = {"overrides": {"target.wall.material.albedo": 0.05, "rig.pulses_per_slice": 9}}


def test_variants_are_written_out_and_leave_no_trace() -> None:
    variants = {"small": WALL, "smaller": {"scene": "small", "overrides": {"rig.camera.rows": 4}}, "dim": DIM}
    scenes = [
        "small",
        {"scene": "smaller", "with": ["dim"], "name": "smaller-dim", "overrides": {"rig.pulses_per_slice": 7}},
        {"scene": "flat-wall", "with": ["dim"]},
    ]
    loaded = load_suite(suite(variants=variants, scenes=scenes))
    assert [name for name, _ in loaded.scenes] == ["small", "smaller-dim", "flat-wall"]
    rigs = [(s.rig.camera.rows, s.rig.camera.cols, s.rig.pulses_per_slice) for _, s in loaded.scenes]  # type: ignore[attr-defined]
    assert rigs == [(8, 8, 100), (4, 8, 7), (64, 64, 9)]
    plain = [
        {"name": "small", **WALL},
        {"scene": "flat-wall", "name": "smaller-dim", "overrides": {
            "target.wall.material.albedo": 0.05, "rig.camera.cols": 8, "rig.camera.rows": 4, "rig.pulses_per_slice": 7}},
        {"scene": "flat-wall", "overrides": DIM["overrides"]},
    ]  # fmt: skip
    assert load_suite(suite(scenes=plain)).hash == loaded.hash


def test_later_overrides_of_a_variant_win_over_earlier_ones() -> None:
    inner = {"scene": "flat-wall", "overrides": {"target.0.material": {"kind": "lambert", "albedo": 0.9}}}
    outer = {"scene": "inner", "overrides": {"target.0.material.albedo": 0.3}}
    again = {"scene": "outer", "overrides": {"target.0.material": {"kind": "lambert", "albedo": 0.7}}}
    loaded = load_suite(suite(variants={"inner": inner, "outer": outer, "again": again}, scenes=["outer", "again"]))
    assert [s.target[0].material.albedo for _, s in loaded.scenes] == [0.3, 0.7]  # type: ignore[union-attr]


def test_overrides_of_a_suite_reach_its_variants_and_its_written_out_scenes() -> None:
    data = suite(variants={"small": WALL, "dim": DIM}, scenes=["small"])
    rows = {"variants.small.overrides": {"rig.camera.rows": 5}}
    assert load_suite(data, rows).scenes[0][1].rig.camera.rows == 5  # type: ignore[attr-defined]
    both = load_suite(data, {"scenes.0.overrides": {"rig.camera.rows": 6}}).scenes[0][1].rig.camera  # type: ignore[attr-defined]
    assert (both.rows, both.cols) == (6, 64)
    dim = load_suite(data, {"scenes": [{"scene": "small", "with": ["dim"]}]}).scenes[0][1]
    assert dim.target[0].material.albedo == 0.05  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("variants", "scenes", "message"),
    [
        ({"a": {"scene": "b"}, "b": {"scene": "a"}}, ["flat-wall"], "a -> b -> a"),
        ({"a": {"with": ["b"]}, "b": {"with": ["a"]}}, ["flat-wall"], "a -> b -> a"),
        ({"flat-wall": {"scene": "flat-wall"}}, ["flat-wall"], "flat-wall -> flat-wall"),
        ({"a": WALL}, [{"scene": "flat-wall", "with": ["a"]}], "without a scene"),
        ({"a": DIM}, [{"scene": "flat-wall", "with": ["b"]}], "allowed: a"),
        ({"a": DIM}, ["a"], "A variant without a scene is used as a scene"),
        ({"a": {"scen": "flat-wall"}}, ["flat-wall"], "variants.a.scen"),
        ({"a": 3}, ["flat-wall"], "variants.a"),
        ([WALL], ["flat-wall"], "variants"),
        ({"a": WALL}, [{"scene": "a", "with": "dim"}], "scenes.0"),
        ({"a": WALL}, [{"scene": "a", "overrides": 3}], "scenes.0"),
        ({"a": WALL}, [{"scene": "a", "nome": "x"}], "nome"),
        ({"a": WALL}, [3], "scenes.0"),
    ],
)
def test_bad_variants_are_refused(variants: Any, scenes: list[Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        load_suite(suite(variants=variants, scenes=scenes))
    assert message in str(caught.value)


def test_the_suite_with_variants_in_the_docs(project: Path, tmp_path: Path) -> None:
    text = (project / "docs" / "stress-and-breakdown.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```toml\n(suite = .*?)```", text, re.DOTALL)
    (tmp_path / "my-waters.toml").write_text(code, encoding="utf-8")
    rigs = {name: scene.rig for name, scene in load_suite(tmp_path / "my-waters.toml").scenes}
    sizes = {name: (rig.camera.rows, rig.camera.cols) for name, rig in rigs.items()}  # type: ignore[attr-defined]
    assert sizes == {"small": (16, 16), "clear": (16, 16), "clear-dim": (8, 16)}
    assert rigs["clear-dim"].laser.pulse_energy_j == 2e-8  # type: ignore[attr-defined]


def test_no_suite_that_ships_has_a_long_line() -> None:
    for name in list_suites():
        for number, line in enumerate((SUITES / f"{name}.toml").read_text(encoding="utf-8").splitlines(), 1):
            assert len(line) <= 132, f"{name}.toml:{number}"


def test_scene_files_lie_beside_the_suite(tmp_path: Path) -> None:
    import json

    from beambench.scenes.load import load_scene

    (tmp_path / "own.json").write_text(load_scene("flat-wall").model_dump_json())
    (tmp_path / "mine.json").write_text(json.dumps(suite(scenes=["own.json"])))
    assert load_suite(tmp_path / "mine.json").scenes[0][0] == "flat-wall"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenes": ["flat-wal"]}, "flat-wall"),
        ({"scenes": []}, "at least 1"),
        ({"estimatorz": ["peak"]}, "estimators"),
        ({"seeds": {"dev": [1], "test": [1]}}, "apart"),
        ({"seeds": {"test": [-1]}}, "at least 0"),
        ({"conditions": ["calibrated"]}, "calibration"),
        ({"conditions": ["guessed"]}, "matched"),
        ({"limits": {"time_s": -1.0, "memory_bytes": 2**30}}, "above 0"),
        ({"limits": {"time_s": 1.0}}, "memory_bytes"),
        ({"stresses": [{"axis": "rig.ambientt", "values": [1.0]}]}, "ambientt"),
        ({"stresses": [{"axis": "rig.ambient_e_per_s", "values": [-1.0]}]}, "does not fit"),
        ({"stresses": [{"axis": "rig.ambient_e_per_s", "values": [1.0], "axis2": "rig.t0_s"}]}, "together"),
        ({"failure_at": 0.0}, "above 0"),
        ({"estimators": ["peak", "peak"]}, "once"),
    ],
)
def test_a_bad_suite_is_refused_with_what_is_allowed(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        load_suite(suite(**changes))
    assert message in str(caught.value)


def test_an_unknown_suite_or_override_tells_what_is_near() -> None:
    with pytest.raises(InputError, match="quickstart"):
        load_suite("quickstrat")
    with pytest.raises(InputError, match="estimators"):
        load_suite(suite(), {"estimater": ["peak"]})


def test_estimators_are_checked_before_anything_runs() -> None:
    with pytest.raises(InputError, match="weighted-average"):
        check_estimators(["weighted-averag"])
    with pytest.raises(InputError, match="unknown parameter"):
        check_estimators(["peak[nonsense=1]"])
    with pytest.raises(InputError, match="twice"):
        check_estimators(["peak", " peak "])
    (chosen,) = check_estimators(["peak"])
    assert (chosen.name, chosen.params, chosen.label) == ("peak", "", "peak")


def _begin(place: Path, suite_hash: str = "h", **flags: bool) -> None:
    with workplace(place, RUN, check=lambda held: Journal.check(held, suite_hash), **flags) as work:
        Journal(work, suite_hash).add(("a",), [{"status": "ok"}])


def test_an_output_is_never_overwritten_unasked(tmp_path: Path) -> None:
    place = tmp_path / "run"
    _begin(place)
    with pytest.raises(InputError, match="not empty"):
        _begin(place)
    with pytest.raises(InputError, match="another suite"):
        _begin(place, "other", resume=True)
    _begin(place, resume=True)
    assert len((place / "journal.jsonl").read_text().splitlines()) == 3
    (place / "notes.txt").write_text("mine")
    _begin(place, "other", overwrite=True)
    assert (place / "notes.txt").exists()
    assert len((place / "journal.jsonl").read_text().splitlines()) == 2
    with pytest.raises(InputError, match="exclude"):
        output_folder(place, "x", resume=True, overwrite=True)
    stranger = tmp_path / "home"
    stranger.mkdir()
    (stranger / "thesis.tex").write_text("x")
    with pytest.raises(InputError, match="did not write"):
        _begin(stranger, overwrite=True)
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="not a folder"):
        _begin(tmp_path / "file")
    with pytest.raises(InputError, match="cannot be written"):
        _begin(tmp_path / "file" / "below")


def test_the_journal_takes_up_what_was_ok_and_skips_a_torn_line(tmp_path: Path) -> None:
    journal = Journal(tmp_path, "h")
    journal.add(("a", "1"), [{"status": "ok", "rmse": 0.5, "efficiency": math.nan}])
    journal.add(("b", "1"), [{"status": "timeout: x", "rmse": math.nan}])
    with open(journal.path, "a") as file:
        file.write('{"key": ["e", "1"], "rows": [1]}\n{"key": ["f"], "rows": [{"status": "ok"}], "beside": 3}\n[]\n')
        file.write('{"key": ["c", "1"], "rows": [{"sta')
    again = Journal(tmp_path, "h")
    assert list(again.done) == [("a", "1")]
    again.add(("d", "1"), [{"status": "ok"}])
    assert list(Journal(tmp_path, "h").done) == [("a", "1"), ("d", "1")]
    (row,) = again.done["a", "1"]
    assert row["rmse"] == 0.5
    assert math.isnan(row["efficiency"])


def test_default_folders_do_not_collide(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    first = default_folder("x")
    first.mkdir(parents=True)
    assert default_folder("x") != first


def test_a_key_in_the_wrong_place_is_not_suggested_again() -> None:
    data = suite(overrides={"rig.camera.rows": 4})
    with pytest.raises(InputError, match="exists elsewhere in the spec") as caught:
        load_suite(data)
    assert "did you mean" not in str(caught.value)
