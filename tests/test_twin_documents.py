"""docs/twin.md: its commands, as they stand there, with fewer draws and estimators."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from beambench import cli
from beambench.benchmarks.twin.gated_clauses import CLAUSES

PAGE = Path(__file__).parents[1] / "docs" / "twin.md"


def test_the_commands_of_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Record, calibrate, compare: in this order, with exit code 0, though the recording holds edges. The run of the suite is
    `test_benchmarks_mismatch`'s, and certificates of other rigs are `test_twin_modalities`'s."""
    lines = re.findall(r"^    beambench (.*)$", PAGE.read_text(encoding="utf-8"), re.M)
    assert [line.split()[0] for line in lines] == ["record", "calibrate", "twin", *["twin"] * 3, "run"]
    monkeypatch.chdir(tmp_path)
    for line in lines[:3]:
        words = shlex.split(line)
        words += ["--draws", "10", "--estimator", "peak"] if words[0] == "twin" else []
        assert cli.main(words) == 0, line
    assert (tmp_path / "certificate" / "certificate.html").is_file()


def test_every_clause_says_what_it_cannot_show_and_why_its_tolerance() -> None:
    assert len({clause.name for clause in CLAUSES}) == len(CLAUSES) >= 15
    for clause in CLAUSES:
        assert clause.cannot and clause.why and clause.physics and clause.unit
        assert clause.above or clause.relative > 0 or clause.absolute > 0
