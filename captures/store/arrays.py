"""Layout of captures in Zarr v3: one array per variable, first dimension `capture`, one file per capture and block of rows.

The last codec of every array is CRC-32C, so that a flipped bit is detected. Two captures never share a chunk: writing is
an append, a crash loses only the last capture, and a reader loads one capture without the others.
"""

from __future__ import annotations

import hashlib
import json
import math
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ...scenes.errors import InputError

if TYPE_CHECKING:
    import xarray as xr
    import zarr

__all__ = [
    "CAPACITY",
    "chunk_bytes",
    "chunk_keys",
    "chunk_shape",
    "decode_attributes",
    "encode_attributes",
    "metadata_files",
    "open_arrays",
    "structure_of",
]

CAPACITY = 2**31
"""Length of `capture` while a store is being written; the actual one is set at the end."""

CHUNK_BYTES = 8 * 2**20
_LONG_TEXT = 80

Structure = dict[str, dict[str, Any]]


def structure_of(capture: xr.Dataset) -> Structure:
    """Properties that all captures of one store share: names in order, dims, shape, dtype, role and attributes."""
    structure: Structure = {}
    for name, variable in capture.variables.items():
        if variable.dtype.kind not in "biufc":
            raise InputError(
                "Only numbers and flags can be stored.",
                where=str(name), value=str(variable.dtype), allowed="bool, int, uint, float, complex",
            )  # fmt: skip
        structure[str(name)] = {
            "dims": [str(dim) for dim in variable.dims],
            "shape": list(variable.shape),
            "dtype": variable.dtype.name,
            "coord": name in capture.coords,
            "attrs": {str(key): _plain(value, str(name)) for key, value in variable.attrs.items()},
        }
    return structure


def chunk_shape(dims: list[str], shape: list[int], itemsize: int) -> tuple[int, ...]:
    """Chunk of one capture: all of it, or blocks of rows (else of the first dimension) of at most `CHUNK_BYTES`."""
    total = itemsize * math.prod(shape)
    chunk = list(shape)
    if total > CHUNK_BYTES:
        axis = dims.index("row") if "row" in dims else 0
        per_index = total // shape[axis]
        chunk[axis] = max(1, min(shape[axis], CHUNK_BYTES // max(1, per_index)))
    return tuple(chunk)


def chunk_bytes(entry: dict[str, Any]) -> int:
    """Bytes of one unpacked chunk of the array described by `entry`; those at an edge are as large as all others."""
    itemsize = int(np.dtype(entry["dtype"]).itemsize)
    return itemsize * math.prod(chunk_shape(entry["dims"], entry["shape"], itemsize))


def chunk_keys(index: int, entry: dict[str, Any]) -> list[str]:
    """Names of the files that hold capture `index` of the array described by `entry`."""
    shape = entry["shape"]
    chunk = chunk_shape(entry["dims"], shape, np.dtype(entry["dtype"]).itemsize)
    counts = [math.ceil(n / c) for n, c in zip(shape, chunk, strict=True)]
    return [".".join(["c", str(index), *map(str, block)]) for block in np.ndindex(*counts)]


def metadata_files(structure: Structure, length: int, attributes: dict[str, Any]) -> dict[str, bytes]:
    """Content of every `zarr.json` by path: a group with `attributes`, and its arrays of `length` along `capture`.

    It depends on the structure only, so that metadata can be written again at any time.
    """
    import zarr
    from zarr.codecs import BloscCodec, Crc32cCodec
    from zarr.storage import MemoryStore

    store = MemoryStore()
    coords = " ".join(name for name, entry in structure.items() if entry["coord"])
    group = zarr.create_group(store, zarr_format=3, attributes={"coordinates": coords, **attributes})
    for name, entry in structure.items():
        dtype = np.dtype(entry["dtype"])
        group.create_array(
            name,
            shape=(length, *entry["shape"]),
            chunks=(1, *chunk_shape(entry["dims"], entry["shape"], dtype.itemsize)),
            dtype=dtype,
            # Level 1 with shuffled bytes: Poisson counts are compressed to .35, as at level 3, at 340 MB/s.
            compressors=(
                BloscCodec(typesize=dtype.itemsize, cname="zstd", clevel=1, shuffle="shuffle"),
                Crc32cCodec(),
            ),
            fill_value=_fill(dtype),
            dimension_names=("capture", *entry["dims"]),
            chunk_key_encoding={"name": "default", "separator": "."},
            attributes=entry["attrs"],
        )
    with warnings.catch_warnings():
        # zarr warns that consolidated metadata are an extension; with them other readers need not list the folder.
        warnings.simplefilter("ignore")
        zarr.consolidate_metadata(store, zarr_format=3)
    return {key: value.to_bytes() for key, value in store._store_dict.items() if key.endswith("zarr.json")}


def open_arrays(root: Path, names: Iterable[str], mode: Literal["r", "r+"]) -> dict[str, zarr.Array[Any]]:
    """The arrays of the store at `root` by name. Raises OSError."""
    import zarr
    from zarr.storage import LocalStore

    # A store, not text: text with "::" or "://" in it would be taken for a URL.
    group = zarr.open_group(LocalStore(root, read_only=mode == "r"), mode=mode, zarr_format=3, use_consolidated=False)
    arrays = {}
    for name in names:
        array = group[name]
        assert isinstance(array, zarr.Array)
        # An unwritten chunk would read as the fill value and could not be distinguished from a lost one.
        arrays[name] = array.with_config({"write_empty_chunks": True})
    return arrays


def encode_attributes(attrs: dict[str, Any], texts: dict[str, str]) -> dict[str, list[Any]]:
    """Attributes of one capture as JSON, long texts replaced by their sha256 in `texts` (rigs repeat)."""
    encoded: dict[str, list[Any]] = {}
    for name, value in attrs.items():
        if isinstance(value, str) and len(value) > _LONG_TEXT:
            key = hashlib.sha256(value.encode("utf-8", "surrogatepass")).hexdigest()
            texts[key] = value
            encoded[str(name)] = ["text", key]
        else:
            encoded[str(name)] = ["value", _plain(value, f"attribute {name}")]
    return encoded


def decode_attributes(encoded: dict[str, list[Any]], texts: dict[str, str]) -> dict[str, Any]:
    """Inverse of `encode_attributes`. Raises KeyError where a text is absent."""
    return {name: texts[value] if kind == "text" else value for name, (kind, value) in encoded.items()}


def _plain(value: object, where: str) -> Any:
    plain = value.item() if isinstance(value, np.generic) else value
    try:
        copy = json.loads(json.dumps(plain, allow_nan=False))
    except (TypeError, ValueError, RecursionError):
        copy = None
    if type(copy) is not type(plain) or copy != plain:
        raise InputError(
            "The attribute does not survive being written as JSON.",
            where=where, value=value, allowed="text, number, flag, or a list of them",
        )  # fmt: skip
    return copy


def _fill(dtype: np.dtype[Any]) -> Any:
    return dtype.type(np.nan) if dtype.kind in "fc" else dtype.type(0)
