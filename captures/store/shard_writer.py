"""Write one shard: one job, one writer, one capture in memory at a time; the receipt comes last.

Shards are written whole. There is no way to write into one that exists: four processes that wrote regions of shared shards lost
23 to 33 % of the captures without a word, when that was tried.
"""

from __future__ import annotations

import hashlib
import os
import secrets
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from ...scenes.errors import InputError
from ..validate import validate
from .arrays import Structure, encode_attributes, structure_of
from .journal import fsync_path
from .publish import disk_error
from .shard_chunks import blocks_of, encode_block, shard_key
from .shard_receipts import Chunk, Held, Receipt, content_of, shard_table, write_receipt

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["ShardWriter"]


class ShardWriter:
    """A shard being written, in a `with` block; it is there once `close` has returned.

    Main arguments:
        root: the unfinished store. group, shard: its place.
        rows: the numbers of its captures in the data set, in the order in which they are appended.
        length: captures of a whole shard. last: whether it is the group's last one, which alone may be shorter.
    Other arguments:
        structure: what every capture must have; that of the first one by default. job: what identifies the request.

    Raises InputError: a shard of another length (it would leave places that read as zeros), a capture of another layout,
    more or fewer captures than `rows`, a full disk.
    """

    def __init__(
        self,
        root: Path,
        group: str,
        shard: int,
        rows: Sequence[int],
        length: int,
        *,
        last: bool,
        structure: Structure | None = None,
        job: str = "",
    ) -> None:
        if not 0 < len(rows) <= length or (len(rows) < length and not last):
            raise InputError(
                "A shard is written whole.", where=f"{root}: {group}, shard {shard}", value=f"{len(rows)} captures",
                allowed=f"{length}, or fewer in the last shard of a group",
            )  # fmt: skip
        self._root, self._group, self._shard, self._job = root, group, shard, job
        self._rows, self._length, self._structure = list(rows), length, structure
        self._modality, self._mark = "", secrets.token_hex(16)
        self._files: dict[str, IO[bytes]] = {}
        self._texts: dict[str, str] = {}
        self._held: list[Held] = []

    def append(self, capture: xr.Dataset, facts: Mapping[str, Any]) -> None:
        """Write one capture. `facts` go into the index. Raises InputError."""
        row = len(self._held)
        where = f"capture {self._rows[row] if row < len(self._rows) else '?'}"
        if row >= len(self._rows):
            raise InputError("The shard is full.", where=f"{self._group}, shard {self._shard}", value=row + 1)
        validate(capture, "values", where=where)
        structure = structure_of(capture)
        if self._structure is None:
            self._structure = structure
        _check_same(structure, self._structure, where)
        self._modality = str(capture.attrs["modality"])
        try:
            if not self._files:
                self._open(structure)
            arrays = {name: np.asarray(capture.variables[name].values) for name in structure}
            chunks = {name: self._chunks(name, values, structure[name]) for name, values in arrays.items()}
        except OSError as error:
            raise disk_error(error, f"Writing {where}", self._root) from error
        attrs = {str(key): value for key, value in capture.attrs.items()}
        encoded = encode_attributes(attrs, self._texts)
        self._held.append(Held(self._rows[row], row, encoded, content_of(arrays, attrs), chunks, dict(facts)))

    def close(self) -> Receipt:
        """Give the shard its files and then its receipt. Raises InputError."""
        if len(self._held) != len(self._rows):
            raise InputError(
                "A shard is written whole.", where=f"{self._group}, shard {self._shard}", value=len(self._held),
                allowed=f"{len(self._rows)} captures",
            )  # fmt: skip
        structure = self._structure
        assert structure is not None
        receipt = Receipt(
            self._group, self._shard, self._modality, structure, self._length, self._held, self._texts, self._job
        )
        try:
            for name, file in self._files.items():
                file.write(shard_table(receipt, name))
                file.flush()
                os.fsync(file.fileno())
                file.close()
                place = self._place(name, structure)
                os.replace(self._temporary(place), place)
                fsync_path(place.parent)
            write_receipt(self._root, receipt)
        except OSError as error:
            raise disk_error(error, "Completing a shard", self._root) from error
        return receipt

    def __enter__(self) -> ShardWriter:
        return self

    def __exit__(self, *_: object) -> None:
        for file in self._files.values():
            with suppress(OSError):
                file.close()

    def _open(self, structure: Structure) -> None:
        for name in structure:
            place = self._place(name, structure)
            place.parent.mkdir(parents=True, exist_ok=True)
            self._files[name] = open(self._temporary(place), "xb")  # noqa: SIM115 (closed by close and __exit__)

    def _temporary(self, place: Path) -> Path:
        # A worker that was taken for dead may write the same shard: its files are not these, and either's are whole.
        return place.with_name(f"{place.name}.{self._mark}.partial")

    def _place(self, name: str, structure: Structure) -> Path:
        return self._root / self._group / name / shard_key(self._shard, structure[name])

    def _chunks(self, name: str, values: np.ndarray[Any, Any], entry: dict[str, Any]) -> list[Chunk]:
        file = self._files[name]
        found: list[Chunk] = []
        for block in blocks_of(entry):
            content = encode_block(values[block])
            found.append((file.tell(), len(content), hashlib.sha256(content).hexdigest()))
            file.write(content)
        return found


def _check_same(this: Structure, first: Structure, where: str) -> None:
    for name in [*first, *(name for name in this if name not in first)]:
        if first.get(name) != this.get(name):
            raise InputError(
                f"All captures of a group must have one layout, but {name} differs.", where=where, value=this.get(name),
                allowed=str(first.get(name)), next_step="draw no parameter that changes sizes, or make a data set for each",
            )  # fmt: skip
