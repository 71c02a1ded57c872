"""NPY and NPZ, without pickles."""

from __future__ import annotations

from pathlib import Path

from ...scenes.npz import read_npy, read_npz
from .recording import Recording

__all__ = ["read_npy_file", "read_npz_file"]


def read_npy_file(path: Path) -> Recording:
    """The array of an .npy file. Raises InputError."""
    return Recording({"array": read_npy(path, "The NPY file")})


def read_npz_file(path: Path) -> Recording:
    """The arrays of an .npz file, the largest one first. Raises InputError, ValueError for none."""
    arrays = read_npz(path, "The NPZ file")
    if not arrays:
        raise ValueError("it holds no array")
    main = max(arrays, key=lambda name: arrays[name].size)
    return Recording({main: arrays.pop(main), **arrays})
