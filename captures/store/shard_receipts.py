"""Receipts of a store of many captures: what a shard holds, written once all of its files are on disk.

A receipt states, of each capture, its place, its attributes, its content's id and the sha256 of its chunks; it is written twice,
so that a flipped bit in one is mended from the other. What has no receipt is not there.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import secrets
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...scenes.errors import InputError
from ...scenes.json_keys import read_json
from .arrays import Structure
from .journal import fsync_path, write_file
from .layout import attributes_problem, structure_problem
from .manifest import FORMAT, regular_size
from .shard_chunks import EMPTY, grid_of, index_bytes

__all__ = [
    "COPY", "RECEIPTS", "SHARDED_VERSION", "Chunk", "Held", "Receipt", "chunk_count", "content_of", "file_size", "list_receipts",
    "read_either", "read_receipt", "receipt_name", "shard_table", "shards_of", "write_receipt",
]  # fmt: skip

#: The folder of receipts, and the end of the name of each one's copy.
RECEIPTS, COPY = "receipts", ".copy"
SHARDED_VERSION = 3
_NAME = re.compile(r"([a-z0-9][a-z0-9_]{0,60})\.([0-9]{1,9})\.z")
#: Most bytes that a receipt unpacks to.
_MOST_BYTES = 2**28
_GROUP = re.compile(r"[a-z0-9][a-z0-9_]{0,60}")
_ARRAY = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.\-]{0,200}")

Chunk = tuple[int, int, str]
"""Offset and size of a chunk in its shard's file, and its sha256 in hex."""


@dataclass(frozen=True)
class Held:
    """One capture of a shard.

    Main arguments:
        index: its number in the data set. row: its place in the shard.
        attrs: its encoded attributes. content: id of its content.
        chunks: the chunks of each array. facts: what the index tells of it.
    """

    index: int
    row: int
    attrs: dict[str, list[Any]]
    content: str
    chunks: dict[str, list[Chunk]]
    facts: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Receipt:
    """What a shard holds.

    Main arguments:
        group, shard, modality, structure: its place and its layout. length: captures of a whole shard.
        captures, texts: what it holds, and long attributes by their sha256. job: what identifies the request.
    Other arguments:
        lost: captures that a repair had to drop; each is made again from its attributes, and known by the sha256 of its chunks.
        raw: the bytes of the file that it was read from: another version of zlib may write others.
    """

    group: str
    shard: int
    modality: str
    structure: Structure
    length: int
    captures: list[Held]
    texts: dict[str, str]
    job: str = ""
    lost: list[Held] = field(default_factory=list)
    raw: bytes = field(default=b"", compare=False, repr=False)

    @property
    def content(self) -> str:
        """The id of the captures of this shard, in their order."""
        return hashlib.sha256("\n".join(f"{one.index} {one.content}" for one in self.captures).encode()).hexdigest()

    def content_bytes(self) -> bytes:
        """The receipt as it is stored."""
        if self.raw:
            return self.raw
        body = {
            "format": FORMAT, "store_version": SHARDED_VERSION, "group": self.group, "shard": self.shard,
            "modality": self.modality, "structure": self.structure, "length": self.length, "job": self.job,
            "captures": [vars(one) for one in self.captures], "texts": self.texts,
        }  # fmt: skip
        if self.lost:
            body["lost"] = [vars(one) for one in self.lost]
        text = json.dumps(body, sort_keys=True).encode()
        return zlib.compress(hashlib.sha256(text).hexdigest().encode() + b" " + text, 6)


def content_of(arrays: Mapping[str, np.ndarray[Any, Any]], attrs: Mapping[str, Any]) -> str:
    """The id of a capture's content: sha256 of all values, decoded, and of all attributes but the provenance.

    It is independent of compression, of chunks, and of the machine; equal captures have equal ids.
    """
    found = hashlib.sha256()
    for name in sorted(arrays):
        values = np.ascontiguousarray(arrays[name])
        found.update(f"{name} {values.dtype.name} {values.shape}\n".encode())
        found.update(values.astype(values.dtype.newbyteorder("<"), copy=False).reshape(-1).view(np.uint8).data)
    kept = {name: value for name, value in attrs.items() if name != "provenance"}
    found.update(json.dumps(kept, sort_keys=True).encode())
    return found.hexdigest()


def receipt_name(group: str, shard: int) -> str:
    """File of a receipt in its folder."""
    return f"{group}.{shard:06d}.z"


def list_receipts(root: Path) -> list[tuple[str, int]]:
    """(group, shard) of every receipt, sorted. Raises OSError."""
    folder = root / RECEIPTS
    if folder.is_symlink() or not folder.is_dir():
        return []
    found = set()
    for path in folder.iterdir():
        match = _NAME.fullmatch(path.name.removesuffix(COPY))
        if match and regular_size(path) is not None:
            found.add((match[1], int(match[2])))
    return sorted(found)


def write_receipt(root: Path, receipt: Receipt) -> bytes:
    """Write a receipt and its copy, forced to disk with their folder, and return its bytes. Raises OSError."""
    content = receipt.content_bytes()
    name = receipt_name(receipt.group, receipt.shard)
    # Another machine may write the same shard, of a worker that was taken for dead: each has temporary files of its own.
    mark = secrets.token_hex(16)
    # The copy first: a receipt without a copy is never there, but for damage.
    write_file(root / RECEIPTS / (name + COPY), content, mark)
    write_file(root / RECEIPTS / name, content, mark)
    fsync_path(root / RECEIPTS)
    return content


def read_either(root: Path, group: str, shard: int) -> Receipt:
    """A receipt, or its copy where it is damaged. Raises InputError where both are."""
    try:
        return read_receipt(root, group, shard)
    except InputError:
        return read_receipt(root, group, shard, copy=True)


def read_receipt(root: Path, group: str, shard: int, *, copy: bool = False, digest: str = "") -> Receipt:
    """A receipt. Raises InputError where it is missing, damaged, or not one of a store: another sha256 than `digest`, wrong
    types, names that lead elsewhere."""
    path = root / RECEIPTS / (receipt_name(group, shard) + (COPY if copy else ""))
    try:
        if regular_size(path) is None:
            raise ValueError("it is missing")
        content = path.read_bytes()
        if digest and hashlib.sha256(content).hexdigest() != digest:
            raise ValueError("its sha256 does not match")
        return replace(_checked(_unpacked(content), group, shard), raw=content)
    except (OSError, KeyError, TypeError, AttributeError, ValueError, zlib.error) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"A receipt of the store is damaged: {error}.", where=str(path),
            next_step=f"`beambench data repair {root}` takes its copy",
        ) from error  # fmt: skip


def _unpacked(content: bytes) -> Any:
    unpack = zlib.decompressobj()
    plain = unpack.decompress(content, _MOST_BYTES)
    if not unpack.eof or unpack.unconsumed_tail or unpack.unused_data:
        raise ValueError("it is cut off, or too large")
    digest, _, text = plain.partition(b" ")
    if hashlib.sha256(text).hexdigest().encode() != digest:
        raise ValueError("its checksum does not match")
    return read_json(text)


def _checked(body: Any, group: str, shard: int) -> Receipt:
    if (body["format"], body["store_version"]) != (FORMAT, SHARDED_VERSION):
        raise ValueError(f"it is of version {body['store_version']!r}, not {SHARDED_VERSION}")
    if (body["group"], body["shard"]) != (group, shard) or not _GROUP.fullmatch(group):
        raise ValueError("it is of another shard")
    structure, length, texts = body["structure"], body["length"], body["texts"]
    if not isinstance(structure, dict) or not structure or not all(_ARRAY.fullmatch(name) for name in structure):
        raise ValueError("it describes no arrays")
    if problem := structure_problem(structure):
        raise ValueError(f"{problem[0]}: {problem[1]}")
    if type(length) is not int or not 0 < length <= 2**20 or not isinstance(texts, dict):
        raise ValueError("it states no length, or no texts")
    counts = {name: math.prod(grid_of(entry)) for name, entry in structure.items()}
    captures = [_held(one, counts, texts, length) for one in body["captures"]]
    lost = [_held(one, counts, texts, length) for one in body.get("lost", [])]
    if len({one.row for one in (*captures, *lost)}) != len(captures) + len(lost):
        raise ValueError("two captures have one place")
    return Receipt(group, shard, str(body["modality"]), structure, length, captures, texts, str(body["job"]), lost)


def _held(one: Any, counts: dict[str, int], texts: dict[str, str], length: int) -> Held:
    """One capture of a receipt; `counts`: how many chunks of each array it has. Raises ValueError, KeyError, TypeError."""
    index, row, content = one["index"], one["row"], one["content"]
    if type(index) is not int or not 0 <= index < 2**40 or type(row) is not int or not 0 <= row < length:
        raise ValueError("a capture has no possible number")
    if not isinstance(content, str) or len(content) != 64 or not isinstance(one["facts"], dict):
        raise ValueError("a capture has no content id")
    if problem := attributes_problem(one["attrs"], texts):
        raise ValueError(problem)
    if set(one["chunks"]) != set(counts):
        raise ValueError("a capture has chunks of other arrays")
    chunks = {name: [_chunk(mark) for mark in marks] for name, marks in one["chunks"].items()}
    for name, marks in chunks.items():
        if len(marks) != counts[name]:
            raise ValueError(f"a capture has {len(marks)} chunks of {name}")
    return Held(index, row, one["attrs"], content, chunks, one["facts"])


def _chunk(mark: Any) -> Chunk:
    offset, size, digest = mark
    if type(offset) is not int or type(size) is not int or not isinstance(digest, str):
        raise ValueError(f"mark {mark!r}")
    if not (0 <= offset < 2**48 and 0 < size < 2**40):
        raise ValueError(f"mark {mark!r}")
    return offset, size, digest


def shards_of(root: Path) -> Iterator[Receipt]:
    """Every receipt, one in memory at a time. Raises InputError, OSError."""
    for group, shard in list_receipts(root):
        yield read_either(root, group, shard)


def chunk_count(entry: dict[str, Any], length: int) -> int:
    """Chunks of a whole shard of an array."""
    return length * math.prod(grid_of(entry))


def file_size(receipt: Receipt, name: str) -> int:
    """Bytes of a shard's file of the array `name`."""
    ends = [offset + size for one in receipt.captures for offset, size, _ in one.chunks[name]]
    return max(ends, default=0) + 16 * chunk_count(receipt.structure[name], receipt.length) + 4


def shard_table(receipt: Receipt, name: str) -> bytes:
    """The table at the end of a shard's file, as it follows from the receipt."""
    each = math.prod(grid_of(receipt.structure[name]))
    table = [EMPTY] * (receipt.length * each)
    for one in receipt.captures:
        table[one.row * each : (one.row + 1) * each] = [(offset, size) for offset, size, _ in one.chunks[name]]
    return index_bytes(table)
