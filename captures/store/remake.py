"""Make damaged captures again: a chunk takes the place of a damaged one only if it has the sha256 of what was written."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...scenes.errors import InputError
from .arrays import chunk_keys, metadata_files, structure_of
from .journal import write_file
from .manifest import Mark

if TYPE_CHECKING:
    import xarray as xr

    from .reader import CaptureSet
    from .verification import Damage

__all__ = ["Again", "Make"]

Make = Callable[[dict[str, Any], str], "xr.Dataset"]
"""(attributes of a capture, its place for messages) -> the capture made again. Raises InputError where it cannot be."""


class Again:
    """The damaged captures of a store, made again where that is possible.

    Main arguments:
        root, captures, chunks: folder of the store, its captures, and the marks of its chunks by array. make: makes a capture
            again; None makes none.

    After `heal`: `left` is the damage that remains, `remade` the captures made again, `reasons` why others were not.
    """

    def __init__(self, root: Path, captures: CaptureSet, chunks: dict[str, dict[str, Mark]], make: Make | None) -> None:
        self._root, self._captures, self._chunks, self._make = root, captures, chunks, make
        self.left: list[Damage] = []
        self.remade: tuple[int, ...] = ()
        self.reasons: tuple[str, ...] = ()

    def heal(self, damage: list[Damage]) -> Again:
        """Write sound chunks in place of the damaged ones. Raises InputError where the store cannot be written."""
        healed: dict[int, str] = {}
        if self._make is not None:
            for number in sorted({entry.capture for entry in damage if entry.capture is not None}):
                healed[number] = self._one(number, [entry.file for entry in damage if entry.capture == number])
        self.remade = tuple(number for number, reason in healed.items() if not reason)
        self.reasons = tuple(f"capture {number}: {reason}" for number, reason in healed.items() if reason)
        self.left = [entry for entry in damage if entry.capture is None or healed.get(entry.capture, "no")]
        return self

    def _one(self, number: int, files: list[str]) -> str:
        """Make one capture again and write those of its chunks that are damaged; the reason why not, or ""."""
        assert self._make is not None
        try:
            capture = self._make(self._captures.attributes(number), f"{self._root}, capture {number}")
            made = encoded_chunks(capture, number)
        except InputError as error:
            return f"{error.what} ({error.where})"
        for array, key in (file.split("/") for file in files):
            content = made.get((array, key), b"")
            if not _fits(content, self._chunks[array][key]):
                return f"{array}/{key} made again differs from what was written (other versions, or another processor)"
        for array, key in (file.split("/") for file in files):
            try:
                write_file(self._root / array / key, made[array, key])
            except OSError as error:
                raise InputError(
                    f"A chunk cannot be written: {error.strerror}.", where=str(self._root / array / key),
                    next_step="free space on the disk, or get permission to write",
                ) from error  # fmt: skip
        return ""


def encoded_chunks(capture: xr.Dataset, number: int) -> dict[tuple[str, str], bytes]:
    """The chunk files of a capture that is number `number` of a store, by array and chunk key. Raises InputError."""
    import numpy as np
    import zarr
    from zarr.core.buffer import default_buffer_prototype
    from zarr.storage import MemoryStore

    structure = structure_of(capture)
    prototype = default_buffer_prototype()
    held: dict[str, Any] = {
        name: prototype.buffer.from_bytes(content) for name, content in metadata_files(structure, 1, {}).items()
    }
    store = MemoryStore(held)
    group = zarr.open_group(store, mode="r+", zarr_format=3, use_consolidated=False)
    found: dict[tuple[str, str], bytes] = {}
    for name, entry in structure.items():
        array = group[name]
        assert isinstance(array, zarr.Array)
        array.with_config({"write_empty_chunks": True})[0] = np.asarray(capture.variables[name].values)
        for first, key in zip(chunk_keys(0, entry), chunk_keys(number, entry), strict=True):
            found[name, key] = held[f"{name}/{first}"].to_bytes()
    return found


def _fits(content: bytes, mark: Mark) -> bool:
    """Whether the content is that of the mark, of either version."""
    size, digest = mark
    found = hashlib.sha256(content).hexdigest() if len(digest) == 64 else content[-4:].hex()
    return len(content) == size and found == digest
