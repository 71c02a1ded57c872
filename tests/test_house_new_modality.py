"""A modality enters by one record per floor and one line per table: docs/new-modality.md, followed word for word in a copy."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TABLES = {
    "RIGS": "scenes/rigs/__init__.py",
    "LAYOUTS": "captures/layouts/__init__.py",
    "MODELS": "generator/models.py",
    "BUILTIN": "estimators/builtin.py",
    "JUDGES": "benchmarks/judges/__init__.py",
}
FLOORS = ("optics", "scenes", "captures", "generator", "estimators", "benchmarks", "api", "typings")


def page(project: Path) -> str:
    return (project / "docs" / "new-modality.md").read_text(encoding="utf-8")


def files_of_page(text: str) -> dict[str, str]:
    """Path -> content of every file that the page shows."""
    return dict(re.findall(r"^`([\w/.-]+)`:\n\n```\w+\n(.*?)```$", text, re.DOTALL | re.MULTILINE))


def lines_of_page(text: str) -> dict[str, str]:
    """Table -> the line that the page adds to it."""
    return dict(re.findall(r"^In `(\w+)`: `(.*)`$", text, re.MULTILINE))


@pytest.fixture(scope="module")
def copy(project: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The project with the page's modality in it."""
    folder = tmp_path_factory.mktemp("project")
    for floor in FLOORS:
        skip = shutil.ignore_patterns("__pycache__", "*.pyc")
        shutil.copytree(project / floor, folder / floor, symlinks=True, ignore=skip)
    text = page(project)
    for name, content in files_of_page(text).items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        assert not path.exists(), f"{name} is there already: a new modality edits tables only"
        path.write_text(content, encoding="utf-8")
    for table, line in lines_of_page(text).items():
        path = folder / TABLES[table]
        source = path.read_text(encoding="utf-8")
        edited, count = re.subn(
            rf"^({table}: dict\[str, str\] = \{{\n)", rf"\1    {line}\n", source, flags=re.MULTILINE
        )
        if table == "RIGS":  # a rig that gives no kind is of the first: a new kind goes last
            edited, count = re.subn(
                rf"^({table}: dict\[str, str\] = \{{\n(?:    .*\n)*)", rf"\1    {line}\n", source, flags=re.MULTILINE
            )
        assert count == 1, f"{TABLES[table]} holds no table {table}"
        path.write_text(edited, encoding="utf-8")
    return folder


def beambench(copy: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The command line of the copy."""
    environment = os.environ | {"PYTHONPATH": str(copy / "typings")}
    return subprocess.run(
        [sys.executable, "-m", "beambench", *arguments], cwd=copy, env=environment, capture_output=True, text=True,
        timeout=300, check=False,
    )  # fmt: skip


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_the_page_has_one_record_per_floor(project: Path) -> None:
    text = page(project)
    assert set(lines_of_page(text)) == set(TABLES)
    made = [name for name in files_of_page(text) if name.endswith(".py") and not name.endswith("__init__.py")]
    assert len(made) == 6 and all("echo_sounder" in name for name in made)  # the judge's laws are a file of their own
    assert not [name for name in files_of_page(text) if (project / name).exists()]


def test_a_capture_is_generated_estimated_and_scored(copy: Path) -> None:
    done = beambench(copy, "generate", "sounder.toml", "--seeds", "7", "-o", "sounder.zarr")
    assert done.returncode == 0, done.stderr
    done = beambench(copy, "estimate", "sounder.zarr", "-e", "sounder-matched", "-o", "estimates")
    assert done.returncode == 0, done.stderr
    done = beambench(copy, "score", "sounder.zarr", "estimates", "-o", "scores")
    assert done.returncode == 0, done.stderr
    (row,) = rows(copy / "scores" / "scores.csv")
    assert (row["modality"], row["stage"], row["quantity"], row["unit"]) == ("echo_sounder", "range", "range", "m")
    assert row["n"] == "400" and float(row["coverage"]) == 1.0
    # 400 pings: the efficiency of the least squares is 1 within 3 √(2/400).
    assert abs(float(row["efficiency"]) - 1.0) < 0.21 and abs(float(row["z_rms"]) - 1.0) < 0.11


def test_its_estimator_is_checked_against_the_laws(copy: Path) -> None:
    done = beambench(copy, "estimators", "check", "sounder-matched", "--json")
    assert done.returncode == 0, done.stdout + done.stderr
    laws = {row["law"] for row in json.loads(done.stdout)["laws"]}
    assert {"shift: a later zero of time, farther ranges", "pings do not depend on their order"} <= laws
    assert len(laws) == 21 and not any(law.startswith("gain") for law in laws)


def test_an_author_gets_a_working_package_for_it(copy: Path) -> None:
    done = beambench(copy, "estimators", "new", "my-sounder", "--stage", "echo_sounder", "-o", "my-sounder")
    assert done.returncode == 0, done.stderr
    text = (copy / "my-sounder" / "beambench_my_sounder.py").read_text(encoding="utf-8")
    assert '@estimator("echo_sounder"' in text and "def my_sounder(" in text


def test_a_run_has_its_report_and_names_its_elements(copy: Path) -> None:
    done = beambench(copy, "run", "sounder-suite.toml", "-o", "run")
    assert done.returncode == 0, done.stderr
    table = rows(copy / "run" / "scores.csv")
    assert len(table) == 12 and {row["status"] for row in table} == {"ok"}
    text = (copy / "run" / "report.html").read_text(encoding="utf-8")
    assert "ping" in text and "pixel" not in re.sub(r"<(script|style).*?</\1>", "", text, flags=re.DOTALL)


def test_a_sweep_finds_where_it_breaks_down(copy: Path) -> None:
    done = beambench(copy, "sweep", "sounder-suite.toml", "-o", "sweep")
    assert done.returncode == 0, done.stderr
    (row,) = rows(copy / "sweep" / "breakdown.csv")
    # Below height = 4 noise the estimator refuses: 36000 · .5/9 = 2000 DN is 100 noise, so at .04 of the light.
    assert row["modality"] == "echo_sounder" and 0.02 < float(row["level10"]) < 0.06 and row["mode"] == "refusal"


def test_other_estimators_refuse_it_and_other_verbs_know_it(copy: Path) -> None:
    # A store of its own: another worker may run the test that makes the first.
    done = beambench(copy, "generate", "sounder.toml", "--seeds", "8", "-o", "other.zarr")
    assert done.returncode == 0, done.stderr
    done = beambench(copy, "estimate", "other.zarr", "-e", "poisson-ml", "-o", "others")
    assert done.returncode == 2 and "reads captures of this modality" in done.stderr
    listed = beambench(copy, "estimators", "list", "--json")
    assert listed.returncode == 0 and '"echo_sounder"' in listed.stdout
    refused = beambench(copy, "generate", "sounder.toml", "--fidelity", "full", "-o", "x.zarr")
    assert refused.returncode == 2 and "not built for echo_sounder" in refused.stderr
