"""Repair a store of many captures: metadata are written again, captures made again or dropped, each file at a time.

A dropped capture leaves its place empty: all others keep theirs, and no file but those of its shard is touched. The receipt still
tells how it was made, so that a later repair that makes captures again brings it back. Every step replaces whole files, so that a
repair which was killed is finished by the next one.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...scenes.errors import InputError
from .arrays import decode_attributes, structure_of
from .journal import fsync_path, write_file
from .manifest import regular_size
from .remake import Make
from .restore import write_changed
from .shard_chunks import blocks_of, encode_block, shard_key
from .shard_finish import read_request, store_files, write_request
from .shard_receipts import (
    COPY,
    RECEIPTS,
    Held,
    Receipt,
    list_receipts,
    read_either,
    read_receipt,
    receipt_name,
    shard_table,
    write_receipt,
)
from .shard_verify import shard_damage, verify_sharded
from .verification import FOREIGN, Damage, unreadable_store

__all__ = ["Mended", "mend_shards", "repair_sharded"]


@dataclass(frozen=True)
class Mended:
    """What a repair did: captures by their number in the store before it, files by their names."""

    kept: int
    dropped: tuple[int, ...]
    damage: tuple[Damage, ...]
    restored: tuple[str, ...]
    remade: tuple[int, ...]
    not_remade: tuple[str, ...]


def repair_sharded(root: Path, make: Make | None) -> Mended:
    """Mend the finished store at `root` in its place. `make` makes a capture again from its attributes.

    Raises InputError: a file that is not the store's, one that cannot be read, no capture left, a disk that is full.
    """
    damage = verify_sharded(root)
    if refused := [one for one in damage if one.unreadable]:
        raise unreadable_store(root, refused)
    if foreign := [one for one in damage if one.problem == FOREIGN]:
        raise InputError(
            f"The store holds files that are not its own: {foreign[0].file}.", where=str(root),
            next_step="move them away, then try again",
        )  # fmt: skip
    try:
        restored = _receipts(root)
        dropped, remade, reasons = mend_shards(root, make)
        restored += _metadata(root)
    except OSError as error:
        raise InputError(
            f"The store cannot be written: {error.strerror}.", where=str(root),
            next_step="free space on the disk, or get permission to write",
        ) from error  # fmt: skip
    kept = sum(len(read_either(root, *place).captures) for place in list_receipts(root))
    return Mended(kept, dropped, tuple(damage), tuple(restored), remade, reasons)


def _receipts(root: Path) -> list[str]:
    """Write the request, receipts and copies that are damaged again, each from its other; a lost pair is removed."""
    from .shard_finish import request_bytes
    from .shard_manifest import DATASET

    written = []
    request = read_request(root)
    for name in (DATASET, DATASET + COPY):
        if regular_size(root / name) is None or (root / name).read_bytes() != request_bytes(request):
            written.append(name)
    if written:
        write_request(root, request)
    for place in list_receipts(root):
        sound: dict[str, bytes] = {}
        names = [receipt_name(*place), receipt_name(*place) + COPY]
        for name in names:
            try:
                read_receipt(root, *place, copy=name.endswith(COPY))
                sound[name] = (root / RECEIPTS / name).read_bytes()
            except InputError:
                continue
        if not sound:
            continue  # its captures are lost with it; `mend_shards` drops the shard
        content = sound.get(names[0], next(iter(sound.values())))
        for name in names:
            if sound.get(name) != content:
                write_file(root / RECEIPTS / name, content)
                written.append(f"{RECEIPTS}/{name}")
    fsync_path(root / RECEIPTS)
    return written


def mend_shards(root: Path, make: Make | None) -> tuple[tuple[int, ...], tuple[int, ...], tuple[str, ...]]:
    """Make damaged captures again, or drop them, and make again those that were dropped before; (dropped, remade, reasons).

    Captures have the numbers of their places; those that were dropped before, that in the data set. Raises InputError, OSError.
    """
    dropped: list[int] = []
    remade: list[int] = []
    reasons: list[str] = []
    first = 0
    for place in list_receipts(root):
        try:
            receipt = read_either(root, *place)
        except InputError:
            reasons.append(
                f"shard {receipt_name(*place)}: both of its receipts are damaged; `generate … --resume` makes it again"
            )
            for name in (receipt_name(*place), receipt_name(*place) + COPY):
                (root / RECEIPTS / name).unlink(missing_ok=True)
            continue
        damage = shard_damage(root, receipt, first)
        if damage or (receipt.lost and make is not None):
            shard = _Shard(root, receipt, first, damage)
            shard.mend(make)
            dropped += shard.dropped
            remade += shard.remade
            reasons += shard.reasons
        first += len(receipt.captures)
    if first and len(dropped) == first and not remade:
        raise InputError("No capture is intact.", where=str(root), next_step="generate the data anew")
    return tuple(dropped), tuple(remade), tuple(reasons)


class _Shard:
    """A damaged shard; its captures have the numbers from `first`."""

    def __init__(self, root: Path, receipt: Receipt, first: int, damage: list[Damage]) -> None:
        self._root, self._receipt, self._first = root, receipt, first
        self._files = {one.file for one in damage}
        self._broken = sorted({one.capture for one in damage if one.capture is not None})
        self._all = False  # whether the files of all arrays are written again
        self.dropped: list[int] = []
        self.remade: list[int] = []
        self.reasons: list[str] = []

    def mend(self, make: Make | None) -> None:
        """Write its damaged files again; those of all arrays, and the receipt first, where a capture is dropped."""
        new: dict[tuple[int, str], list[bytes]] = {}
        for number in self._broken:
            held = self._receipt.captures[number - self._first]
            reason = "no maker is given" if make is None else self._again(held, make, new)
            if not reason:
                self.remade.append(number)
                continue
            self.dropped.append(number)
            if make is not None:
                self.reasons.append(f"capture {number}: {reason}")
        receipt = self._changed(() if make is None else self._back(make, new))
        if not receipt.captures:
            write_receipt(self._root, receipt)  # it alone tells how they were made
            for name in receipt.structure:
                self._path(name).unlink(missing_ok=True)
            return
        contents = {name: self._file(receipt, name, new) for name in self._touched()}
        for name, content in contents.items():
            write_file(self._path(name), content)
            fsync_path(self._path(name).parent)
        if receipt is not self._receipt:
            write_receipt(self._root, receipt)

    def _back(self, make: Make, new: dict[tuple[int, str], list[bytes]]) -> list[Held]:
        """Those captures that were dropped by an earlier repair and are made again."""
        back = []
        for held in self._receipt.lost:
            if reason := self._again(held, make, new):
                self.reasons.append(f"capture {held.index}: {reason}")
            else:
                back.append(held)
                self.remade.append(held.index)
        return back

    def _changed(self, back: Iterable[Held]) -> Receipt:
        """The receipt without the captures that are dropped, which it lists as lost, and with those that are `back`."""
        old, back = self._receipt, [*back]
        gone = [old.captures[number - self._first] for number in self.dropped]
        if not gone and not back:
            return old
        self._all = True
        rows, returned = {held.row for held in gone}, {held.row for held in back}
        captures = [held for held in old.captures if held.row not in rows] + back
        lost = [held for held in old.lost if held.row not in returned] + gone
        return replace(
            old,
            captures=sorted(captures, key=lambda held: held.row),
            lost=sorted(lost, key=lambda held: held.row),
            raw=b"",
        )

    def _touched(self) -> Iterable[str]:
        names = self._receipt.structure
        return names if self._all else [n for n in names if str(self._path(n).relative_to(self._root)) in self._files]

    def _path(self, name: str) -> Path:
        entry = self._receipt.structure[name]
        return self._root / self._receipt.group / name / shard_key(self._receipt.shard, entry)

    def _again(self, held: Held, make: Make, new: dict[tuple[int, str], list[bytes]]) -> str:
        """Make a capture again; the reason why it is not what was written, or ""."""
        structure = self._receipt.structure
        try:
            attrs = decode_attributes(held.attrs, self._receipt.texts)
            capture = make(attrs, f"{self._root}, capture {held.index}")
            if structure_of(capture) != structure:
                return "made again it has another layout"
        except InputError as error:
            return f"{error.what} ({error.where})"
        for name, entry in structure.items():
            values = np.asarray(capture.variables[name].values)
            parts = [encode_block(values[block]) for block in blocks_of(entry)]
            if [hashlib.sha256(part).hexdigest() for part in parts] != [mark[2] for mark in held.chunks[name]]:
                return f"{name} made again differs from what was written (other versions, or another processor)"
            new[held.row, name] = parts
        return ""

    def _file(self, receipt: Receipt, name: str, new: dict[tuple[int, str], list[bytes]]) -> bytes:
        """The content of the file of one array: each chunk at its place, from the disk or made again."""
        path = self._path(name)
        if path.parent.is_symlink() or path.parent.parent.is_symlink():
            raise InputError(
                "A folder of the store is a link.", where=str(path.parent), next_step="do not use this store"
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        old = path.read_bytes() if regular_size(path) is not None else b""
        marks = [mark for held in receipt.captures for mark in held.chunks[name]]
        content = bytearray(max((offset + size for offset, size, _ in marks), default=0))
        for held in receipt.captures:
            for part, (offset, size, _) in enumerate(held.chunks[name]):
                made = new.get((held.row, name))
                content[offset : offset + size] = made[part] if made else old[offset : offset + size]
        return bytes(content) + shard_table(receipt, name)


def _metadata(root: Path) -> list[str]:
    """Write all metadata that differ from what the receipts give."""
    places = list_receipts(root)
    _, files = store_files(root, (read_either(root, *place) for place in places))
    return write_changed(root, files)
