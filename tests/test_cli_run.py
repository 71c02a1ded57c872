"""`beambench run` from the command line, on a suite that takes a second."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest

import beambench
from beambench import cli
from beambench.commands.run import _few

SUITE = """
schema_version = 1
suite = "tiny"
version = 1
title = "Two estimators, one of which does not fit"
scenes = [{ scene = "flat-wall", overrides = { "rig.camera.rows" = 16, "rig.camera.cols" = 16 } }]
conditions = ["matched"]
estimators = ["peak", "weighted-average"]
fidelity = "direct"
rtol = 1.0e-2

[seeds]
dev = [1]
test = [2, 3]

[limits]
time_s = 30.0
memory_bytes = 2147483648
"""


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if importlib.util.find_spec("mitsuba") is None:  # importing it here would let it find a libLLVM of its own
        pytest.skip("Mitsuba is not installed")
    path = tmp_path_factory.mktemp("suite") / "tiny.toml"
    path.write_text(SUITE, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def folder(suite: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "tiny"
    assert cli.main(["run", str(suite), "-o", str(out), "--set", "rig.detector.read_noise_e=3"]) == 0
    return out


def test_it_leaves_tables_captures_and_a_page(folder: Path) -> None:
    for name in ("scores.csv", "scores.parquet", "run.json", "report.html", "speed-accuracy.png", "speed-accuracy.svg"):
        assert (folder / name).stat().st_size > 0
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    assert record["overrides"] == {"rig.detector.read_noise_e": 3}
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "weighted-average" in page and "flat-wall" in page


def test_it_ends_with_best_fastest_and_the_page(
    suite: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:  # resumed, so that nothing is computed again
    words = ["run", str(suite), "-o", str(folder), "--set", "rig.detector.read_noise_e=3", "--resume"]
    assert cli.main(words) == 0
    lines = capsys.readouterr().out.strip().splitlines()
    assert lines[0].startswith("range, ") and any(line.startswith("weighted-average ") for line in lines)  # the table
    best = next(k for k, line in enumerate(lines) if line.startswith("best "))
    assert lines[best + 1].startswith("fastest ")
    assert any(line.startswith("fails") for line in lines)
    assert lines[-1].split() == ["page", str((folder / "report.html").resolve())]


def test_an_existing_folder_is_kept(suite: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (folder / "scores.csv").read_bytes()
    assert cli.main(["run", str(suite), "-o", str(folder)]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert cli.main(["run", str(suite), "-o", str(folder), "--resume"]) == 2, "another setting is another run"
    assert (folder / "scores.csv").read_bytes() == before


def test_a_function_gives_the_same_accuracy(suite: Path, folder: Path, tmp_path: Path) -> None:
    """Config and Python: the accuracy table is the same bytes. Also, `--no-report` writes no report."""
    result = beambench.run(suite, overrides={"rig.detector.read_noise_e": 3}, out=tmp_path / "again", report=False)
    assert result.report is None and not (tmp_path / "again" / "report.html").exists()
    assert (tmp_path / "again" / "accuracy.csv").read_bytes() == (folder / "accuracy.csv").read_bytes()


def test_generate_makes_the_captures_of_a_run(suite: Path, tmp_path: Path, folder: Path) -> None:
    from beambench.captures import open_captures
    from beambench.captures.compare import compare_captures

    made = beambench.generate(suite, overrides={"rig.detector.read_noise_e": 3}, out=tmp_path / "captures")
    assert made.paths == [tmp_path / "captures" / "flat-wall.zarr"]
    by_seed = {int(capture.attrs["seed"]): capture for capture in open_captures(made.paths[0])}
    stores = sorted((folder / "captures").glob("*.zarr"))
    assert len(stores) == len(by_seed) == 2
    for store in stores:
        capture = open_captures(store)[0]
        assert compare_captures(capture, by_seed[int(capture.attrs["seed"])]).equal


def test_estimators_can_be_chosen(suite: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "one"
    assert cli.main(["run", str(suite), "-e", "peak", "--split", "dev", "--no-report", "-o", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["report"] is None and told["closing"][0].startswith("best     peak")
    assert cli.main(["run", str(suite), "-e", "peek", "-o", str(tmp_path / "two")]) == 2
    assert "peak" in capsys.readouterr().err and not (tmp_path / "two").exists()


def test_light_is_kept_apart_on_request(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`generate --truth-components` stores the parts of the light, and repeating the store by its own records finds equal bits."""
    if importlib.util.find_spec("mitsuba") is None:
        pytest.skip("Mitsuba is not installed")
    from beambench.captures import open_captures

    out = tmp_path / "corner.zarr"
    small = ["--set", "rig.camera.rows=4", "--set", "rig.camera.cols=4", "--set", "rig.delays.count=4"]
    asked = ["generate", "flat-wall", *small, "--truth-components", "--rtol", "0.1", "-o"]
    assert cli.main([*asked, str(out), "--fidelity", "full"]) == 0
    capture = open_captures(out)[0]
    for name in ("direct", "interreflection", "single", "multiple"):
        assert capture[f"truth_{name}"].dims == ("slice", "row", "col"), name
    assert json.loads(capture.attrs["provenance"])["arguments"]["truth_components"] is True
    capsys.readouterr()
    assert cli.main(["generate", "--like", str(out)]) == 0
    # Which parts there are depends on the rung: `auto` may take any, and is refused.
    assert cli.main([*asked, str(tmp_path / "direct.zarr")]) == 0
    assert "truth_direct" in open_captures(tmp_path / "direct.zarr")[0]
    capsys.readouterr()
    assert cli.main([*asked, str(tmp_path / "other.zarr"), "--fidelity", "auto"]) == 2
    assert "kept apart" in capsys.readouterr().err


def test_few_warnings_of_a_kind_are_shown(tmp_path: Path) -> None:
    """A dozen alike stood before the table; four are shown in full rather than three and «1 others»."""
    many = [f"ResolutionWarning: {n}" for n in range(12)] + [f"TimeWarning: {n}" for n in range(4)] + ["SlipWarning: 1"]
    shown = _few(many, tmp_path)
    assert shown[:3] == many[:3]
    assert shown[3] == f"ResolutionWarning: 9 others, in {tmp_path / 'run.json'}"
    assert shown[4:] == many[12:]
