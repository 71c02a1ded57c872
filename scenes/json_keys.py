"""Keys of JSON objects, each of which stands once, as in TOML."""

from __future__ import annotations

from typing import Any

__all__ = ["once"]


def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The object of JSON pairs. Raises ValueError for a key that is given twice: which of its values holds?"""
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"the key {key[:80]!r} is given twice")
        found[key] = value
    return found
