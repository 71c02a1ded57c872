"""Two columns of numbers from a text file: a measured curve as oscilloscopes and spreadsheets write it."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import InputError, reason
from .nearest import did_you_mean

__all__ = ["read_columns"]

Float = NDArray[np.float64]

#: A file of a million lines has some 30 MB.
_MOST_BYTES = 2**26
_MOST_LINES = 2**20
_LEAST_LINES = 8


def read_columns(path: Path, columns: tuple[int | str, int | str], where: str) -> tuple[Float, Float]:
    """Two columns of a text file.

    Columns are separated by commas, semicolons, tabs or spaces; with the last three a number may have a decimal comma. Lines
    before the first one of numbers are a heading, of which the last names the columns; empty lines and those that begin with # are
    left out.

    Main arguments:
        path: the file, in UTF-8. columns: numbers from 1, or names in the heading.

    Raises:
        InputError: unreadable, too long or too short, no such column, or a line that is not numbers.
    """
    lines = _lines(path, where)
    mark = _separator(lines)
    rows: list[tuple[float, float]] = []
    heading: list[str] = []
    places: list[int] = []
    for number, line in lines:
        fields = [field.strip().strip('"') for field in (line.split(mark) if mark else line.split())]
        if not rows and _number(fields[0]) is None:
            heading = fields if len(fields) > 1 or not heading else heading
            continue
        places = places or [_place(column, heading, len(fields), where) for column in columns]
        pair = [_number(fields[place]) if place < len(fields) else None for place in places]
        if pair[0] is None or pair[1] is None:
            raise InputError(
                "A line of the file is not numbers.", where=where, value=f"{path.name}, line {number}: {line[:80]}",
                allowed="a finite number in both columns of every line behind the heading",
            )  # fmt: skip
        rows.append((pair[0], pair[1]))
    if len(rows) < _LEAST_LINES:
        raise InputError(
            "The file holds too few numbers for a curve.", where=where, value=f"{path.name}: {len(rows)} lines of numbers",
            allowed=f"at least {_LEAST_LINES} lines, with time and value",
        )  # fmt: skip
    both = np.asarray(rows, dtype=np.float64)
    return both[:, 0], both[:, 1]


def _lines(path: Path, where: str) -> list[tuple[int, str]]:
    """(number, text) of each line that says something. A # before a heading is taken off."""
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise InputError(
                "The file is too large for a curve.", where=where, value=f"{path.stat().st_size:,} bytes",
                allowed=f"up to {_MOST_BYTES:,} bytes",
            )  # fmt: skip
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("The file cannot be read.", where=where, value=f"{path.name}: {reason(error)}") from error
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
    if len(lines) > _MOST_LINES:
        raise InputError(
            "The file has too many lines.", where=where, value=len(lines), allowed=f"up to {_MOST_LINES:,}"
        )
    begun = next((index for index, (_, line) in enumerate(lines) if line and line[0] in "+-.0123456789"), len(lines))
    head = [(number, line.lstrip("# ")) for number, line in lines[:begun]]
    return [(number, line) for number, line in head if line] + [
        (number, line) for number, line in lines[begun:] if line and not line.startswith("#")
    ]


def _separator(lines: list[tuple[int, str]]) -> str:
    """What separates the columns of the last line; "" for spaces, between which a comma belongs to a number."""
    last = lines[-1][1] if lines else ""
    for mark in (";", "\t"):
        if mark in last:
            return mark
    spaced = re.search(r"[^\s,]\s+[^\s,]", last)
    return "," if "," in last and not spaced else ""


def _number(text: str) -> float | None:
    """The finite number that a text is, with a point or a comma; None for anything else."""
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        return None
    return value if math.isfinite(value) and "_" not in text else None


def _place(column: int | str, heading: list[str], count: int, where: str) -> int:
    if isinstance(column, int):
        if column > count:
            raise InputError("The file has no such column.", where=where, value=column, allowed=f"1 to {count}")
        return column - 1
    if column in heading:
        return heading.index(column)
    raise InputError(
        "The file has no such column.", where=where, value=column,
        allowed=", ".join(heading) or "a number: the file has no heading",
        next_step=did_you_mean(column, heading),
    )  # fmt: skip
