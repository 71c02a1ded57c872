"""HDF5: every array of the file by its path, "group/array". Links, views of other files and bombs are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..hdf5_input import hdf5_input
from .recording import MOST_BYTES, Array, Recording

__all__ = ["read_hdf5"]

_MOST_ARRAYS = 1000


def read_hdf5(path: Path) -> Recording:
    """Arrays of numbers, 1 GiB in all. Raises ValueError, and what h5py raises on a damaged file."""
    arrays: dict[str, Array] = {}
    with hdf5_input(path) as file:
        total = 0
        for name in file.names(_MOST_ARRAYS):
            if file.kind(name) not in "biuf":
                continue
            total += file.bytes(name)
            if total > MOST_BYTES:
                raise ValueError(f"its arrays have more than {MOST_BYTES:,} bytes")
            arrays[name] = file.array(name)
    if not arrays:
        raise ValueError("it holds no array of numbers")
    largest: Any = max(arrays, key=lambda name: arrays[name].size)
    return Recording({largest: arrays.pop(largest), **arrays})
