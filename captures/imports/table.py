"""CSV: numbers in columns, separated by commas, semicolons, tabs or blanks; "#" begins a comment, one line may name the columns."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np

from .recording import Recording

__all__ = ["read_csv"]

_MOST_TEXT = 2**28
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|nan|inf|-inf", re.IGNORECASE)


def read_csv(path: Path) -> Recording:
    """The table "table" (row, column), and each named column by its name. Raises ValueError."""
    if path.stat().st_size > _MOST_TEXT:
        raise ValueError(f"more than {_MOST_TEXT:,} bytes of text")
    lines = [line.split("#")[0].strip() for line in path.read_text(encoding="utf-8-sig").splitlines()]
    lines = [line for line in lines if line]
    if not lines:
        raise ValueError("it is empty")
    mark = next((mark for mark in (";", "\t", ",") if mark in lines[0]), None)
    head = [part.strip().strip('"') for part in lines[0].split(mark)]
    named = not all(_NUMBER.fullmatch(part) for part in head)
    values = np.loadtxt(io.StringIO("\n".join(lines[named:])), delimiter=mark, ndmin=2, dtype=np.float64)
    if values.size == 0 or (named and len(head) != values.shape[1]):
        raise ValueError(f"{len(head)} names of columns, and {values.shape[1]} columns")
    columns = {name: values[:, k] for k, name in enumerate(head)} if named else {}
    return Recording({"table": values, **columns}, ("row", "column"))
