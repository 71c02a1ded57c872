"""Text of mesh files: UTF-8, with or without byte-order mark, or Latin-1."""

from __future__ import annotations

__all__ = ["decoded", "number_of"]


def decoded(content: bytes) -> str:
    """The text of a file. Names and comments may hold any letters; what is read is ASCII."""
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return content.decode("utf-16")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def number_of(word: str, line: int) -> float:
    """A number of line `line`. Raises ValueError that names both."""
    try:
        return float(word)
    except ValueError:
        raise ValueError(f"line {line}: {word[:40]!r} is no number") from None
