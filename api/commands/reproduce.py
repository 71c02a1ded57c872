"""The command `reproduce`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table
from .build import Arguments, View, command, lines

if TYPE_CHECKING:
    from ..benchmarks.reproduce.run import Reproduction

__all__ = ["REPRODUCE"]


def _counts(result: Reproduction) -> dict[str, int]:
    from ..benchmarks.reproduce.rows import VERDICTS

    return {verdict: sum(row.verdict == verdict for row in result.rows) for verdict in VERDICTS}


def _json(result: Reproduction, given: Arguments) -> dict[str, Any]:
    from dataclasses import asdict

    return {
        "out": str(result.out),
        "page": str(result.page),
        "counts": _counts(result),
        "rows": [asdict(row) for row in result.rows],
        "wall_s": result.wall_s,
    }


def _text(result: Reproduction, given: Arguments) -> None:
    print_table(
        ("item", "quantity", "unit", "published", "reproduced", "verdict"),
        [
            (row.item, row.quantity, row.unit, _number(row.published), _number(row.reproduced), row.verdict)
            for row in result.rows
        ],
        right=("published", "reproduced"),
    )
    print_lines(
        "",
        ", ".join(f"{count} {verdict}" for verdict, count in _counts(result).items()),
        f"table    {result.out / 'reproduction.csv'}",
        f"page     {result.page.resolve()}",
    )


def _number(value: float) -> str:
    return "–" if value != value else f"{value:.4g}"


REPRODUCE = command(
    "reproduce",
    "reproduce:reproduce",
    View(_text, _json),
    progress=lines,
    examples="""Examples:
  beambench reproduce
  beambench reproduce --only 001
  beambench reproduce -o reproduction --no-pictures --json""",
)
