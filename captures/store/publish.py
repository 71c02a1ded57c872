"""Turn a partial store into a store: set the actual length, write attributes and manifest, sync, then rename once."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError
from .journal import JOURNAL, Journal, fsync_path, write_file
from .manifest import MANIFEST, MANIFEST_SUM, RECORD, sum_text
from .ownership import (
    REPAIR_MARK,
    foreign_entries,
    is_ours,
    may_drop,
    remove_store,
    replaced_name,
    settle_replacement,
    state_replacement,
)
from .record import manifest_of, metadata_of, record_text, with_sums

__all__ = ["disk_error", "exchange", "is_store", "partial_of", "publish", "refuse_existing"]


def partial_of(path: Path) -> Path:
    """The folder in which the store is written before it gets its name."""
    return path.parent / f"{path.name}.partial"


def is_store(path: Path) -> bool:
    """Whether the folder looks like a store, whatever its state; `ownership.is_ours` decides what may be removed."""
    return path.is_dir() and ((path / MANIFEST).is_file() or (path / JOURNAL).is_file())


def refuse_existing(path: Path, overwrite: bool) -> None:
    """Raise InputError if something is at `path` that must not be replaced."""
    if not os.path.lexists(path):
        return
    if not overwrite:
        raise InputError(
            "The output exists.", where=str(path), next_step="choose another --out, or add --overwrite"
        )  # fmt: skip
    if not is_ours(path):
        raise InputError(
            "The output exists and is not a store of captures, or its manifest is damaged; it is not overwritten.",
            where=str(path), next_step="choose another --out, or remove it yourself",
        )  # fmt: skip
    foreign = foreign_entries(path)
    if foreign:
        raise InputError(
            "The store holds files that are not its own, so it is not overwritten.", where=str(path / foreign[0]),
            next_step="move them away, or choose another --out",
        )  # fmt: skip


def publish(partial: Path, path: Path, journal: Journal, *, overwrite: bool, keep_replaced: Path | None = None) -> None:
    """Give the captures of `journal` in `partial` the final name `path`. Raises OSError, InputError.

    An existing store at `path` is moved aside, and removed only after the new one has taken its place; it stays under
    the name `keep_replaced` where one is given.
    """
    if not journal.records:
        raise InputError("There is no complete capture to store.", where=str(path))
    journal = with_sums(partial, journal)
    _drop_unlisted(partial, journal.chunks)
    text = manifest_of(journal).text().encode()
    files = {**metadata_of(journal), RECORD: record_text(journal), MANIFEST: text, MANIFEST_SUM: sum_text(text)}
    for name, content in files.items():
        write_file(partial / name, content)
    for name in journal.structure:
        fsync_path(partial / name)
    fsync_path(partial)
    exchange(partial, path, overwrite, keep_replaced)
    for name in (JOURNAL, REPAIR_MARK):
        (path / name).unlink(missing_ok=True)
    fsync_path(path)


def disk_error(error: OSError, doing: str, path: Path, next_step: str = "") -> InputError:
    """An OSError as an InputError with advice; its notes are kept."""
    advice = {
        errno.ENOSPC: "free space on the disk, or choose another --out",
        errno.EDQUOT: "free space in your quota, or choose another --out",
        errno.EACCES: "choose another --out that you may write to",
        errno.EPERM: "choose another --out that you may write to",
        errno.EROFS: "choose another --out that you may write to",
        errno.ENOTDIR: "choose another --out: a part of this path is a file",
    }.get(error.errno or 0, "")
    told = InputError(
        f"{doing} failed: {error.strerror or error}.",
        where=str(path), next_step="; ".join(filter(None, [advice, next_step])),
    )  # fmt: skip
    for note in getattr(error, "__notes__", ()):  # what is kept, and how to continue
        told.add_note(note)
    return told


def _drop_unlisted(partial: Path, chunks: dict[str, dict[str, Any]]) -> None:
    # Chunks of a capture that a crash interrupted, and temporary files of zarr.
    for name, marks in chunks.items():
        for file in os.listdir(partial / name):
            if file not in marks and may_drop(file):
                (partial / name / file).unlink()


def exchange(partial: Path, path: Path, overwrite: bool, keep_replaced: Path | None) -> None:
    """Rename `partial` to `path`, the store that stands there aside first. Raises OSError, InputError."""
    settle_replacement(path)
    refuse_existing(path, overwrite)
    aside = keep_replaced or replaced_name(path)
    replacing = path.exists()
    if replacing and keep_replaced is None:
        if os.path.lexists(aside):
            raise InputError(
                "The place that the old store takes while it is replaced is taken.", where=str(aside),
                next_step="move that away, or choose another --out",
            )  # fmt: skip
        state_replacement(path)
    if replacing:
        os.rename(path, aside)
    try:
        os.rename(partial, path)
    except OSError:
        if replacing:
            os.rename(aside, path)
            settle_replacement(path)
        raise
    fsync_path(path.parent)
    if replacing and keep_replaced is None:
        remove_store(aside)
