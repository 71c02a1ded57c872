"""Files of specs: found by name or path, read as plain data (TOML or JSON). No code is ever run from them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .errors import InputError, reason
from .json_keys import read_json
from .nearest import did_you_mean
from .toml_text import read_toml

__all__ = ["LIBRARY", "find_spec_file", "read_spec_file"]

#: Folder of the scenes that ship with the project.
LIBRARY = Path(__file__).parent / "library"

#: `tomllib` reads some megabytes a second; a spec of a thousand delays has 30 kB.
_MAX_BYTES = 8 * 2**20


def find_spec_file(source: str, folder: Path, *, kind: str, next_step: str) -> Path:
    """The file of a spec: one that ships in `folder`, by its name, or any .toml or .json file, by its path.

    Main arguments:
        source: name or path. folder: of those that ship. kind: "scene" or "suite", for the message.
    Other arguments:
        next_step: of the message where no name is similar.

    Raises:
        InputError: neither; the message lists all names, and similar ones.
    """
    inside = folder / f"{source}.toml"
    if "/" not in source and inside.is_file():
        return inside
    path = Path(source).expanduser()
    if path.suffix.lower() in {".toml", ".json"} and path.is_file():
        return path
    names = sorted(path.stem for path in folder.glob("*.toml"))
    if path.suffix or "/" in source:
        raise _no_file(path, source, kind)
    raise InputError(
        f"There is no such {kind}.",
        where=kind,
        value=source,
        allowed="a path to a .toml or .json file, or one of: " + ", ".join(names),
        next_step=did_you_mean(source, names, next_step, cutoff=0.4),
    )


def _no_file(path: Path, source: str, kind: str) -> InputError:
    """The error of a path that leads to no spec: similar files beside it, or what is wrong with its ending."""
    if path.is_file():
        return InputError(
            f"The file of a {kind} should end in .toml or .json.", where=kind, value=source, allowed="*.toml, *.json"
        )
    folder = path.parent
    there = sorted(one.name for one in folder.glob("*.*ml")) if folder.is_dir() else []
    there += sorted(one.name for one in folder.glob("*.json")) if folder.is_dir() else []
    step = "check the path" if folder.is_dir() else f"there is no folder {folder}"
    return InputError(
        "There is no such file.", where=kind, value=source, allowed=f"an existing .toml or .json file, or the name of a {kind}",
        next_step=did_you_mean(path.name, there, step, cutoff=0.4, folder=folder),
    )  # fmt: skip


def read_spec_file(path: Path) -> dict[str, Any]:
    """Read a TOML or JSON file into plain data.

    Raises:
        InputError: unreadable, too large, or not well formed.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError("The file is too large for a spec.", where=str(path), value=path.stat().st_size)
        text = path.read_text(encoding="utf-8-sig")  # a byte-order mark is no part of the text
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("The file cannot be read.", where=str(path), value=reason(error)) from error
    try:
        data = read_json(text, unique=True) if path.suffix.lower() == ".json" else read_toml(text)
    except ValueError as error:
        raise InputError("The file is not well formed.", where=str(path), value=str(error)) from error
    if not isinstance(data, dict):
        raise InputError("A spec should be a table of keys.", where=str(path), value=type(data).__name__)
    return data
