"""Read a store of many captures: one group of it, as a sequence whose captures are loaded on demand."""

from __future__ import annotations

import hashlib
import os
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Iterable, Sequence
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsIndex

import numpy as np

from ...scenes.errors import InputError
from ..validate import validate
from .arrays import decode_attributes
from .layout import size_problem
from .manifest import check_metadata_files, regular_size, safe_join, sha256_file
from .reader import CaptureSet
from .shard_chunks import blocks_of, decode_block, shard_key
from .shard_index import read_index
from .shard_manifest import INDEX, Group, ShardedManifest, load_sharded
from .shard_receipts import COPY, Held, Receipt, read_receipt, receipt_name

if TYPE_CHECKING:
    import pyarrow as pa
    import xarray as xr
    import zarr

__all__ = ["ShardedSet", "open_sharded"]

#: Receipts that a reader keeps: some hundred kB each.
_KEPT = 16


def open_sharded(root: Path, group: str = "") -> ShardedSet:
    """One group of the store at `root`, after checking its manifest, its metadata, and that each file exists in full size.

    Raises InputError: damaged metadata, missing or truncated files; no such group, or none named where there are several.
    """
    manifest = load_sharded(root)
    names = list(manifest.groups)
    if group not in manifest.groups and (group or len(names) > 1):
        raise InputError(
            "The data set has no such group." if group else "The data set has several modalities.", where=str(root),
            value=group or None, allowed=", ".join(str(root / name) for name in names),
            next_step="give the folder of one of them",
        )  # fmt: skip
    problems = check_metadata_files(
        root, {n: d for n, d in manifest.metadata.items() if n not in (INDEX, f"{INDEX}{COPY}")}
    )
    for place, one in [] if problems else manifest.shards.items():
        for name, size in one.sizes.items():
            key = shard_key(place[1], manifest.groups[place[0]].structure[name])
            found = regular_size(safe_join(root, f"{place[0]}/{name}/{key}"))
            if found != size:
                told = "missing" if found is None else f"{found} bytes, not {size}"
                problems.append((f"{place[0]}/{name}/{key}", told))
    if problems:
        (name, problem), *more = problems
        raise InputError(
            f"The store is damaged: {name}: {problem}" + (f", and {len(more)} more." if more else "."), where=str(root),
            next_step=f"`beambench data verify {root}` lists the damage, `beambench data repair {root}` mends it",
        )  # fmt: skip
    return ShardedSet(root, manifest, manifest.groups[group or names[0]])


class ShardedSet(CaptureSet):
    """The captures of one group, as `CaptureSet`; `index(i)` tells what the data set drew for one.

    A receipt is read when one of its captures is asked for first: memory does not depend on the number of captures.
    """

    def __init__(self, root: Path, manifest: ShardedManifest, group: Group) -> None:
        self.path, self.sha256, self.modality = root, manifest.sha256, group.modality
        self.variables = tuple(group.structure)
        self.content = manifest.content
        self._group, self._manifest = group, manifest
        self._shards = [number for name, number in manifest.shards if name == group.name]
        self._ends = list(accumulate(manifest.shards[group.name, number].count for number in self._shards))
        self._kept: OrderedDict[int, Receipt] = OrderedDict()
        self._arrays: dict[str, zarr.Array[Any]] | None = None
        sizes = (
            {"": {"0.0": (sum(manifest.shards[group.name, self._shards[0]].sizes.values()), "")}}
            if self._shards
            else {}
        )
        if problem := size_problem(group.structure, sizes):
            raise InputError(f"The metadata of the store are not those of captures: {problem}.", where=str(root))

    @property
    def arrays(self) -> dict[str, zarr.Array[Any]]:  # type: ignore[override]
        """The arrays of the group, as zarr reads them; a capture that was dropped is a row of fill values in them."""
        from .arrays import open_arrays

        if self._arrays is None:
            self._arrays = open_arrays(self.path / self._group.name, self._group.structure, "r")
        return self._arrays

    @property
    def group(self) -> str:
        """Name of the group in the data set."""
        return self._group.name

    def table(self, columns: Sequence[str] | None = None) -> pa.Table:
        """The index of the whole data set, or some columns of it. Raises InputError where it is damaged."""
        import pyarrow as pa

        path = self.path / INDEX
        try:
            if sha256_file(path) != self._manifest.metadata.get(INDEX):
                raise ValueError("sha256 does not match")
            return read_index(path, columns)
        except (OSError, ValueError, pa.ArrowException) as error:
            raise self._damage(INDEX, str(error)) from error

    @property
    def shard_starts(self) -> list[int]:
        """The first capture of each shard, and the number of captures: readers shuffle by shard."""
        return [0, *self._ends]

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __repr__(self) -> str:
        return f"<ShardedSet of {len(self)} {self.modality} captures in {str(self.path)!r}>"

    def attributes(self, index: SupportsIndex) -> dict[str, Any]:
        """Attributes of one capture. Raises CaptureIndexError; InputError for a damaged receipt."""
        receipt, held = self._held(self._index(index))
        return decode_attributes(held.attrs, receipt.texts)

    def number(self, index: SupportsIndex) -> int:
        """The number of a capture in its data set, all captures of which have one seed."""
        return self._held(self._index(index))[1].index

    def index(self, index: SupportsIndex) -> dict[str, Any]:
        """What the index tells of one capture: its number in the data set, its part of the split, what was drawn."""
        _, held = self._held(self._index(index))
        return {"capture": held.index, "content": held.content, **held.facts}

    def load(self, index: SupportsIndex, names: Iterable[str] | None = None) -> xr.Dataset:
        """One capture in memory, without the `capture` dimension. As `CaptureSet.load`."""
        import xarray as xr

        number = self._index(index)
        wanted = self.variables if names is None else tuple(names)
        arrays = self.values(number, wanted)
        data: dict[str, xr.Variable] = {}
        coords: dict[str, xr.Variable] = {}
        for name in wanted:
            entry = self._group.structure[name]
            (coords if entry["coord"] else data)[name] = xr.Variable(entry["dims"], arrays[name], dict(entry["attrs"]))
        capture = xr.Dataset(data, coords, self.attributes(number))
        if names is None:
            validate(capture, "layout", where=f"{self.path}: capture {number}")
        return capture

    def values(self, index: SupportsIndex, names: Iterable[str] | None = None) -> dict[str, np.ndarray[Any, Any]]:
        """Arrays of one capture by name, without attributes: what a loader of batches needs.

        Raises CaptureIndexError; InputError for an unknown name, a missing or damaged chunk, or too little memory.
        """
        receipt, held = self._held(self._index(index))
        wanted = self.variables if names is None else tuple(names)
        for name in wanted:
            if name not in self._group.structure:
                raise InputError(
                    "The store has no such variable.",
                    where=str(self.path),
                    value=name,
                    allowed=", ".join(self.variables),
                )
        self._check_room([self._group.structure[name] for name in wanted])
        return {name: self._read_sharded(receipt, held, name) for name in wanted}

    def _held(self, number: int) -> tuple[Receipt, Held]:
        place = bisect_right(self._ends, number)
        receipt = self._kept.get(place)
        if receipt is None:
            receipt = self._receipt(self._shards[place])
            self._kept[place] = receipt
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        else:
            self._kept.move_to_end(place)
        return receipt, receipt.captures[number - (self._ends[place - 1] if place else 0)]

    def _receipt(self, shard: int) -> Receipt:
        listed = self._manifest.shards[self._group.name, shard]
        try:
            receipt = read_receipt(self.path, self._group.name, shard, digest=listed.digest)
        except InputError:
            receipt = read_receipt(self.path, self._group.name, shard, copy=True, digest=listed.digest)
        if receipt.structure != self._group.structure or len(receipt.captures) != listed.count:
            raise self._damage(receipt_name(self._group.name, shard), "it does not agree with the manifest")
        return receipt

    def _read_sharded(self, receipt: Receipt, held: Held, name: str) -> np.ndarray[Any, Any]:
        entry = receipt.structure[name]
        path = self.path / self._group.name / name / shard_key(receipt.shard, entry)
        marks = held.chunks[name]
        try:
            if self.path.joinpath(self._group.name).is_symlink() or path.parent.is_symlink():
                raise ValueError("its folder is a link")
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
            try:
                parts = [_chunk(descriptor, mark) for mark in marks]
            finally:
                os.close(descriptor)
            if len(parts) == 1:
                return decode_block(parts[0], entry)
            whole = np.empty(tuple(entry["shape"]), entry["dtype"])
            for place, content in zip(blocks_of(entry), parts, strict=True):
                whole[place] = decode_block(content, entry)
            return whole
        except (OSError, ValueError) as error:
            raise self._damage(f"{self._group.name}/{name}, capture {held.index}", str(error)) from error


def _chunk(descriptor: int, mark: tuple[int, int, str]) -> bytes:
    offset, size, digest = mark
    content = os.pread(descriptor, size, offset)
    if hashlib.sha256(content).hexdigest() != digest:
        raise ValueError("sha256 does not match" if len(content) == size else f"{len(content)} bytes, not {size}")
    return content
