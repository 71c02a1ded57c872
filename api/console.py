"""Output of commands: tables and lines for people, JSON for programs (`--json`); and whole numbers of options."""

from __future__ import annotations

import json
import math
import os
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NoReturn, get_args, get_origin

from cyclopts import Parameter
from rich.console import Console

from .scenes.plain_text import plain_text

__all__ = [
    "Common", "open_streams", "print_json", "print_lines", "print_table", "score_records", "size_text", "terminal",
    "share", "whole",
]  # fmt: skip


@Parameter(name="*")
@dataclass(frozen=True)
class Common:
    """Options of every command."""

    json: Annotated[
        bool, Parameter(negative="", show_default=False, help="Print one JSON document instead of text.")
    ] = False
    debug: Annotated[bool, Parameter(negative="", show_default=False, help="Show the traceback of an error.")] = False


def whole(type_: Any, tokens: Sequence[Any]) -> Any:
    """Whole numbers of an option, as cyclopts converts them: a list where it may be given more than once, or as 1,2,3.

    A fraction is refused, not rounded: nobody would notice a seed or a budget other than the given one. Digits with an
    exponent (8e9) are accepted if they make a whole number.

    Raises:
        ValueError: It is not a whole number; cyclopts turns this into its own error.
    """
    several = any(get_origin(part) in (list, tuple, set) for part in (type_, *get_args(type_)))
    texts = [str(getattr(token, "value", token)) for token in tokens]
    numbers = [_whole(part) for text in texts for part in (text.split(",") if several else [text])]
    return numbers if several else numbers[0]


def _whole(text: str) -> int:
    if re.fullmatch(r"[+-]?\d+(_\d+)*", text.strip(), re.ASCII) and len(text) <= _MOST_DIGITS:
        return int(text)
    found = re.fullmatch(r"([+-]?\d+)[eE]\+?(\d{1,2})", text.strip(), re.ASCII)
    if found and len(text) <= _MOST_DIGITS:
        return int(found[1] + "0" * int(found[2]))
    raise ValueError(f'"{text}" is not a whole number; fractions are not rounded')


def share(type_: Any, tokens: Sequence[Any]) -> Any:
    """A fraction, 0.05 or 5%, or one of the words that the option takes.

    Raises:
        ValueError: Neither; cyclopts turns this into its own error.
    """
    text = str(getattr(tokens[0], "value", tokens[0])).strip()
    words = [word for part in (type_, *get_args(type_)) if get_origin(part) is Literal for word in get_args(part)]
    if text in words:
        return text
    try:
        return float(text[:-1]) / 100.0 if text.endswith("%") else float(text)
    except ValueError:
        raise ValueError(f'"{text}" is not a fraction: ' + ", ".join(["0.05", "5%", *words])) from None


#: More digits than any number here needs; Python itself refuses 4300.
_MOST_DIGITS = 40


def open_streams() -> None:
    """Connect standard output and error to the null device if they were closed (`>&-`).

    Called before any file is opened: otherwise the first one would get the free number 1, and libraries would print into
    it.
    """
    for name, number in (("stdout", 1), ("stderr", 2)):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            if nowhere != number:
                os.dup2(nowhere, number)
                os.close(nowhere)
            stream = open(number, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)


class _Terminal(Console):
    def on_broken_pipe(self) -> NoReturn:
        """Rich would exit with 1, but a reader that stops early is not a failure."""
        raise BrokenPipeError


def terminal(*, stderr: bool = False, width: int = 160) -> Console:
    """A console as wide as its terminal, or of `width` columns if it does not write to a terminal."""
    open_streams()
    stream = sys.stderr if stderr else sys.stdout
    wide = None if stream.isatty() else width
    return _Terminal(file=stream, width=wide, highlight=False, emoji=False, markup=False, soft_wrap=False)


def print_lines(*lines: str) -> None:
    """Print plain lines."""
    for line in lines:
        print(plain_text(line))


def print_table(
    columns: Sequence[str], rows: Iterable[Sequence[str]], *, right: Iterable[str] = (), title: str = ""
) -> None:
    """Print a table without frames; the columns in `right` hold numbers."""
    from rich.table import Table
    from rich.text import Text

    numbers = set(right)
    table = Table(
        box=None, pad_edge=False, header_style="bold", title=title or None, title_justify="left", padding=(0, 2, 0, 0)
    )
    for name in columns:
        table.add_column(name, justify="right" if name in numbers else "left", overflow="fold", no_wrap=name in numbers)
    for row in rows:
        # Text, not markup: labels contain square brackets.
        table.add_row(*(Text(plain_text(cell)) for cell in row))
    terminal().print(table)


def print_json(value: Any) -> None:
    """Print one JSON document; NaN and infinity, which JSON does not have, become null."""
    print(json.dumps(_plain(value), indent=2, allow_nan=False, ensure_ascii=False, default=str))


#: Columns of score tables that hold counts, and those that hold a number or nothing.
_COUNTS, _LEVELS = ("seed", "n", "peak_bytes"), ("level", "level2")


def score_records(rows: Iterable[Mapping[Any, Any]]) -> list[dict[str, Any]]:
    """Rows of a score table for JSON: counts are whole numbers, levels are numbers or null (in the file they are text)."""
    records = []
    for row in rows:
        plain = dict(row)
        for key in _COUNTS:
            value = plain.get(key)
            if isinstance(value, float) and value.is_integer():
                plain[key] = int(value)
        for key in _LEVELS:
            if isinstance(plain.get(key), str):
                plain[key] = float(plain[key]) if plain[key] else None
        records.append(plain)
    return records


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
    """A number of bytes with a fitting unit."""
    for unit in ("B", "KiB", "MiB", "GiB"):
        if count < 1024 or unit == "GiB":
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1024
    raise AssertionError
