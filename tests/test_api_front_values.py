"""Numbers on the command line, closed output streams, and the checks of `doctor`."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.metadata import requires

import pytest

from beambench import cli
from beambench.console import score_records, whole
from beambench.health import packages


@pytest.mark.parametrize(
    "words",
    [
        ["break", "peak", "--budget", "16.7"],
        ["break", "peak", "--seed", "1.5"],
        ["sweep", "quickstart", "--depth", "1.0"],
        ["fidelity", "--scenes", "2.5"],
        ["scenes", "preview", "flat-wall", "--size", "64.5"],
        ["generate", "flat-wall", "--seeds", "1.5", "--plan"],
        ["estimate", "nowhere.zarr", "-e", "peak", "--memory-limit-bytes", "8.5e9"],
        ["estimators", "train", "--data", "x", "--out", "y.npz", "--units", "nan"],
    ],
)
def test_a_fraction_is_never_rounded_to_a_whole_number(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(words) == 2
    told = capsys.readouterr().err
    assert "whole number" in told and words[-1 if words[-1] != "--plan" else -2] in told


def test_whole_numbers() -> None:
    assert whole(int, ["12"]) == 12 and whole(int, ["-1_000"]) == -1000 and whole(int, ["8e9"]) == 8_000_000_000
    assert whole(list[int], ["1", "2"]) == [1, 2]
    assert whole(list[int] | None, ["3"]) == [3]
    for text in ("1.0", "", "x", "1e-1", "0x10", "1" * 5000, "9e999"):
        with pytest.raises(ValueError, match="whole number"):
            whole(int, [text])


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_closed_streams_are_no_crash(closed: str) -> None:
    command = f"exec {sys.executable} -m beambench scenes list {closed}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "Traceback" not in done.stderr
    assert ("flat-wall" in done.stdout) == (closed == "2>&-")


def test_scores_are_printed_as_what_they_are() -> None:
    rows = [{"seed": 3.0, "n": 4096.0, "level": "", "level2": "0.5", "rmse": 1.0, "peak_bytes": float("nan")}]
    (row,) = score_records(rows)
    assert json.dumps([row["seed"], row["n"], row["level"], row["level2"], row["rmse"]]) == "[3, 4096, null, 0.5, 1.0]"
    assert rows[0]["seed"] == 3.0 and row["peak_bytes"] != row["peak_bytes"]


def test_the_doctor_looks_at_all_that_the_package_needs() -> None:
    needs = packages.needs_of_package()
    assert needs is not None and len(needs[""]) > 15
    names = {one.name for found in needs.values() for one in found}
    told = {
        text.split(";")[0].split(">")[0].split("<")[0].split("=")[0].strip() for text in requires("beambench") or []
    }
    assert names == told  # on this platform nothing is left out


def test_the_doctor_tells_a_version_that_is_too_old(monkeypatch: pytest.MonkeyPatch) -> None:
    real = packages.version_of
    monkeypatch.setattr(packages, "version_of", lambda name: "1.26.0" if name == "numpy" else real(name))
    (numpy,) = [finding for finding in packages.packages() if finding.name == "numpy"]
    assert numpy.state == "broken" and "1.26.0" in numpy.found and ">=2" in numpy.advice
