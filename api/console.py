"""What commands print: tables and lines on standard output for people, JSON with `--json` for programs."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NoReturn

from cyclopts import Parameter
from rich.console import Console

__all__ = [
    "Common", "Estimators", "Out", "Overrides", "Overwrite", "Report", "Resume", "Split", "print_json", "print_lines",
    "print_table", "size_text", "terminal",
]  # fmt: skip


@Parameter(name="*")
@dataclass(frozen=True)
class Common:
    """Options of every command."""

    json: Annotated[
        bool, Parameter(negative="", show_default=False, help="Print one JSON document instead of text.")
    ] = False
    debug: Annotated[bool, Parameter(negative="", show_default=False, help="Show the traceback of an error.")] = False


Overrides = Annotated[
    list[str] | None,
    Parameter(
        name="--set",
        negative="",
        help="PATH=VALUE, repeatable: change any value of the spec before it is validated. VALUE is JSON; "
        "what is no JSON is text.",
    ),
]
Out = Annotated[
    str | None, Parameter(name=["--out", "-o"], help="Where to write; ./beambench-runs/<name>-<time> if not given.")
]


#: Options that several commands share: one name, one meaning, one line of help.
Estimators = Annotated[
    list[str] | None,
    Parameter(
        name=["--estimators", "-e"],
        negative="",
        help="Take this estimator instead of the suite's: name or name[key=value,...]; repeatable.",
    ),
]
Split = Annotated[
    Literal["dev", "test"], Parameter(help="Which of the suite's seeds to use: tune on dev, publish test.")
]
Resume = Annotated[bool, Parameter(negative="", show_default=False, help="Go on with what was interrupted in --out.")]
Overwrite = Annotated[bool, Parameter(negative="", show_default=False, help="Replace what is in --out.")]
Report = Annotated[bool, Parameter(show_default=False, help="Write the page report.html.")]


class _Terminal(Console):
    def on_broken_pipe(self) -> NoReturn:
        """Rich would exit with 1; a reader who has seen enough is no failure."""
        raise BrokenPipeError


def terminal(*, stderr: bool = False, width: int = 160) -> Console:
    """A console as wide as its terminal; `width` columns where it writes elsewhere."""
    stream = sys.stderr if stderr else sys.stdout
    wide = None if stream.isatty() else width
    return _Terminal(file=stream, width=wide, highlight=False, emoji=False, markup=False, soft_wrap=False)


def print_lines(*lines: str) -> None:
    """Plain lines."""
    for line in lines:
        print(line)


def print_table(
    columns: Sequence[str], rows: Iterable[Sequence[str]], *, right: Iterable[str] = (), title: str = ""
) -> None:
    """A table without frames; the columns in `right` are numbers."""
    from rich.table import Table
    from rich.text import Text

    numbers = set(right)
    table = Table(
        box=None, pad_edge=False, header_style="bold", title=title or None, title_justify="left", padding=(0, 2, 0, 0)
    )
    for name in columns:
        table.add_column(name, justify="right" if name in numbers else "left", overflow="fold", no_wrap=name in numbers)
    for row in rows:
        # Text, not markup: labels hold square brackets, and names come from strangers.
        table.add_row(*(Text(cell) for cell in row))
    terminal().print(table)


def print_json(value: Any) -> None:
    """One JSON document; NaN and infinity, which JSON lacks, become null."""
    print(json.dumps(_plain(value), indent=2, allow_nan=False, ensure_ascii=False, default=str))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "item") and not isinstance(value, str | bytes) and getattr(value, "size", 1) == 1:
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def size_text(count: float) -> str:
    """Bytes in words."""
    for unit in ("B", "KiB", "MiB", "GiB"):
        if count < 1024 or unit == "GiB":
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1024
    raise AssertionError
