"""What a gate leaves for other programs: JUnit, annotations, a history; and the command's exit codes."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from xml.etree import ElementTree

import pytest

from beambench.benchmarks.gate.check import ABSTAINS, PASS, REGRESSION, Check, decided, equal, measured
from beambench.benchmarks.gate.figures import read_figures
from beambench.benchmarks.gate.gate import GateResult
from beambench.benchmarks.gate.outputs import annotation_lines, append_history, check_record, junit
from beambench.benchmarks.scores.inputs import write_inputs
from beambench.cli import main
from beambench.commands.gate import _text as gate_text
from beambench.scenes.errors import InputError

from ._api_fixtures import make_run

CHECKS = [
    Check("accuracy", "a · range · matched", 0.08, 0.1, 0.05, 1e-5, 1e-4, REGRESSION, "10 cells"),
    Check("speed", "a on wall", state=ABSTAINS, note="A/A fails: 50 %, twice\nover"),
    Check("coverage", "a · range · matched", 0.0, 0.0, 0.01, state=PASS),
]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A synthetic run that states what its estimators read."""
    folder = make_run(tmp_path / "run", pictures=False)
    figures = read_figures(folder)
    names = ("scene", "stress", "level", "stress2", "level2", "seed", "condition")
    write_inputs(folder, [dict(zip(names, cell, strict=True)) | {"sha256": "-".join(cell)} for cell in figures.inputs])
    return folder


def test_junit_has_a_failure_for_a_regression_and_an_error_for_an_abstention() -> None:
    root = ElementTree.fromstring(junit(CHECKS, "made-up").partition("\n")[2])
    suite = root.find("testsuite")
    assert suite is not None and (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("3", "1", "1")
    failure = suite.find("testcase/failure")
    assert failure is not None and "+8.33 %" in str(failure.get("message"))


def test_json_states_each_change_in_percent_beside_its_logarithm() -> None:
    speed, rate, none = (
        check_record(Check(figure, "a", change, change, effect))
        for figure, change, effect in (
            ("speed", math.log(4.2067), math.log(1.1)), ("failures", 0.02, 0.01), ("memory", math.nan, 1e6)
        )
    )  # fmt: skip
    assert speed["change"] == pytest.approx(1.4367, abs=1e-4), "as before: a natural logarithm"
    assert speed["change_percent"] == speed["high_percent"] == pytest.approx(320.67)
    assert speed["effect_percent"] == pytest.approx(10) and rate["change_percent"] == pytest.approx(2)
    assert math.isnan(none["change_percent"]) and none["effect_percent"] == math.inf


@pytest.mark.parametrize("number", [3, 40])
def test_the_table_shows_all_that_its_summary_counts(number: int, capsys: pytest.CaptureFixture[str]) -> None:
    plain = [equal(figure, f"estimator-{k}", 0.1) for figure in ("accuracy", "memory") for k in range(number)]
    checks = decided([measured("speed", "slow on wall", 0.01, 0.001, 7, 0.1), *plain])
    gate_text(GateResult(PASS, checks), {})
    out = capsys.readouterr().out
    assert f"{1 + 2 * number} pass" in out and "slow on wall" in out
    if number == 3:
        assert all(out.count(f"estimator-{k}") == 2 for k in range(number))
    else:
        assert out.count(f"{number} checks") == 2 and "estimator-" not in out


def test_annotations_are_one_line_each_and_escaped() -> None:
    lines = annotation_lines(CHECKS)
    assert lines[0].startswith("::error title=beambench gate%3A regression::accuracy of a")
    assert lines[1].startswith("::warning ") and "50 %25, twice%0Aover" in lines[1]
    assert len(lines) == 2 and not any("\n" in line for line in lines)


def test_a_history_has_one_line_per_gate_and_refuses_other_columns(run: Path, tmp_path: Path) -> None:
    path = tmp_path / "history.csv"
    figures = read_figures(run)
    append_history(path, figures, "2026-01-01T00:00:00+00:00", "abc")
    append_history(path, figures, "2026-01-02T00:00:00+00:00", "def")
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["commit"] for row in rows] == ["abc", "def"]
    assert float(rows[0]["peak.range.matched.rmse_full"]) > 0 and float(rows[0]["peak.cpu_s"]) > 0
    path.write_text("time,commit,other\n")
    with pytest.raises(InputError, match="other columns"):
        append_history(path, figures, "2026-01-03T00:00:00+00:00", "ghi")


def test_the_command_passes_turns_red_and_abstains(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    baseline = str(tmp_path / "baseline.json")
    base = ["gate", str(run), "--baseline", baseline]
    assert main(base) == 2, "no baseline"
    assert main([*base, "--update"]) == 2, "no reason"
    assert main([*base, "--update", "--why", "first", "--who", "me"]) == 0
    assert main(base) == 0
    assert "baseline by me" in capsys.readouterr().out
    data = Path(baseline).read_text()
    worse = json.loads(data)
    for row in worse["rows"]:
        if row[1] == "peak" and row[7]:
            row[7] = row[7] / 1.5
    Path(baseline).write_text(json.dumps(worse))
    assert main([*base, "--figures", "accuracy"]) in (1, 3)
    assert "::" in capsys.readouterr().out
    for row in worse["rows"]:
        if row[1] == "parabola":
            row[-1] = "ok"
    Path(baseline).write_text(json.dumps(worse))
    junit_file = tmp_path / "gate.xml"
    assert main([*base, "--junit", str(junit_file), "--json"]) == 1, "an estimator that answered crashes now"
    assert json.loads(capsys.readouterr().out)["verdict"] == "regression"
    assert "crash" in junit_file.read_text()
    cells = json.loads(data)
    cells["cells"] = [[*cell[:-1], "other"] for cell in cells["cells"]]
    Path(baseline).write_text(json.dumps(cells))
    assert main([*base, "--figures", "accuracy"]) == 3, "other captures"


def test_bad_input_is_refused(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = ["gate", str(run), "--baseline", str(run)]
    for more, word in (
        (["--figures", "beauty"], "beauty"),
        (["--figures", "speed"], "--against"),
        (["--new", "peak"], "--old"),
        (["--new", "peak", "--old", "nobody"], "nobody"),
        (["--starts", "2"], "--starts"),
        (["--effects", "speed=0"], "speed"),
        (["--effects", "beauty=1"], "beauty"),
        (["--effects", "memory"], "memory"),
    ):
        assert main([*base, *more]) == 2, more
        assert word in capsys.readouterr().err


def test_two_labels_of_one_run_are_compared(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = ["gate", str(run), "--baseline", str(run), "--figures", "accuracy"]
    assert main([*base, "--new", "peak", "--old", "poisson-ml", "--json"]) == 1
    (name,) = {check["subject"].split(" · ")[0] for check in json.loads(capsys.readouterr().out)["checks"]}
    assert name == "peak against poisson-ml"
    assert main([*base, "--new", "poisson-ml", "--old", "peak"]) == 0, "six times better is no regression"


def test_another_suite_is_refused(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    baseline = tmp_path / "b.json"
    assert main(["gate", str(run), "--baseline", str(baseline), "--update", "--why", "x"]) == 0
    baseline.write_text(baseline.read_text().replace('"suite": "made-up"', '"suite": "other"'))
    assert main(["gate", str(run), "--baseline", str(baseline)]) == 2
    told = capsys.readouterr().err
    assert "another suite" in told and "make a run of other" in told and "first baseline of made-up" in told


def test_a_folder_without_a_run_is_answered_by_the_run_to_make(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    baseline, empty, other, begun = (tmp_path / name for name in ("b.json", "empty", "other", "begun"))
    assert main(["gate", str(run), "--baseline", str(baseline), "--update", "--why", "x"]) == 0
    empty.mkdir()
    other.mkdir()
    (other / "notes.txt").write_text("mine")
    begun.mkdir()
    (begun / "journal.jsonl").write_text('{"suite_hash": "h", "verb": "run"}\n')
    for suite, folder, step in (
        ("made-up", empty, f"suite made-up in it: beambench run SUITE.toml -o {empty}"),
        ("quickstart", empty, f"suite quickstart in it: beambench run quickstart -o {empty}"),
        ("quickstart", tmp_path / "none", f"beambench run quickstart -o {tmp_path / 'none'}"),
        ("quickstart", other, "in a new folder: beambench run quickstart -o NEW_FOLDER"),
        ("quickstart", begun, f"finish it: beambench run quickstart -o {begun} --resume"),
    ):
        kept = tmp_path / "kept.json"
        kept.write_text(baseline.read_text().replace('"suite": "made-up"', f'"suite": "{suite}"'))
        assert main(["gate", str(folder), "--baseline", str(kept)]) == 2
        assert step in capsys.readouterr().err
    assert main(["gate", str(empty), "--baseline", str(tmp_path / "new.json"), "--update", "--why", "x"]) == 2
    assert f"make a run in it: beambench run SUITE.toml -o {empty}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "what"), [(b"", "an empty file"), (b"<<<<<<< HEAD\n{", "no JSON"), (b"\xff\xfe", "no JSON")]
)
def test_a_baseline_that_cannot_be_read_says_what_to_do(
    content: bytes, what: str, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    baseline = tmp_path / "b.json"
    baseline.write_bytes(content)
    assert main(["gate", str(run), "--baseline", str(baseline)]) == 2
    told = capsys.readouterr().err
    assert what in told and "version control" in told and f"--baseline {baseline} --update --why" in told


def test_a_baseline_that_the_system_does_not_give_has_a_next_step(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["gate", str(run), "--baseline", str(run / "run.json" / "b.json")]) == 2
    assert "give another --baseline" in capsys.readouterr().err
