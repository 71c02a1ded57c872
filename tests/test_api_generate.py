"""`generate`: refusals before any work, and resuming, which never mixes data sets."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import beambench
from beambench import InputError, cli

SMALL = {"rig.camera.rows": 4, "rig.camera.cols": 4, "rig.delays.count": 8}
SET = [text for path, value in SMALL.items() for text in ("--set", f"{path}={value}")]


@pytest.fixture(autouse=True)
def _rendering() -> None:
    if importlib.util.find_spec("mitsuba") is None:  # importing it here would let it find a libLLVM of its own
        pytest.skip("Mitsuba is not installed")


class Interrupted(Exception):
    pass


def interrupt(path: Path, scene: str, seeds: list[int], after: int) -> None:
    """Leave `path`.partial as an interrupted command does: with `after` captures."""
    told = 0

    def progress(stage: str, done: int, total: int, what: str) -> None:
        nonlocal told
        told += 1
        if told > after:
            raise Interrupted

    with pytest.raises(Interrupted):
        beambench.generate(scene, overrides=SMALL, seeds=seeds, out=path, progress=progress)
    assert path.with_name(path.name + ".partial").is_dir() and not path.exists()


def seeds_of(path: Path) -> list[int]:
    return [row["seed"] for row in beambench.data_status(path)["captures"]]


def test_resume_goes_on_with_the_same_captures_only(tmp_path: Path) -> None:
    path = tmp_path / "r.zarr"
    interrupt(path, "flat-wall", [1, 2, 3], after=2)
    begun = (path.with_name("r.zarr.partial") / "journal.jsonl").read_bytes()
    others: list[tuple[str, dict[str, Any], str]] = [
        ("sphere", {"seeds": [1, 2, 3]}, "its scene is 'flat-wall', not 'sphere'"),
        ("flat-wall", {"seeds": [1, 9, 3]}, "capture 1: its seed is 2, not 9"),
        ("flat-wall", {"seeds": [1]}, "only 1 captures are requested"),
        ("flat-wall", {"seeds": [1, 2, 3], "rtol": 0.01}, "rtol"),
        ("flat-wall", {"seeds": [1, 2, 3], "truth_electrons": True}, "truth_electrons"),
        ("flat-wall", {"seeds": [1, 2, 3], "overrides": SMALL | {"rig.t0_s": 1e-9}}, "other values"),
    ]
    for scene, options, told in others:
        with pytest.raises(InputError, match=told) as caught:
            beambench.generate(scene, **({"overrides": SMALL} | options), out=path, resume=True)
        assert "not the requested ones" in str(caught.value)
    assert (path.with_name("r.zarr.partial") / "journal.jsonl").read_bytes() == begun
    beambench.generate("flat-wall", overrides=SMALL, seeds=[1, 2, 3], out=path, resume=True)
    assert seeds_of(path) == [1, 2, 3]


def test_resume_of_a_complete_store_leaves_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "c.zarr"
    beambench.generate("flat-wall", overrides=SMALL, seeds=[1, 2], out=path)
    before = (path / "manifest.json").stat().st_mtime_ns
    beambench.generate("flat-wall", overrides=SMALL, seeds=[1, 2], out=path, resume=True)
    assert (path / "manifest.json").stat().st_mtime_ns == before
    with pytest.raises(InputError, match="its scene is 'flat-wall', not 'sphere'"):
        beambench.generate("sphere", overrides=SMALL, seeds=[1, 2], out=path, resume=True)
    with pytest.raises(InputError, match="fewer captures"):
        beambench.generate("flat-wall", overrides=SMALL, seeds=[1, 2, 3], out=path, resume=True)
    assert (
        cli.main(["generate", "flat-wall", *SET, "--seeds", "1", "-o", str(path)]) == 2
    )  # no --resume, no --overwrite
    assert seeds_of(path) == [1, 2]


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    file = tmp_path / "two.toml"
    file.write_text(
        'schema_version = 1\nsuite = "two"\nversion = 1\ntitle = "Two scenes"\nscenes = ["flat-wall", "sphere"]\n'
        'estimators = ["peak"]\nconditions = ["matched"]\nfidelity = "direct"\nrtol = 1e-2\n'
        "seeds = { dev = [100], test = [1, 2] }\n"
    )
    return file


def test_a_suite_resumes_with_the_store_that_is_not_complete(suite: Path, tmp_path: Path) -> None:
    out = tmp_path / "suite"
    told = 0

    def progress(stage: str, done: int, total: int, what: str) -> None:
        nonlocal told
        told += 1
        if told == 5:  # two captures and the end of the first store; then one of the second
            raise Interrupted

    with pytest.raises(Interrupted):
        beambench.generate(suite, overrides=SMALL, out=out, progress=progress)
    assert sorted(entry.name for entry in out.iterdir()) == ["flat-wall.zarr", "sphere.zarr.partial"]
    before = (out / "flat-wall.zarr" / "manifest.json").stat().st_mtime_ns
    # A store that holds something else stops all before the first capture is made.
    with pytest.raises(InputError, match="other values"):
        beambench.generate(suite, overrides=SMALL | {"rig.t0_s": 1e-9}, out=out, resume=True)
    made = beambench.generate(suite, overrides=SMALL, out=out, resume=True)
    assert [path.name for path in made.paths] == ["flat-wall.zarr", "sphere.zarr"]
    assert (out / "flat-wall.zarr" / "manifest.json").stat().st_mtime_ns == before
    assert seeds_of(out / "sphere.zarr") == [1, 2]


def test_a_suite_looks_at_all_its_stores_before_it_begins(suite: Path, tmp_path: Path) -> None:
    out = tmp_path / "suite"
    beambench.generate("sphere", overrides=SMALL, out=out / "sphere.zarr")
    with pytest.raises(InputError, match="The output exists"):
        beambench.generate(suite, overrides=SMALL, out=out)
    assert [entry.name for entry in out.iterdir()] == ["sphere.zarr"] and seeds_of(out / "sphere.zarr") == [0]


def test_the_plan_of_a_suite_names_its_entries() -> None:
    names = {row["scene"] for row in beambench.generate("waters", plan=True).plan}
    assert len(names) > 1


@pytest.mark.parametrize(
    ("argv", "told"),
    [
        (["quickstart", "--seeds", "3"], "A suite has seeds of its own"),
        (["flat-wall", "--seeds", "1.5"], "whole number"),
        (["flat-wall", "--seeds=-1"], "whole number"),
        (["flat-wall", "--seeds", "4", "--seeds", "4"], "given twice"),
        (["flat-wall", "--rtol", "nan"], "rtol must be a fraction"),
        (["flat-wall", "--rtol=-1"], "rtol must be a fraction"),
        (["flat-wall", "--rtol", "noise"], "--fidelity auto"),
        (["flat-wall", "--truth-components", "--fidelity", "auto"], "kept apart"),
        (["amcw", "--truth-instances"], "which piece of the target"),
        (["flat-wall", "--set", "rig.delays.count=65536", "--set", "rig.delays.repeats=65536"], "memory"),
        (["flat-wall", "--resume"], "--resume needs"),
        (["flat-wall", "-o", "x.zarr", "--resume", "--overwrite"], "Both"),
        ([], "--like STORE"),
    ],
)
@pytest.mark.parametrize("plan", [[], ["--plan"]])
def test_what_generation_refuses_the_plan_refuses(
    argv: list[str], told: str, plan: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert cli.main(["generate", *argv, *plan]) == 2
    assert told in capsys.readouterr().err and not list(tmp_path.iterdir())


@pytest.mark.parametrize("seeds", [7, ["a"], [1.5], [], "12", [True]])
def test_seeds_of_a_wrong_kind(seeds: Any) -> None:
    with pytest.raises(InputError, match="whole number"):
        beambench.generate("flat-wall", seeds=seeds, plan=True)


def test_rtol_of_a_wrong_kind() -> None:
    with pytest.raises(InputError, match="rtol must be a fraction"):
        beambench.generate("flat-wall", rtol="x", plan=True)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "extra", [["--seeds", "5"], ["--fidelity", "full"], ["--rtol", "0.1"], ["--resume"], ["sphere"]]
)
def test_like_takes_nothing_that_would_change_it(
    extra: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["generate", *extra, "--like", str(tmp_path / "a.zarr")]) == 2
    assert "which cannot be changed" in capsys.readouterr().err


# ---------------------------------------------------------------- files that a scene is made of


@pytest.fixture
def relief(tmp_path: Path) -> Iterator[Path]:
    """A scene file with a grid of heights beside it."""
    import tomllib

    from beambench.scenes.spec_files import LIBRARY

    folder = tmp_path / "scene"
    folder.mkdir()
    data = tomllib.loads((LIBRARY / "flat-wall.toml").read_text())
    data["target"][0]["shape"] = {
        "kind": "height-grid", "file": "relief.npy", "center_m": [0.0, 0.0, 5.0], "width_m": 3.0, "relief_m": 0.2,
        "tilt_x_deg": 0.0, "tilt_y_deg": 0.0,
    }  # fmt: skip
    np.save(folder / "relief.npy", np.arange(16.0).reshape(4, 4))
    (folder / "relief.json").write_text(json.dumps(data))
    yield folder / "relief.json"


def test_the_files_of_a_scene_are_recorded_and_compared_first(
    relief: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import hashlib

    from beambench.captures import open_captures

    path = tmp_path / "relief.zarr"
    grid = relief.with_name("relief.npy")
    beambench.generate(relief, overrides=SMALL, seeds=[1, 2], out=path)
    for index in range(2):
        (file,) = json.loads(open_captures(path).attributes(index)["provenance"])["files"]
        assert file == {
            "path": "target.0.shape.file", "name": "relief.npy", "bytes": grid.stat().st_size,
            "sha256": hashlib.sha256(grid.read_bytes()).hexdigest(),
        }  # fmt: skip
        # The store contains no folder of this machine.
        assert (
            json.loads(open_captures(path).attributes(index)["truth_scene"])["target"][0]["shape"]["file"]
            == "relief.npy"
        )
    assert not any(str(tmp_path).encode() in file.read_bytes() for file in path.rglob("*") if file.is_file())
    assert cli.main(["generate", "--like", str(path)]) == 2  # the grid is neither beside the store nor here
    assert "--set target.0.shape.file=PATH" in capsys.readouterr().err
    here = ["--set", f"target.0.shape.file={grid}"]
    assert cli.main(["generate", "--like", str(path), *here]) == 0
    assert cli.main(["generate", "--like", str(path), *here, "--set", "rig.camera.rows=3"]) == 2
    assert "which cannot be changed" in capsys.readouterr().err
    with monkeypatch.context() as patch:
        patch.chdir(grid.parent)
        assert beambench.generate(like=path).equal
    np.save(grid, np.arange(16.0).reshape(4, 4) ** 2)
    assert cli.main(["generate", "--like", str(path), *here]) == 2
    told = capsys.readouterr().err
    assert "differs from the one that the capture was made from" in told and "relief.npy" in told
    with pytest.raises(InputError, match="has changed since"):
        beambench.generate(relief, overrides=SMALL, seeds=[1, 2], out=path, resume=True)


def test_the_same_scene_in_another_folder_gives_the_same_bits(relief: Path, tmp_path: Path) -> None:
    import shutil

    from beambench.captures.compare import compare_stores

    shutil.copytree(relief.parent, tmp_path / "elsewhere")
    beambench.generate(relief, overrides=SMALL, out=tmp_path / "a.zarr")
    beambench.generate(tmp_path / "elsewhere" / "relief.json", overrides=SMALL, out=tmp_path / "b.zarr")
    (comparison,) = compare_stores(tmp_path / "a.zarr", tmp_path / "b.zarr")
    assert comparison.equal and not comparison.attributes


def test_a_store_from_before_files_were_recorded_is_repeated(relief: Path, tmp_path: Path) -> None:
    from beambench.captures import open_captures, write

    beambench.generate(relief, overrides=SMALL, out=tmp_path / "now.zarr")
    capture = open_captures(tmp_path / "now.zarr")[0].load()
    made, scene = (json.loads(capture.attrs[name]) for name in ("provenance", "truth_scene"))
    del made["files"]
    scene["target"][0]["shape"]["file"] = str(relief.with_name("relief.npy"))
    old = write(tmp_path / "old.zarr", capture.assign_attrs(provenance=json.dumps(made), truth_scene=json.dumps(scene)))
    (comparison,) = beambench.generate(like=old).comparison
    assert comparison.differing == 0 and set(comparison.attributes) == {"provenance", "truth_scene"}


def test_a_scene_file_reads_nothing_outside_its_folder(
    relief: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    outside = tmp_path / "outside.npy"
    np.save(outside, np.arange(16.0).reshape(4, 4))
    (relief.parent / "link.npy").symlink_to(outside)
    data = json.loads(relief.read_text())

    def told(name: str, *options: str) -> int:
        data["target"][0]["shape"]["file"] = name
        relief.write_text(json.dumps(data))
        return cli.main(["generate", str(relief), *SET, *options, "-o", str(tmp_path / "o.zarr"), "--overwrite"])

    assert told("relief.npy") == 0 and told(str(relief.with_name("relief.npy"))) == 0
    for bad in ("../outside.npy", str(outside), "link.npy", "/etc/passwd", "~/x.npy"):
        assert told(bad) == 2, bad
        assert "of a scene file should lie in its folder" in capsys.readouterr().err
    # A path that the user gives is the user's own, and replaces the file's before that is looked at.
    assert told("../outside.npy", "--set", f"target.0.shape.file={outside}") == 0


def test_an_unknown_name_may_be_that_of_a_data_set(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="scene, suite or data set") as found:
        beambench.generate("gated-2k", plan=True, out=tmp_path / "no")
    assert "gated-1k" in found.value.next_step
