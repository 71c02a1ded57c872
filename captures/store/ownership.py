"""Which folders are stores of this package, and their removal: nothing else is ever replaced or deleted.

A store is known by what its manifest, or the first line of its journal or second manifest, says, not by a file's name; and
a store that holds files of other origin is left alone. A store loses its mark last, so that a removal that was interrupted
can be continued.
"""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path

from ...scenes.errors import InputError
from ...scenes.json_keys import read_json
from .journal import JOURNAL, MARK_LINE, has_mark, write_file
from .manifest import FORMAT, MANIFEST, MANIFEST_SUM, RECORD, regular_size

__all__ = [
    "REPAIR_MARK", "TOKEN",
    "clear_unfinished_writes", "foreign_entries", "is_ours", "is_removable_partial", "may_drop", "remove_store", "replaced_name",
    "settle_replacement", "sharded_foreign", "state_replacement",
]  # fmt: skip

#: A file in an unfinished store that a repair writes: the next repair begins it again.
REPAIR_MARK = "repair.mark"
#: A file in a store that is being replaced: its folder may be called NAME.replaced, and is then no store of the user's.
_REPLACED = "replaced.mark"
_TOP = {
    name + end
    for name in (MANIFEST, MANIFEST_SUM, RECORD, JOURNAL, _REPLACED, REPAIR_MARK, "zarr.json")
    for end in ("", ".new")
}
#: Files and the folder of a store of many captures.
_ASKED, _RECEIPTS = "dataset.json", "receipts"
#: A file in an unfinished store that workers on other machines read, to show that they see the same folder.
TOKEN = "workers.token"
_TOP_SHARDED = _TOP | {
    name + end for name in (_ASKED, f"{_ASKED}.copy", "index.parquet", TOKEN) for end in ("", ".new")
}
_RECEIPT = re.compile(r"[a-z0-9][a-z0-9_]{0,60}\.[0-9]{1,9}\.z(\.copy)?((\.[0-9a-f]{32})?\.new)?")
_CHUNK = re.compile(r"c(\.[0-9]{1,10})*(\.[0-9a-f]{32}\.partial|\.new)?")


def is_ours(path: Path) -> bool:
    """Whether the folder states that it is a store, or an unfinished one. A link is none."""
    if path.is_symlink() or not path.is_dir():
        return False
    if any(regular_size(path / name) is not None and has_mark(path, name) for name in (JOURNAL, RECORD)):
        return True
    if _states(path / _ASKED, "request"):
        return True
    return _states(path / MANIFEST)


def _states(file: Path, key: str = "") -> bool:
    """Whether a JSON file, or the object `key` in it, states the format of stores."""
    try:
        body = read_json(file.read_bytes()) if regular_size(file) is not None else None
    except (OSError, ValueError, RecursionError):
        return False
    found = body.get(key) if key and isinstance(body, dict) else body
    return isinstance(found, dict) and found.get("format") == FORMAT


def is_removable_partial(path: Path) -> bool:
    """Whether an unfinished store may be removed: ours, or left by a stop before its mark was written (it holds nothing)."""
    if path.is_symlink() or not path.is_dir():
        return False
    entries = [name for name in os.listdir(path) if name not in (REPAIR_MARK, f"{REPAIR_MARK}.new")]
    if entries == [JOURNAL] and (regular_size(path / JOURNAL) or 0) <= len(MARK_LINE):
        return MARK_LINE.startswith((path / JOURNAL).read_bytes())
    return not entries or is_ours(path)


def may_drop(name: str) -> bool:
    """Whether a file in an array's folder is a chunk or a temporary file of one."""
    return _CHUNK.fullmatch(name) is not None


def foreign_entries(path: Path) -> list[str]:
    """Files and folders in the store that are not of its format, sorted: links, other names. Raises OSError."""
    if _is_sharded(path):
        return sharded_foreign(path)
    found = []
    with os.scandir(path) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                with os.scandir(entry.path) as inside:
                    found += [f"{entry.name}/{one.name}" for one in inside if not _is_array_file(one)]
            elif entry.name not in _TOP or not entry.is_file(follow_symlinks=False):
                found.append(entry.name)
    return sorted(found)


def _is_array_file(entry: os.DirEntry[str]) -> bool:
    return entry.is_file(follow_symlinks=False) and (
        entry.name in ("zarr.json", "zarr.json.new") or may_drop(entry.name)
    )


def clear_unfinished_writes(path: Path) -> None:
    """Remove what a stop left of a file of metadata that was being written (`journal.write_file`). Raises OSError."""
    for folder in (path, *(Path(entry.path) for entry in os.scandir(path) if entry.is_dir(follow_symlinks=False))):
        for entry in list(os.scandir(folder)):
            own = entry.name in _TOP if folder == path else entry.name == "zarr.json.new"
            if own and entry.name.endswith(".new") and entry.is_file(follow_symlinks=False):
                os.unlink(entry.path)


def _is_sharded(path: Path) -> bool:
    return any(os.path.lexists(path / name) for name in (_ASKED, f"{_ASKED}.copy", _RECEIPTS))


def sharded_foreign(path: Path) -> list[str]:
    """As `foreign_entries`, of a store of many captures: groups of arrays, and receipts. Raises OSError."""
    found = []
    for place, names, files in os.walk(path):
        inside = Path(place).relative_to(path)
        depth = len(inside.parts)
        for name in [*names, *files]:
            link = (path / inside / name).is_symlink()
            folder = name in names and depth < 2 and inside.parts != (_RECEIPTS,)
            if depth == 0:
                known = folder or name in _TOP_SHARDED
            elif inside.parts == (_RECEIPTS,):
                known = _RECEIPT.fullmatch(name) is not None
            else:
                known = folder or name in ("zarr.json", "zarr.json.new") or (depth == 2 and may_drop(name))
            if link or not known or (name in names and not folder):
                found.append(str(inside / name))
    return sorted(found)


def _remove_folder(folder: Path) -> None:
    """Remove the files of a store from a folder of it, then the folder. Raises OSError where others are in it."""
    for name in os.listdir(folder):
        inside = folder / name
        if stat.S_ISDIR(os.lstat(inside).st_mode):
            _remove_folder(inside)
        elif may_drop(name) or name in ("zarr.json", "zarr.json.new") or _RECEIPT.fullmatch(name):
            inside.unlink()
    folder.rmdir()


def remove_store(path: Path) -> None:
    """Remove a store, its mark last. Raises InputError where it holds files of other origin, OSError.

    What other programs put into the folder after the check stays, and the folder with it.
    """
    foreign = foreign_entries(path)
    if foreign:
        raise InputError(
            "The store holds files that are not its own, so it is not removed.",
            where=str(path), value=foreign[0] + (f", and {len(foreign) - 1} more" if len(foreign) > 1 else ""),
            next_step="move them away, or remove the folder yourself",
        )  # fmt: skip
    for name in sorted(os.listdir(path)):
        folder = path / name
        if stat.S_ISDIR(os.lstat(folder).st_mode):
            _remove_folder(folder)
    last = [RECORD, MANIFEST, JOURNAL, _REPLACED]
    for name in [*sorted(_TOP_SHARDED - {*last}), *last]:
        (path / name).unlink(missing_ok=True)
    path.rmdir()


def replaced_name(path: Path) -> Path:
    """The name of the store at `path` while a new one takes its place."""
    return path.with_name(path.name + ".replaced")


def state_replacement(path: Path) -> None:
    """Note in the store at `path` that a new one takes its place: only a folder with this note is taken for what is left of a
    replacement. Raises OSError."""
    write_file(path / _REPLACED, b"a new store takes the place of this one\n")


def settle_replacement(path: Path) -> None:
    """Finish or undo a replacement of the store at `path` that was interrupted. Raises InputError, OSError.

    Where nothing stands at `path` the old store gets its name back; where the new store stands there, what is left of the old
    one is removed. A store of the name `NAME.replaced` without the note is the user's, and left alone.
    """
    aside = replaced_name(path)
    if not aside.is_symlink() and regular_size(aside / _REPLACED) is not None:
        if not os.path.lexists(path):
            os.rename(aside, path)
        elif is_ours(path):
            remove_store(aside)
    elif not aside.is_symlink() and aside.is_dir() and not os.listdir(aside):
        aside.rmdir()  # the last step of a removal
    if is_ours(path):
        for mark in (_REPLACED, REPAIR_MARK):
            (path / mark).unlink(missing_ok=True)
        second = _ASKED if _is_sharded(path) else RECORD
        if all(regular_size(path / name) is not None for name in (MANIFEST, MANIFEST_SUM, second)):
            (path / JOURNAL).unlink(missing_ok=True)  # the last step of a store's completion
