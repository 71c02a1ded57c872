"""New files of specs, begun from one that ships: its text with its comments, under another name."""

from __future__ import annotations

import re
from pathlib import Path

from .errors import InputError

__all__ = ["begun_from", "check_spec_name"]

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
_LONGEST = 80


def check_spec_name(name: str, kind: str) -> None:
    """Refuse a name that a scene, suite or data set cannot have. Raises InputError."""
    if not _NAME.fullmatch(name) or len(name) > _LONGEST:
        raise InputError(
            f"A {kind} cannot have this name.", where="name", value=name,
            allowed=f"letters, digits, dot, dash and underscore, at most {_LONGEST}",
        )  # fmt: skip


def begun_from(source: Path, key: str, name: str, head: str) -> str:
    """The text of a file that ships, for a file of another name.

    Main arguments:
        source: the file. key: the key that holds its name ("name", "suite"). name: the new name. head: comment lines for its top.

    Files beside it that it names are named as "library:NAME"; a version begins at 1 again.
    """
    text = source.read_text(encoding="utf-8")
    lines = [f"# {line}".rstrip() for line in head.splitlines()]
    text = re.sub(rf'^{key} = "[^"]*"', f'{key} = "{name}"', text, count=1, flags=re.MULTILINE)
    text = re.sub(r"^version = \d+", "version = 1", text, count=1, flags=re.MULTILINE)
    text = re.sub(r'\bfile = "(?!library:)([^"/]+)"', r'file = "library:\1"', text)
    return "\n".join([*lines, "", text])
