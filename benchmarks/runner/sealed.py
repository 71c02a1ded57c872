"""A capture as one sealed block of memory, handed to a child when it may read it and not before.

A block holds a JSON header with the dimensions, types and attributes of the variables, and their arrays, each at a multiple of 64
bytes. It is an anonymous file (memfd_create(2)) whose size and contents the kernel keeps for ever (F_SEAL_*): no process can
change what the next one reads, and no path leads to it. A child gets its handle through a socket.

`fresh` makes other data of the same kind: warm-up and repeated calls never see the data of the call whose answer is scored.
"""

from __future__ import annotations

import fcntl
import json
import mmap
import os
import secrets
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

__all__ = ["Alter", "block", "drawn", "fresh", "stale", "unpack"]

_ALIGN = 64
_SEALS = fcntl.F_SEAL_SEAL | fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_WRITE
#: Elements of which the data of a warm-up consist.
_DRAWN = 8
_PATTERN = 65521  # length of the pattern of `fresh`, a prime, so that it falls differently on every sample of an array

#: (name of the variable, its dimensions, its array) -> the array that a child gets in its place.
Alter = Callable[[str, list[str], npt.NDArray[Any]], npt.NDArray[Any]]


def block(folder: Path, condition: str, alter: Alter | None = None) -> int:
    """The handle of a sealed block with a capture of the spool, which the caller closes.

    Main arguments:
        folder: of the capture. condition: which declared rig it is read under.
    Other arguments:
        alter: what is changed in the arrays.

    Raises OSError where a file cannot be read or there is no memory.
    """
    meta = json.loads((folder / f"meta-{condition}.json").read_text(encoding="utf-8"))
    arrays: list[tuple[int, npt.NDArray[Any]]] = []
    end = 0
    for name, entry in meta["variables"].items():
        array = np.load(folder / entry.pop("file", f"{name}.npy"), mmap_mode="r", allow_pickle=False)
        if alter is not None:
            array = alter(name, entry["dims"], array)
        entry |= {"dtype": array.dtype.str, "shape": array.shape, "offset": end}
        arrays.append((end, array))
        end += -(-array.nbytes // _ALIGN) * _ALIGN
    head = json.dumps(meta).encode()
    start = -(-(8 + len(head)) // _ALIGN) * _ALIGN
    handle = os.memfd_create("beambench-capture", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        os.ftruncate(handle, max(start + end, _ALIGN))
        os.pwrite(handle, struct.pack("<Q", len(head)) + head, 0)
        for offset, array in arrays:
            _write(handle, np.ascontiguousarray(array), start + offset)
        fcntl.fcntl(handle, fcntl.F_ADD_SEALS, _SEALS)
    except BaseException:
        os.close(handle)
        raise
    return handle


def _write(handle: int, array: npt.NDArray[Any], offset: int) -> None:
    data = array.reshape(-1).view(np.uint8).data
    done = 0
    while done < len(data):  # one call writes 2 GiB at most
        done += os.pwrite(handle, data[done:], offset + done)


def unpack(handle: int) -> xr.Dataset:
    """The capture in a block, its arrays mapped read-only; the handle may be closed."""
    mapped = mmap.mmap(handle, 0, prot=mmap.PROT_READ)
    (length,) = struct.unpack_from("<Q", mapped)
    meta = json.loads(mapped[8 : 8 + length])
    start = -(-(8 + length) // _ALIGN) * _ALIGN
    data: dict[str, Any] = {}
    coords: dict[str, Any] = {}
    for name, entry in meta["variables"].items():
        # The buffer is read-only, so that the flag `writeable` of the array cannot be set.
        count = int(np.prod(entry["shape"], dtype=np.int64))
        array = np.frombuffer(mapped, np.dtype(entry["dtype"]), count, start + entry["offset"]).reshape(entry["shape"])
        (coords if entry["coordinate"] else data)[name] = (entry["dims"], array, entry["attrs"])
    return xr.Dataset(data, coords=coords, attrs=meta["attrs"])


def fresh(data: str, seed: int | None = None) -> Alter:
    """Other noise of the same light: every sample of the variable `data` changes by −1, 0 or 1 DN.

    Without a seed, nobody knows how. Numbers that are no integers change by 1/1000 of themselves. Zeros, and the largest count of
    the capture, stay as they are: they mean dead and saturated samples.
    """
    rng = np.random.default_rng(secrets.randbits(64) if seed is None else seed)
    pattern = rng.integers(-1, 2, _PATTERN, dtype=np.int8)

    def alter(name: str, dims: list[str], array: npt.NDArray[Any]) -> npt.NDArray[Any]:
        if name != data:
            return array
        step = np.resize(pattern, array.size).reshape(array.shape)
        if array.dtype.kind == "f":
            return np.asarray(array * (1.0 + 1e-3 * step), array.dtype)
        kept = (array <= 1) | (array >= _full(array))
        # Both are added as unsigned numbers: −1 is the largest one, and the sum wraps to the right value.
        return np.asarray(array + np.where(kept, 0, step).astype(array.dtype), array.dtype)

    return alter


def _full(array: npt.NDArray[Any]) -> int:
    """The count at which samples are taken as saturated: the largest one there is."""
    return int(array.max(initial=0))


def drawn(data: str, element: tuple[str, ...]) -> Alter:
    """A capture for a warm-up: `fresh`, and every element has the samples of one of a few that are drawn at random.

    What a warm-up can learn of a capture is no more than these few elements. Captures of fewer elements are only made fresh.
    """
    anew = fresh(data)
    rng = np.random.default_rng(secrets.randbits(64))

    def alter(name: str, dims: list[str], array: npt.NDArray[Any]) -> npt.NDArray[Any]:
        if name != data:
            return array
        held = [dims.index(dim) for dim in element]
        number = int(np.prod([array.shape[at] for at in held]))
        moved = np.moveaxis(array, held, range(len(held)))
        flat = moved.reshape(number, -1)
        if number > _DRAWN:
            few = rng.choice(number, _DRAWN, replace=False)
            flat = flat[few[rng.integers(0, _DRAWN, number)]]
        back = np.moveaxis(flat.reshape(moved.shape), range(len(held)), held)
        return anew(name, dims, np.ascontiguousarray(back))

    return alter


def stale(first: dict[str, npt.NDArray[Any]], other: dict[str, npt.NDArray[Any]]) -> bool:
    """Whether the numbers of two answers (name -> array) to different data are the same, though they tell elements apart.

    More than half of the finite numbers are equal bit by bit, of arrays in which more than nine of ten numbers are different. An
    estimator that rounds (to a slice, a pixel) has few different numbers, and is not judged.
    """
    for name, array in first.items():
        if array.dtype.kind != "f" or other[name].shape != array.shape:
            continue
        finite = np.isfinite(array)
        numbers = array[finite]
        if numbers.size < 8 or np.unique(numbers).size < 0.9 * numbers.size:
            continue
        if np.count_nonzero(numbers == other[name][finite]) > 0.5 * numbers.size:
            return True
    return False
