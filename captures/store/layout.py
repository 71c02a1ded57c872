"""Whether a stated layout can be that of a store: it comes from a file, and is checked before any array is opened or made.

Shapes, types and sizes are bounded here, for journals, second manifests and stores alike: a file of kilobytes can state arrays of
petabytes, and blosc packs gigabytes of zeros into kilobytes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from .arrays import Structure, chunk_shape
from .manifest import Mark

__all__ = [
    "LARGE_BYTES",
    "array_problem",
    "attributes_problem",
    "group_structure",
    "size_problem",
    "structure_problem",
]

#: Numbers and flags that a store holds.
_TYPES = {
    "bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float16", "float32", "float64",
    "complex64", "complex128",
}  # fmt: skip
#: Most bytes of one capture's arrays: more than any memory that a capture is made in.
_MOST_BYTES = 2**36
#: A capture of more bytes than this must fill at least this share of them on disk. Counts that are all zero, as nearly are those
#: of single photons, are packed to 1/1211 by the writer of this package: blosc packs blocks apart, and each has a header.
LARGE_BYTES, _LEAST_SHARE = 2**31, 1 / 2000
_CODECS = ["bytes", "blosc", "crc32c"]


def structure_problem(structure: Mapping[str, Any]) -> tuple[str, object] | None:
    """(what is wrong, the value) with the properties that all captures share, None if nothing is."""
    lengths: dict[str, int] = {}
    total = 0
    for name, entry in structure.items():
        keys = {"dims": list, "shape": list, "dtype": str, "coord": bool, "attrs": dict}
        if not isinstance(entry, dict) or any(type(entry.get(key)) is not kind for key, kind in keys.items()):
            return "an array is not described", name
        dims, shape = entry["dims"], entry["shape"]
        if entry["dtype"] not in _TYPES:
            return "an array is not of numbers or flags", f"{name}: {entry['dtype'][:40]}"
        if len(dims) != len(shape) or len({*map(str, dims)}) != len(dims) or len(dims) > 16:
            return "an array has no possible shape", f"{name}: {str(shape)[:80]}"
        if not all(isinstance(dim, str) for dim in dims) or not all(type(n) is int and n > 0 for n in shape):
            return "an array has no possible shape", f"{name}: {str(shape)[:80]}"
        total += np.dtype(entry["dtype"]).itemsize * math.prod(shape)
        if total > _MOST_BYTES:
            return f"a capture has more than {_MOST_BYTES:,} bytes", f"{name}: {str(shape)[:80]}"
        for dim, length in zip(dims, shape, strict=True):
            if lengths.setdefault(dim, length) != length:
                return f"its arrays have unlike sizes of {dim}", f"{name}: {length}, not {lengths[dim]}"
    return None


def attributes_problem(encoded: object, texts: Mapping[str, Any]) -> str:
    """What is wrong with the encoded attributes of a capture, "" if nothing is."""
    if not isinstance(encoded, dict):
        return "a capture has no attributes"
    for name, pair in encoded.items():
        if not isinstance(pair, list) or len(pair) != 2 or pair[0] not in ("text", "value"):
            return f"the attribute {name[:40]!r} is not encoded"
        if pair[0] == "text" and not (isinstance(pair[1], str) and isinstance(texts.get(pair[1]), str)):
            return f"the text of the attribute {name[:40]!r} is missing"
    return ""


def group_structure(attributes: Mapping[str, Any], arrays: Mapping[str, Any]) -> Structure:
    """The structure that the metadata of a group and its arrays (`zarr.json` by name) state.

    Raises KeyError, TypeError, ValueError, AttributeError where they are not those of a store.
    """
    coords = attributes["coordinates"].split()
    structure: Structure = {}
    for name in attributes["variables"]:
        array = arrays[name]
        structure[name] = {
            "dims": list(array["dimension_names"][1:]),
            "shape": list(array["shape"][1:]),
            "dtype": array["data_type"],
            "coord": name in coords,
            "attrs": array.get("attributes", {}),
        }
    if (problem := structure_problem(structure)) is not None:
        raise ValueError(f"{problem[0]}: {problem[1]}")
    return structure


def array_problem(array: Mapping[str, Any], entry: Mapping[str, Any], count: int) -> str:
    """What is wrong with the metadata of one array, whose entry of the structure is sound; "" if nothing is."""
    chunk = chunk_shape(entry["dims"], entry["shape"], np.dtype(entry["dtype"]).itemsize)
    expected = {
        "node_type": "array",
        "zarr_format": 3,
        "shape": [count, *entry["shape"]],
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [1, *chunk]}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "."}},
    }
    for key, value in expected.items():
        if array.get(key) != value:
            return f"{key} is {json.dumps(array.get(key))[:120]}, not {json.dumps(value)[:120]}"
    codecs = array.get("codecs")
    names = (
        [codec.get("name") if isinstance(codec, dict) else None for codec in codecs] if isinstance(codecs, list) else []
    )
    return "" if names == _CODECS else f"its codecs are {str(names)[:120]}, not {_CODECS}"


def size_problem(structure: Structure, chunks: Mapping[str, Mapping[str, Mark]]) -> str:
    """Why the captures unpack to far more than their files hold, "" if they do not."""
    total = sum(np.dtype(entry["dtype"]).itemsize * math.prod(entry["shape"]) for entry in structure.values())
    if total <= LARGE_BYTES:
        return ""
    stored: dict[str, int] = {}
    for marks in chunks.values():
        for key, (size, _) in marks.items():
            stored[key.split(".")[1]] = stored.get(key.split(".")[1], 0) + size
    least = min(stored.values(), default=0)
    return f"a capture of {least:,} bytes unpacks to {total:,}" if least < total * _LEAST_SHARE else ""
