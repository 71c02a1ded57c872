"""Text of strangers, made plain for a terminal: names in files and messages of plug-ins may hold control sequences."""

from __future__ import annotations

__all__ = ["plain_text"]


def plain_text(text: str) -> str:
    """The text with control characters (but line feeds and tabs) and lone surrogates as backslash escapes.

    A terminal obeys escape sequences, and a lone surrogate cannot be written as UTF-8.
    """
    if text.isprintable():
        return text
    return "".join(
        char if char.isprintable() or char in "\n\t" else char.encode("unicode_escape").decode() for char in text
    )
