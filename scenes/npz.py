"""The one reader of .npz and .npy files that may come from anywhere: sizes are read from the headers before any data.

A zip of a few kilobytes can unpack to gigabytes, and a header can claim more elements than its file holds. Pickled content is
refused.
"""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from .errors import InputError, reason

__all__ = ["MOST_BYTES", "read_npy", "read_npz"]

#: Most bytes that the arrays of a file may have together.
MOST_BYTES = 2**30
_MOST_HEADER = 65536


def read_npz(path: Path, what: str, *, where: str = "", most_bytes: int = MOST_BYTES) -> dict[str, npt.NDArray[Any]]:
    """All arrays of an .npz file by name.

    Main arguments:
        path: the file.
        what: it as a reader knows it, with its article: "The file of weights".
    Other arguments:
        where: place for the error, by default the path.
        most_bytes: of all arrays together.

    Raises InputError where the file is absent, damaged, too large, or holds anything but arrays of numbers and text.
    """
    try:
        arrays, total = {}, 0
        with zipfile.ZipFile(path) as archive:
            for member in archive.infolist():
                total += member.file_size
                if total > most_bytes:
                    raise ValueError(f"its arrays have more than {most_bytes:,} bytes")
                with archive.open(member) as stream:
                    arrays[member.filename.removesuffix(".npy")] = _array(stream, member.file_size)
        return arrays
    except Exception as error:  # zipfile, zlib, struct and numpy raise a dozen kinds on a damaged file
        raise _refused(error, what, where or str(path)) from error


def read_npy(path: Path, what: str, *, where: str = "", most_bytes: int = MOST_BYTES) -> npt.NDArray[Any]:
    """The array of an .npy file; arguments and errors as for `read_npz`."""
    try:
        size = path.stat().st_size
        if size > most_bytes:
            raise ValueError(f"it has more than {most_bytes:,} bytes")
        with open(path, "rb") as stream:
            return _array(stream, size)
    except Exception as error:
        raise _refused(error, what, where or str(path)) from error


def _array(stream: IO[bytes], size: int) -> npt.NDArray[Any]:
    """One array, whose header must describe exactly the bytes that follow it."""
    version = np.lib.format.read_magic(stream)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"version {version} of the format of arrays")
    shape, fortran, dtype = readers[version](stream, max_header_size=_MOST_HEADER)
    if dtype.hasobject:
        raise ValueError("it holds pickled objects")
    count = math.prod(shape)
    if not dtype.itemsize and count:
        raise ValueError("its elements have no bytes")
    if count * dtype.itemsize != size - stream.tell():
        raise ValueError(f"its header describes {count * dtype.itemsize:,} bytes, and {size - stream.tell():,} follow")
    array = np.empty(count, dtype)
    if array.nbytes:
        view, done = array.view(np.uint8).data, 0
        while got := stream.readinto(view[done:]):  # type: ignore[attr-defined]
            done += got
        if done != array.nbytes:
            raise ValueError("it ends early")
        stream.read(1)  # the end of a zip's member, where its checksum is compared
    return array.reshape(shape[::-1]).T if fortran else array.reshape(shape)


def _refused(error: Exception, what: str, where: str) -> InputError:
    return InputError(f"{what} cannot be read.", where=where, value=" ".join(reason(error).split())[:200])
