"""Chunks and shards of a store of many captures: one file holds one array of one shard, and is valid Zarr v3 (sharding_indexed).

A file is its chunks one after the other, then (offset, bytes) of each as uint64, then the CRC-32C of that table; a chunk is
Blosc (zstd, shuffled) and its CRC-32C. Source: Zarr enhancement proposal 2, "Sharding codec", 2023. Chunks are coded here and
not by zarr, so that one capture is in memory at a time and each chunk's sha256 is known; a test reads the files by zarr.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from .arrays import CHUNK_BYTES

__all__ = [
    "EMPTY", "blocks_of", "decode_block", "encode_block", "grid_of", "index_bytes", "inner_shape", "index_of", "shard_key",
]  # fmt: skip

Array = np.ndarray[Any, Any]
#: Offset and size of a chunk that is not there.
EMPTY = (2**64 - 1, 2**64 - 1)
_ENTRY = np.dtype("<u8")


def inner_shape(entry: dict[str, Any]) -> tuple[int, ...]:
    """Chunk of one capture of an array: all of it, or equal blocks of rows (else of the first dimension) below `CHUNK_BYTES`."""
    dims, shape = entry["dims"], list(entry["shape"])
    total = int(np.dtype(entry["dtype"]).itemsize) * math.prod(shape)
    if total > CHUNK_BYTES:
        axis = dims.index("row") if "row" in dims else 0
        length = shape[axis]
        most = max(1, length * CHUNK_BYTES // total)
        shape[axis] = next(n for n in range(most, 0, -1) if length % n == 0)
    return tuple(shape)


def grid_of(entry: dict[str, Any]) -> tuple[int, ...]:
    """Number of chunks of one capture along each dimension."""
    return tuple(n // c for n, c in zip(entry["shape"], inner_shape(entry), strict=True))


def shard_key(number: int, entry: dict[str, Any]) -> str:
    """Name of the file of a shard in the folder of its array."""
    return ".".join(["c", str(number), *("0" for _ in entry["shape"])])


def blocks_of(entry: dict[str, Any]) -> list[tuple[slice, ...]]:
    """The place of each chunk in its capture, in the order of the table."""
    chunk = inner_shape(entry)
    return [
        tuple(slice(i * c, (i + 1) * c) for i, c in zip(place, chunk, strict=True))
        for place in np.ndindex(*grid_of(entry))
    ]


def encode_block(values: Array) -> bytes:
    """A chunk as it is stored: the bytes that zarr's codecs `bytes`, `blosc` and `crc32c` give."""
    # Little-endian on every machine, as the codec `bytes` states.
    plain = np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<"), copy=False)
    content = bytes(_blosc(plain.dtype.itemsize).encode(plain.reshape(-1).view(np.uint8)))
    return content + _crc32c(content)


def decode_block(content: bytes, entry: dict[str, Any]) -> Array:
    """The values of a stored chunk. Raises ValueError where it is not one of this array."""
    from numcodecs import blosc

    shape, dtype = inner_shape(entry), np.dtype(entry["dtype"]).newbyteorder("<")
    size = math.prod(shape) * dtype.itemsize
    # The size that it unpacks to stands in its header, so that nothing large is unpacked in vain.
    if len(content) < 20 or int.from_bytes(content[4:8], "little") != size:
        raise ValueError(f"it does not unpack to {size} bytes")
    if _crc32c(content[:-4]) != content[-4:]:
        raise ValueError("its checksum does not match")
    found: Array = np.empty(shape, dtype)
    try:
        blosc.decompress(memoryview(content)[:-4], found.reshape(-1).view(np.uint8))
    except (RuntimeError, ValueError) as error:
        raise ValueError(str(error)) from error
    return found if dtype.isnative else found.astype(dtype.newbyteorder("="))


def index_bytes(entries: list[tuple[int, int]]) -> bytes:
    """The table at the end of a shard, with its checksum."""
    content = np.array(entries, _ENTRY).tobytes()
    return content + _crc32c(content)


def index_of(content: bytes, count: int) -> list[tuple[int, int]]:
    """The table at the end of a shard's bytes, of `count` chunks. Raises ValueError where it is damaged."""
    table = content[-(16 * count + 4) :]
    if len(table) != 16 * count + 4 or _crc32c(table[:-4]) != table[-4:]:
        raise ValueError("the table of its chunks is damaged")
    return [(int(a), int(b)) for a, b in np.frombuffer(table[:-4], _ENTRY).reshape(-1, 2)]


@lru_cache(maxsize=16)
def _blosc(itemsize: int) -> Any:
    from numcodecs import blosc

    # One thread: workers share the cores already, and the bytes are the same on every machine.
    blosc.use_threads = False
    return blosc.Blosc(cname="zstd", clevel=1, shuffle=blosc.SHUFFLE, typesize=itemsize)


def _crc32c(content: bytes) -> bytes:
    import google_crc32c

    return int(google_crc32c.value(content)).to_bytes(4, "little")
