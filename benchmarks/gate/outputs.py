"""What a gate leaves for other programs: JUnit XML, annotations of GitHub, and a history that change-point tools read."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from ...scenes.errors import InputError
from ..folders.files import write_text
from .check import ABSTAINS, REGRESSION, Check
from .figures import Figures

__all__ = ["annotation_lines", "append_history", "change_text", "check_record", "in_percent", "junit"]

#: Figures whose changes are differences of rates; those of all others are natural logarithms of ratios.
_RATES = ("failures", "coverage")


def in_percent(figure: str, value: float) -> float:
    """A change, limit or effect of a check in percent, 100 (e^x - 1) of the logarithm x; of rates in percentage points, 100 x."""
    if figure in _RATES:
        return 100.0 * value
    try:
        return 100.0 * math.expm1(value)
    except OverflowError:
        return math.inf


def change_text(check: Check) -> str:
    """The change of a check for people: in percent, or in percentage points for rates."""
    if math.isnan(check.change):
        return "–"
    return f"{in_percent(check.figure, check.change):+.2f} {'points' if check.figure in _RATES else '%'}"


def check_record(check: Check) -> dict[str, Any]:
    """A check for programs: its fields, and `change`, `high` and `effect` in percent beside them (see `in_percent`)."""
    percent = {
        f"{name}_percent": in_percent(check.figure, getattr(check, name)) for name in ("change", "high", "effect")
    }
    return asdict(check) | percent


def _line(check: Check) -> str:
    p = "" if math.isnan(check.p_holm) else f", p {check.p_holm:.2g}"
    return f"{check.figure} of {check.subject}: {change_text(check)}{p}. {check.note}".strip()


def junit(checks: Sequence[Check], suite: str) -> str:
    """JUnit XML: one case per check; a regression is a failure, an abstention is an error, as neither may pass."""
    root = ElementTree.Element("testsuites")
    failures = sum(check.state == REGRESSION for check in checks)
    errors = sum(check.state == ABSTAINS for check in checks)
    group = ElementTree.SubElement(
        root, "testsuite", name=f"beambench gate {suite}", tests=str(len(checks)), failures=str(failures),
        errors=str(errors), skipped="0",
    )  # fmt: skip
    for check in checks:
        case = ElementTree.SubElement(group, "testcase", classname=f"beambench.gate.{check.figure}", name=check.subject)
        if check.state == REGRESSION:
            ElementTree.SubElement(case, "failure", message=_line(check), type="regression")
        elif check.state == ABSTAINS:
            ElementTree.SubElement(case, "error", message=_line(check), type="abstains")
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def annotation_lines(checks: Sequence[Check]) -> list[str]:
    """Workflow commands of GitHub Actions: an error per regression, a warning per abstention."""
    lines = []
    for check in checks:
        if check.state in (REGRESSION, ABSTAINS):
            level, word = ("error", "regression") if check.state == REGRESSION else ("warning", "abstains")
            lines.append(
                f"::{level} title={_escaped(f'beambench gate: {word}', inside=True)}::{_escaped(_line(check))}"
            )
    return lines


def _escaped(text: str, *, inside: bool = False) -> str:
    """As GitHub asks: %, carriage return and line feed, and in a property also : and comma."""
    for character in ("%", "\r", "\n", *((":", ",") if inside else ())):
        text = text.replace(character, f"%{ord(character):02X}")
    return text


def append_history(path: Path, figures: Figures, time: str, commit: str) -> None:
    """Add one line to a CSV history: time, commit, and per estimator and quantity the rmse over all cells and the CPU time.

    The columns are those that Apache Otava's CSV importer needs: a time column, an attribute and one number per metric. A file
    with other columns is refused, as a metric must mean the same in every line.

    Raises:
        InputError: the file has other columns.
    """
    metrics = _metrics(figures)
    header = ["time", "commit", *metrics]
    old = ""
    if path.exists():
        old = path.read_text(encoding="utf-8")
        found = next(csv.reader(io.StringIO(old)), [])
        if found != header:
            odd = sorted({*found} ^ {*header})[:3]
            raise InputError(
                "The history has other columns than this run has figures.", where=str(path), value=", ".join(odd),
                allowed="runs of one suite with the same estimators", next_step="begin a new file with --history",
            )  # fmt: skip
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    if not old:
        writer.writerow(header)
    writer.writerow([time, commit or "unknown", *(f"{value:.9g}" for value in metrics.values())])
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, (old if not old or old.endswith("\n") else old + os.linesep) + buffer.getvalue())


def _metrics(figures: Figures) -> dict[str, float]:
    """{column: number}: root of the mean square over cells, and the median CPU time over cells, s."""
    squares: dict[str, list[float]] = {}
    times: dict[str, dict[tuple[str, ...], float]] = {}
    for ((label, _, quantity), cell), row in sorted(figures.rows.items()):
        squares.setdefault(f"{label}.{quantity}.{cell[6]}.rmse_full", []).append(row.rmse_full**2)
        times.setdefault(f"{label}.cpu_s", {})[cell] = row.cpu_s
    found = {name: math.sqrt(sum(values) / len(values)) for name, values in squares.items()}
    for name, by_cell in times.items():
        known = sorted(value for value in by_cell.values() if value == value)
        found[name] = known[len(known) // 2] if known else math.nan
    return found
