"""TOML that may come from anywhere: `tomllib` needs a time that grows with the square of the parts of a dotted key."""

from __future__ import annotations

import re
import tomllib
from typing import Any

__all__ = ["read_toml"]

#: Most dots of one key; a spec has less than ten.
_MOST_DOTS = 32
_LONG = re.compile(r"(?<![0-9_])[0-9][0-9_]{299}")


def read_toml(text: str) -> dict[str, Any]:
    """The table of a TOML text.

    Raises ValueError: not TOML, nested too deeply, a key of more than 32 parts, a whole number of 300 digits or more.
    """
    # Between these signs stands a key, or a value that needs no dots: one number, or one text.
    for part in re.split(r"[=,{\n]", text):
        if part.count(".") > _MOST_DOTS and not _is_text(part):
            raise ValueError(f"a key has more than {_MOST_DOTS} parts: {part.strip()[:40]!r}")
    if found := _LONG.search(text):
        line = text.count("\n", 0, found.start()) + 1
        raise ValueError(f"a whole number has 300 digits or more (line {line})")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("its brackets are nested too deeply") from error


def _is_text(part: str) -> bool:
    """Whether the part is one text in quotes, or a comment: no key of several parts."""
    plain = part.strip()
    if plain.startswith("#"):
        return True
    quote, rest = plain[:1], plain[1:].rstrip("]} ")
    return quote in ('"', "'") and (quote not in rest or rest.index(quote) == len(rest) - 1)
