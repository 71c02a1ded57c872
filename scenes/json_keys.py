"""The one reader of JSON that may come from anywhere: its size, depth and numbers are bounded, and each error is a ValueError."""

from __future__ import annotations

import json
import re
from typing import Any

__all__ = ["once", "read_json"]

#: Most values of one text: each takes some hundred bytes of memory.
_MOST_PARTS = 2**23
#: A whole number of more digits has no meaning here, and does not fit a floating-point number.
_LONG = re.compile(r"(?<![0-9])[0-9]{300}")
#: Of every so many characters one is looked at first: a number of 300 digits shows so many digits in a row.
_STEP, _IN_A_ROW = 50, re.compile(r"[0-9]{6}")


def read_json(text: str | bytes, *, unique: bool = False) -> Any:
    """The value of a JSON text.

    Main arguments:
        text: the text, or its bytes in UTF-8.
    Other arguments:
        unique: refuse an object that gives one key twice.

    Raises ValueError: not JSON, nested too deeply, more than 2^23 values, a whole number of 300 digits or more.
    """
    plain = text.decode("utf-8") if isinstance(text, bytes) else text
    if sum(map(plain.count, ",[{")) > _MOST_PARTS:
        raise ValueError(f"it holds more than {_MOST_PARTS:,} values")
    if _IN_A_ROW.search(plain[::_STEP]) and _LONG.search(plain):
        return _parsed(plain, unique, parse_int=_whole)
    return _parsed(plain, unique)


def _parsed(text: str, unique: bool, **more: Any) -> Any:
    if unique:
        more["object_pairs_hook"] = once
    try:
        return json.loads(text, **more)
    except RecursionError as error:
        raise ValueError("its brackets are nested too deeply") from error


def _whole(text: str) -> int:
    if len(text) >= 300:
        raise ValueError(f"a whole number of {len(text)} digits")
    return int(text)


def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The object of JSON pairs. Raises ValueError for a key that is given twice: which of its values holds?"""
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"the key {key[:80]!r} is given twice")
        found[key] = value
    return found
