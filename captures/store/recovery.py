"""Complete interrupted stores, and repair damaged ones: metadata are written again, captures made again or dropped."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ...scenes.errors import InputError
from .arrays import CAPACITY, metadata_files
from .journal import Journal, has_header, read_journal, refuse_busy, write_file
from .manifest import Mark, load_manifest, regular_size
from .ownership import (
    REPAIR_MARK,
    clear_unfinished_writes,
    is_ours,
    is_removable_partial,
    remove_store,
    settle_replacement,
)  # fmt: skip
from .publish import disk_error, is_store, partial_of, publish
from .reader import CaptureSet, unchecked_captures
from .remake import Again, Make
from .restore import restore_metadata
from .verification import FOREIGN, LINK, Damage, partial_damage, refused_partial, unreadable_store, verify
from .writer import CaptureWriter

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Recovery", "finalize", "repair"]


@dataclass(frozen=True)
class Recovery:
    """Result of a recovery: the store, the number of its captures, the dropped captures, and the damage.

    `aside` is the folder with the files of the dropped captures, None where none was dropped. `restored` are the metadata files
    that were written again, `remade` the captures that were made again with the same bits, `not_remade` why others were not.
    """

    path: Path
    kept: int
    dropped: tuple[int, ...]
    damage: tuple[Damage, ...]
    aside: Path | None = None
    restored: tuple[str, ...] = ()
    remade: tuple[int, ...] = ()
    not_remade: tuple[str, ...] = ()


def finalize(path: str | os.PathLike[str], *, overwrite: bool = False) -> Recovery:
    """Turn the complete captures of an unfinished store into a store.

    Main arguments:
        path: the store's name, with or without `.partial`.
        overwrite: replace an existing store of the final name.

    A capture that was not complete when writing stopped is dropped. Raises InputError if there is nothing unfinished,
    no complete capture, damage (see `repair`), or an existing store.
    """
    final, partial = _names(path)
    journal = _sound_journal(partial)
    if damage := partial_damage(partial, journal):
        raise refused_partial(partial, damage)
    try:
        publish(partial, final, journal, overwrite=overwrite)
    except OSError as error:
        raise disk_error(error, "Completing the store", final) from error
    return Recovery(final, len(journal.records), (), ())


def repair(path: str | os.PathLike[str], *, overwrite: bool = False, make: Make | None = None) -> Recovery:
    """Write damaged metadata again, and drop damaged captures; the intact ones keep their order and are numbered anew.

    Main arguments:
        path: a store, or an unfinished one (with `.partial`).
        overwrite: for an unfinished one, replace an existing store of the final name.
        make: makes a capture again from its attributes (InputError where these do not suffice). It takes the place of the
            damaged one if its chunks have the sha256 of those that were written; else the capture is dropped.

    A store is replaced only after the new one is complete; the files of dropped captures stay beside it in
    `NAME.dropped`. Raises InputError if a file cannot be read (it may be intact), both sets of metadata are damaged (then no
    capture can be trusted), or no capture is intact.
    """
    root = Path(path).expanduser()
    if not os.path.lexists(root) and regular_size(partial_of(root) / REPAIR_MARK) is not None:
        return finalize(root)  # a repair that stopped between its two last renames
    return _repair_partial(root, overwrite, make) if root.name.endswith(".partial") else _repair_store(root, make)


def _repair_store(root: Path, make: Make | None) -> Recovery:
    try:
        settle_replacement(root)
        if is_ours(root):
            clear_unfinished_writes(root)
    except OSError as error:
        raise disk_error(error, "Repairing the store", root) from error
    damage = _readable(root, verify(root))
    foreign = [entry for entry in damage if entry.problem in (FOREIGN, LINK)]
    if foreign:
        raise InputError(
            f"The store holds files that are not its own: {foreign[0].file}"
            + (f", and {len(foreign) - 1} more." if len(foreign) > 1 else "."),
            where=str(root), next_step="move them away, then try again",
        )  # fmt: skip
    try:
        restored = tuple(restore_metadata(root))
    except OSError as error:
        raise disk_error(error, "Writing the metadata again", root) from error
    if restored:
        damage = [*(one for one in damage if one.file in restored), *_readable(root, verify(root))]
    open_damage = [entry for entry in damage if entry.file not in restored]
    manifest = load_manifest(root)
    captures = unchecked_captures(root, manifest)
    again = Again(root, captures, manifest.chunks, make).heal(open_damage)
    if again.left == []:
        return Recovery(root, len(captures), (), tuple(damage), None, restored, again.remade)
    if os.path.lexists(partial_of(root)) and not _begun_before(partial_of(root)):
        raise InputError(
            "An unfinished store is beside the damaged one, and a repair would replace it.",
            where=str(partial_of(root)), next_step="move it away, or remove it if it is left from a repair that failed",
        )  # fmt: skip
    dropped = {entry.capture for entry in again.left if entry.capture is not None}
    aside = _aside(root)
    kept = _rewrite(root, captures, dropped, overwrite=True, keep_replaced=aside)
    _thin(aside, manifest.chunks, dropped)
    return Recovery(root, kept, tuple(sorted(dropped)), tuple(damage), aside, restored, again.remade, again.reasons)


def _repair_partial(root: Path, overwrite: bool, make: Make | None) -> Recovery:
    final, partial = _names(root)
    journal = _sound_journal(partial)
    found = _readable(partial, partial_damage(partial, journal))
    if not found:
        return finalize(partial, overwrite=overwrite)
    chunks = journal.chunks
    # Metadata are written from the journal, so their damage does not matter here.
    for name, content in metadata_files(journal.structure, CAPACITY, {}).items():
        write_file(partial / name, content)
    records = [record.attrs for record in journal.records]

    def captures(place: Path) -> CaptureSet:
        return CaptureSet(place, journal.modality, journal.structure, records, journal.texts, chunks)

    again = Again(partial, captures(partial), chunks, make).heal(found)
    if again.left == []:
        done = finalize(partial, overwrite=overwrite)
        return Recovery(done.path, done.kept, (), tuple(found), None, (), again.remade)
    dropped = {entry.capture for entry in again.left if entry.capture is not None}
    # The folder gets another name, so that the new store can be written beside it.
    aside = _aside(final)
    os.rename(partial, aside)
    try:
        kept = _rewrite(final, captures(aside), dropped, overwrite=overwrite)
    except BaseException:
        if not partial.exists():
            os.rename(aside, partial)
        raise
    _thin(aside, chunks, dropped)
    return Recovery(final, kept, tuple(sorted(dropped)), tuple(found), aside, (), again.remade, again.reasons)


def _begun_before(partial: Path) -> bool:
    """Remove what an earlier repair left unfinished beside the store, which is still whole; False where it is of other origin."""
    if not is_removable_partial(partial):
        return False
    if regular_size(partial / REPAIR_MARK) is None and has_header(partial):
        return False
    refuse_busy(partial)
    try:
        remove_store(partial)
    except OSError as error:
        raise disk_error(error, "Removing an unfinished repair", partial) from error
    return True


def _readable(root: Path, damage: list[Damage]) -> list[Damage]:
    """`damage`, if all its files could be read. Raises InputError otherwise: dropping them might lose intact data."""
    if refused := [entry for entry in damage if entry.unreadable]:
        raise unreadable_store(root, refused)
    return damage


def _aside(path: Path) -> Path:
    """A free name beside `path` for dropped captures: NAME.dropped, NAME.dropped-2, …"""
    names = (path.with_name(f"{path.name}.dropped{'' if n == 1 else f'-{n}'}") for n in itertools.count(1))
    return next(name for name in names if not os.path.lexists(name))


def _thin(aside: Path, chunks: dict[str, dict[str, Mark]], dropped: set[int]) -> None:
    """Remove from `aside` the chunks of captures that are in the repaired store; all else stays."""
    for array, marks in chunks.items():
        for key in marks:
            if int(key.split(".")[1]) not in dropped:
                (aside / array / key).unlink(missing_ok=True)


def _rewrite(
    path: Path, captures: CaptureSet, dropped: set[int], *, overwrite: bool, keep_replaced: Path | None = None
) -> int:
    if len(dropped) >= len(captures):
        raise InputError("No capture is intact.", where=str(captures.path), next_step="generate the data anew")

    def sound() -> Iterator[xr.Dataset]:
        return (captures[i] for i in range(len(captures)) if i not in dropped)

    with CaptureWriter(path, overwrite=overwrite, keep_replaced=keep_replaced, repairs=True) as writer:
        for capture in sound():
            writer.append(capture)
    return writer.count


def _names(path: str | os.PathLike[str]) -> tuple[Path, Path]:
    given = Path(path).expanduser()
    final = given.with_name(given.name.removesuffix(".partial")) if given.name.endswith(".partial") else given
    partial = partial_of(final)
    try:
        settle_replacement(final)
    except OSError as error:
        raise disk_error(error, "Completing the store", final) from error
    if not is_store(partial):
        state = "The store is already complete" if is_ours(final) else "There is no unfinished store"
        raise InputError(f"{state}: there is no {partial.name}.", where=str(given), allowed="a .partial folder")
    return final, partial


def _sound_journal(partial: Path) -> Journal:
    refuse_busy(partial)
    journal = read_journal(partial)
    if not journal.records:
        raise InputError(
            "The unfinished store contains no complete capture.",
            where=str(partial), next_step="remove the folder and generate the captures again",
        )  # fmt: skip
    return journal
