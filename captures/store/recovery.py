"""Complete interrupted stores, and repair damaged ones by keeping their intact captures."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ...scenes.errors import InputError
from .arrays import CAPACITY, metadata_files
from .journal import Journal, read_journal, refuse_busy, write_file
from .manifest import ASK_FOR_RIGHTS, TAKE_ANEW, Mark, load_manifest
from .publish import disk_error, is_store, partial_of, publish
from .reader import CaptureSet, open_captures, unchecked_captures
from .verification import Damage, chunks_damage, verify
from .writer import CaptureWriter

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Recovery", "finalize", "repair"]


@dataclass(frozen=True)
class Recovery:
    """Result of a recovery: the store, the number of its captures, the dropped captures, and the damage.

    `aside` is the folder with the files of the dropped captures, None where none was dropped.
    """

    path: Path
    kept: int
    dropped: tuple[int, ...]
    damage: tuple[Damage, ...]
    aside: Path | None = None


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
    damage = _readable(partial, _partial_damage(partial, journal))
    if damage:
        raise InputError(
            f"The unfinished store is damaged: {damage[0]}.",
            where=str(partial), next_step=f"`beambench data repair {partial}` keeps the intact captures",
        )  # fmt: skip
    try:
        publish(partial, final, journal, overwrite=overwrite)
    except OSError as error:
        raise disk_error(error, "Completing the store", final) from error
    return Recovery(final, len(journal.records), (), ())


def repair(path: str | os.PathLike[str], *, overwrite: bool = False) -> Recovery:
    """Drop damaged captures; the intact ones keep their order and are numbered anew.

    Main arguments:
        path: a store, or an unfinished one (with `.partial`).
        overwrite: for an unfinished one, replace an existing store of the final name.

    A store is replaced only after the new one is complete; the files of dropped captures stay beside it in
    `NAME.dropped`. Raises InputError if a file cannot be read (it may be intact), metadata are damaged (then no capture
    can be trusted), or no capture is intact.
    """
    root = Path(path).expanduser()
    return _repair_partial(root, overwrite) if root.name.endswith(".partial") else _repair_store(root)


def _repair_store(root: Path) -> Recovery:
    damage = _readable(root, verify(root))
    metadata = [entry for entry in damage if entry.capture is None and entry.file.endswith("zarr.json")]
    if metadata:
        raise InputError(
            f"The metadata are damaged, so that no capture can be trusted: {metadata[0]}.",
            where=str(root), next_step=TAKE_ANEW,
        )  # fmt: skip
    if not damage:
        return Recovery(root, len(open_captures(root)), (), ())
    if os.path.lexists(partial_of(root)):
        raise InputError(
            "An unfinished store is beside the damaged one, and a repair would replace it.",
            where=str(partial_of(root)), next_step="move it away, or remove it if it is left from a repair that failed",
        )  # fmt: skip
    manifest = load_manifest(root)
    dropped = {entry.capture for entry in damage if entry.capture is not None}
    captures = unchecked_captures(root, manifest)
    aside = _aside(root)
    kept = _rewrite(root, captures, dropped, overwrite=True, keep_replaced=aside)
    _thin(aside, manifest.chunks, dropped)
    return Recovery(root, kept, tuple(sorted(dropped)), tuple(damage), aside)


def _repair_partial(root: Path, overwrite: bool) -> Recovery:
    final, partial = _names(root)
    journal = _sound_journal(partial)
    damage = _readable(partial, _partial_damage(partial, journal))
    if not damage:
        return finalize(partial, overwrite=overwrite)
    dropped = {entry.capture for entry in damage if entry.capture is not None}
    chunks = {name: {k: m for r in journal.records for k, m in r.chunks[name].items()} for name in journal.structure}
    coords = [name for name, entry in journal.structure.items() if entry["coord"]]
    # Metadata are written from the journal, so their damage does not matter here.
    for name, content in metadata_files(journal.structure, CAPACITY, {}).items():
        write_file(partial / name, content)
    # The folder gets another name, so that the new store can be written beside it.
    aside = _aside(final)
    os.rename(partial, aside)
    records = [record.attrs for record in journal.records]
    captures = CaptureSet(aside, journal.modality, list(journal.structure), coords, records, journal.texts, chunks)
    try:
        kept = _rewrite(final, captures, dropped, overwrite=overwrite)
    except BaseException:
        if not partial.exists():
            os.rename(aside, partial)
        raise
    _thin(aside, chunks, dropped)
    return Recovery(final, kept, tuple(sorted(dropped)), tuple(damage), aside)


def _readable(root: Path, damage: list[Damage]) -> list[Damage]:
    """`damage`, if all its files could be read. Raises InputError otherwise: dropping them might lose intact data."""
    refused = [entry for entry in damage if entry.unreadable]
    if refused:
        raise InputError(
            f"A file of the store cannot be read: {refused[0]}"
            + (f", and {len(refused) - 1} more." if len(refused) > 1 else "."),
            where=str(root), next_step=ASK_FOR_RIGHTS,
        )  # fmt: skip
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

    with CaptureWriter(path, overwrite=overwrite, keep_replaced=keep_replaced) as writer:
        for capture in sound():
            writer.append(capture)
    return writer.count


def _names(path: str | os.PathLike[str]) -> tuple[Path, Path]:
    given = Path(path).expanduser()
    final = given.with_name(given.name.removesuffix(".partial")) if given.name.endswith(".partial") else given
    partial = partial_of(final)
    if not is_store(partial):
        state = "The store is already complete" if is_store(final) else "There is no unfinished store"
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


def _partial_damage(partial: Path, journal: Journal) -> list[Damage]:
    damage: list[Damage] = []
    for name in journal.structure:
        marks = {key: mark for record in journal.records for key, mark in record.chunks[name].items()}
        damage += chunks_damage(partial / name, name, marks)
    return damage
