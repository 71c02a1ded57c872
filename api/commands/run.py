"""The commands `run` and `report`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table
from .build import Arguments, View, command

if TYPE_CHECKING:
    import pandas as pd

    from ..benchmarks.run import RunResult

__all__ = ["REPORT", "RUN", "closing_of"]

#: Warnings of one kind that the terminal shows.
_OF_A_KIND = 3


def closing_of(folder: str | Path, scores: pd.DataFrame | None = None) -> list[str]:
    """The last lines of a run in the terminal; `scores`: its table, where it was read already."""
    from ..benchmarks.report.ranking import read_pairs
    from ..benchmarks.report.text import closing_lines
    from ..benchmarks.scores.tables import read_scores

    return closing_lines(read_scores(folder) if scores is None else scores, read_pairs(Path(folder)))


def _run_json(result: RunResult, given: Arguments) -> dict[str, Any]:
    from ..benchmarks.statistics.skips import skips_of

    return {
        "out": str(result.out),
        "report": str(result.report) if result.report else None,
        "rows": len(result.rows),
        "closing": closing_of(result.out),
        "rungs": result.rungs,
        "advice": result.advice,
        "warnings": result.warnings,
        "failures": result.failures,
        "skipped": skips_of(result.rows),
        "wall_s": result.wall_s,
    }


def _run_text(result: RunResult, given: Arguments) -> None:
    from ..benchmarks.rungs import rung_lines
    from ..benchmarks.scores.tables import read_scores
    from ..generator.effect import LEFT_OUT

    # One line of advice stands for all warnings of what a rung leaves out.
    told = [warning for warning in result.warnings if not (result.advice and LEFT_OUT in warning)]
    for line in _few(told, result.out):
        print(f"warning: {line}", file=sys.stderr)
    if result.advice:
        print(f"advice: {result.advice}", file=sys.stderr)
    print_lines(*(f"rung     {line}" for line in rung_lines(result.rungs)))
    scores = read_scores(result.out)
    _print_tables(scores)
    print_lines("", *closing_of(result.out, scores), f"tables   {result.out / 'scores.csv'}")
    if result.report:
        print_lines(f"page     {result.report.resolve()}")


def _few(warnings: list[str], out: Path) -> list[str]:
    """The first warnings of each kind, and how many others there are: a table of results would scroll out of sight."""
    kinds: dict[str, list[str]] = {}
    for warning in warnings:
        kinds.setdefault(warning.partition(":")[0], []).append(warning)
    lines = []
    for kind, held in kinds.items():
        lines += held if len(held) <= _OF_A_KIND + 1 else held[:_OF_A_KIND]
        if len(held) > _OF_A_KIND + 1:
            lines.append(f"{kind}: {len(held) - _OF_A_KIND} others, in {out / 'run.json'}")
    return lines


def _print_tables(scores: pd.DataFrame) -> None:
    """The errors of every estimator, one table for each quantity."""
    from ..benchmarks.report.terminal_tables import terminal_tables

    for title, heads, rows in terminal_tables(scores):
        print_lines("", title)
        print_table(heads, rows, right=heads[1:])


def _run_code(result: RunResult) -> int:
    """1 where no estimator gave a result: all failed, or were skipped."""
    return int(bool(result.rows) and not any(row["status"] == "ok" for row in result.rows))


RUN = command(
    "run",
    "run:run",
    View(_run_text, _run_json, _run_code),
    examples="""Examples:
  beambench run quickstart
  beambench run quickstart -e poisson-ml -e 'weighted-average[background=subtract]'
  beambench run my-suite.toml --set seeds.test=[1,2,3] --set rig.detector.read_noise_e=5 -o results
  beambench run quickstart -o results --resume
  beambench run gated --sealed challenge.key -e my-method

Exit code 1 where every estimator failed or was skipped; one that fails beside others is a row of the table.""",
)


def _report_json(page: Path, given: Arguments) -> dict[str, Any]:
    return {"report": str(page), "closing": closing_of(given["folder"])}


def _report_text(page: Path, given: Arguments) -> None:
    print_lines(*closing_of(given["folder"]), f"page     {page.resolve()}")


REPORT = command(
    "report",
    "report:report",
    View(_report_text, _report_json),
    examples="""Example:
  beambench report beambench-runs/quickstart-20260102-030405""",
)
