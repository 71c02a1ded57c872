"""What is done with a store of either kind: that of one file per chunk, and that of many captures in shards."""

from __future__ import annotations

import os
from pathlib import Path
from shlex import quote

from ...scenes.errors import InputError
from . import recovery, verification
from .journal import refuse_busy
from .ownership import settle_replacement
from .publish import disk_error, partial_of
from .reader import CaptureSet, open_flat
from .recovery import Recovery
from .remake import Make
from .shard_finish import publish_sharded
from .shard_manifest import is_sharded
from .shard_receipts import list_receipts
from .shard_repair import mend_shards, repair_sharded
from .shard_set import open_sharded
from .shard_verify import sharded_partial_damage, verify_sharded
from .verification import Damage, unreadable_store

__all__ = ["finalize", "open_captures", "repair", "sharded_place", "verify"]


def sharded_place(path: Path) -> tuple[Path, str] | None:
    """(store, group) where the path is a store of many captures, or the folder of one of its groups; else None."""
    if is_sharded(path):
        return path, ""
    parent = path.parent
    return (parent, path.name) if path.is_dir() and is_sharded(parent) else None


def open_captures(path: str | os.PathLike[str]) -> CaptureSet:
    """Open the store at `path` after checking its manifest, its metadata, and that each chunk exists in full size.

    Of a data set of several modalities, `path` is the folder of one: DIR/NAME. Raises InputError: no such path, a file, not a
    store, an unfinished one, another version, damaged metadata, missing or truncated chunks. Damage inside a chunk is detected
    when its capture is read, or by `verify`.
    """
    root = Path(path).expanduser()
    place = sharded_place(root)
    if place is None or place[0].name.endswith(".partial"):
        return open_flat(root)
    return open_sharded(*place)


def verify(path: str | os.PathLike[str]) -> list[Damage]:
    """Every damaged file of the store at `path`; an empty list if the store is intact.

    Every byte is compared with its sha256; what the manifest does not know is listed too: files, folders, links. Raises InputError
    where there is no store with an intact manifest, second manifest or receipt.
    """
    root = Path(path).expanduser()
    if not is_sharded(root):
        partial = partial_of(root)
        if not os.path.lexists(root) and partial.is_dir():
            raise InputError(
                "The store is unfinished.", where=str(partial),
                next_step=f"repeat the command that makes it with --resume and -o {quote(str(root))} to continue; "
                f"`beambench data finalize {quote(str(root))}` keeps what is complete",
            )  # fmt: skip
        return verification.verify(root)
    if root.name.endswith(".partial"):
        return [one for _, damage in sharded_partial_damage(root) for one in damage]
    return verify_sharded(root)


def finalize(path: str | os.PathLike[str], *, overwrite: bool = False) -> Recovery:
    """Turn the complete captures of an unfinished store into a store; of a data set, the complete shards.

    Main arguments:
        path: the store's name, with or without `.partial`.
        overwrite: replace an existing store of the final name.

    A capture that was not complete when writing stopped is dropped. Raises InputError if there is nothing unfinished,
    no complete capture, damage (see `repair`), or an existing store.
    """
    partial = _partial(path)
    if not is_sharded(partial):
        return recovery.finalize(path, overwrite=overwrite)
    _ready(partial)
    if damage := [one for _, found in sharded_partial_damage(partial) for one in found]:
        raise verification.refused_partial(partial, damage)
    return _published(partial, overwrite, ())


def repair(path: str | os.PathLike[str], *, overwrite: bool = False, make: Make | None = None) -> Recovery:
    """Write damaged metadata again, and make damaged captures again, or drop them.

    Main arguments:
        path: a store, or an unfinished one (with `.partial`).
        overwrite: for an unfinished one, replace an existing store of the final name.
        make: makes a capture again from its attributes (InputError where these do not suffice). It takes the place of the
            damaged one if its chunks have the sha256 of those that were written; else the capture is dropped.

    In a store of shards the others keep their places; in the other kind they are numbered anew, and the files of dropped captures
    stay beside it in `NAME.dropped`. Raises InputError if a file cannot be read (it may be intact), all sets of metadata are
    damaged, or no capture is intact.
    """
    root = Path(path).expanduser()
    if not is_sharded(root):
        return recovery.repair(root, overwrite=overwrite, make=make)
    if root.name.endswith(".partial"):
        _ready(root)
        found = [one for _, damage in sharded_partial_damage(root) for one in damage]
        if refused := [one for one in found if one.unreadable]:
            raise unreadable_store(root, refused)
        try:
            dropped, remade, reasons = mend_shards(root, make)
        except OSError as error:
            raise disk_error(error, "Repairing the store", root) from error
        done = _published(root, overwrite, tuple(found))
        return Recovery(done.path, done.kept, dropped, tuple(found), None, (), remade, reasons)
    try:
        settle_replacement(root)
    except OSError as error:
        raise disk_error(error, "Repairing the store", root) from error
    mended = repair_sharded(root, make)
    return Recovery(
        root, mended.kept, mended.dropped, mended.damage, None, mended.restored, mended.remade, mended.not_remade
    )


def _partial(path: str | os.PathLike[str]) -> Path:
    given = Path(path).expanduser()
    return given if given.name.endswith(".partial") else partial_of(given)


def _ready(partial: Path) -> None:
    """Refuse an unfinished store that is being written, or that holds nothing. Raises InputError."""
    refuse_busy(partial)
    if not list_receipts(partial):
        raise InputError(
            "The unfinished store contains no complete shard.", where=str(partial),
            next_step="continue it by --resume, or remove the folder and generate the captures again",
        )  # fmt: skip


def _published(partial: Path, overwrite: bool, damage: tuple[Damage, ...]) -> Recovery:
    final = partial.with_name(partial.name.removesuffix(".partial"))
    try:
        manifest = publish_sharded(partial, final, overwrite=overwrite)
    except OSError as error:
        raise disk_error(error, "Completing the store", final) from error
    return Recovery(final, manifest.count, (), damage)
