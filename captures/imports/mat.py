"""MAT files: versions 4 to 7 by scipy, 7.3 as HDF5, whose axes are the other way round. Arrays of numbers only."""

from __future__ import annotations

import io
import zlib
from pathlib import Path

import numpy as np

from .hdf5 import read_hdf5
from .recording import MOST_BYTES, Recording, check_bytes

__all__ = ["read_mat"]

_NUMBERS = {"double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "logical"}


def read_mat(path: Path) -> Recording:
    """Arrays by the names of their variables, the largest one first. Raises ValueError and what the libraries raise."""
    import h5py

    if h5py.is_hdf5(path):
        found = read_hdf5(path)
        return Recording({name: array.T for name, array in found.arrays.items() if not name.startswith("#")})
    from scipy.io import loadmat, whosmat

    if path.stat().st_size > MOST_BYTES:
        raise ValueError("the file is too large")
    content = path.read_bytes()
    _check_packed(content)
    total = 0
    names = []
    for name, shape, kind in whosmat(io.BytesIO(content)):  # type: ignore[arg-type]  # the stubs know paths only
        if kind in _NUMBERS:
            check_bytes(shape, 16, name)
            total += int(np.prod(shape)) * 16
            names.append(name)
    if total > MOST_BYTES or not names:
        raise ValueError("it holds no array of numbers" if not names else f"more than {MOST_BYTES:,} bytes")
    loaded = loadmat(io.BytesIO(content), variable_names=names, struct_as_record=True)  # type: ignore[arg-type]
    arrays = {name: np.asarray(loaded[name]) for name in names}
    main = max(arrays, key=lambda name: arrays[name].size)
    return Recording({main: arrays.pop(main), **arrays})


def _check_packed(content: bytes) -> None:
    """Refuse packed parts (type 15) of a version 5 file that unpack to more than the bound."""
    at, order = 128, "little" if content[126:128] == b"IM" else "big"
    if content[126:128] not in (b"IM", b"MI"):
        return  # version 4 has no packed parts
    left = MOST_BYTES
    while at + 8 <= len(content):
        kind = int.from_bytes(content[at : at + 4], order)  # type: ignore[arg-type]
        size = int.from_bytes(content[at + 4 : at + 8], order)  # type: ignore[arg-type]
        if kind == 15:
            left -= len(zlib.decompressobj().decompress(content[at + 8 : at + 8 + size], left + 1))
            if left < 0:
                raise ValueError(f"its parts unpack to more than {MOST_BYTES:,} bytes")
        at += 8 + size + (0 if kind == 15 else -size % 8)
