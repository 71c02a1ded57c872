"""docs/twin.md: its commands, as they stand there, with a smaller camera."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from beambench import cli
from beambench.benchmarks.twin.gated_clauses import CLAUSES

PAGE = Path(__file__).parents[1] / "docs" / "twin.md"
SMALL = [
    "rig.camera.rows=12", "rig.camera.cols=12", "rig.camera.pixel_pitch_m=70e-6", "rig.laser.pulse_energy_j=1e-7",
    "rig.delays.step_s=0.25e-9", "rig.delays.count=24",
]  # fmt: skip


def test_the_commands_of_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Record, calibrate, compare: in this order, with exit code 0. The run of the suite is `test_benchmarks_mismatch`'s."""
    lines = re.findall(r"^    beambench (.*)$", PAGE.read_text(encoding="utf-8"), re.M)
    assert [line.split()[0] for line in lines] == ["generate", "calibrate", "twin", "run"]
    monkeypatch.chdir(tmp_path)
    for line in lines[:3]:
        words = shlex.split(line)
        words += [word for change in SMALL for word in ("--set", change)] if words[0] == "generate" else []
        words += ["--draws", "10", "--estimator", "peak"] if words[0] == "twin" else []
        assert cli.main(words) == 0, line
    assert (tmp_path / "certificate" / "certificate.html").is_file()


def test_every_clause_says_what_it_cannot_show_and_why_its_tolerance() -> None:
    assert len({clause.name for clause in CLAUSES}) == len(CLAUSES) >= 15
    for clause in CLAUSES:
        assert clause.cannot and clause.why and clause.physics and clause.unit
        assert clause.above or clause.relative > 0 or clause.absolute > 0
