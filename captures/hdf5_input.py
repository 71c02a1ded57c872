"""The one reader of HDF5 that may come from anywhere: sizes are bounded from the headers before any data is read.

A file of kilobytes can state arrays of terabytes, hold arrays that are views of themselves or of other files, and chunks that
unpack to gigabytes, whatever their stated size (the library unpacks a chunk to its end).
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Hdf5Input", "hdf5_input"]

_MOST_BYTES = 2**30
#: Most bytes of an attribute, and of one element of an array (texts of fixed length).
_MOST_ATTRIBUTE, _MOST_ELEMENT = 2**16, 2**12
#: Deflate packs at most this much; a chunk that could unpack to more than `_MOST_BYTES` is unpacked in steps first.
_DEFLATE = 1032


@contextmanager
def hdf5_input(path: Path) -> Iterator[Hdf5Input]:
    """An open file. Raises OSError where it is none, and what h5py raises on a damaged one."""
    import h5py

    with h5py.File(path, "r") as file:
        yield Hdf5Input(file)


class Hdf5Input:
    """Attributes and arrays of a file, by name. Every method raises ValueError for what is refused."""

    def __init__(self, file: Any) -> None:
        self._file = file

    def __contains__(self, name: str) -> bool:
        return name in self._file.keys()  # noqa: SIM118 (`in file` would follow a path, and links to other files)

    def attribute(self, name: str, default: Any) -> Any:
        """An attribute of the file."""
        if name not in self._file.attrs:
            return default
        header = self._file.attrs.get_id(name)
        # An empty attribute has no shape.
        if header.dtype.itemsize * math.prod(header.shape or ()) > _MOST_ATTRIBUTE:
            raise ValueError(f"the attribute {name} has the shape {header.shape}")
        return self._file.attrs[name]

    def names(self, most: int) -> list[str]:
        """Paths "group/array" of the file's own arrays; links to other places are left out. Raises ValueError beyond `most`."""
        import h5py

        found: list[str] = []
        todo: list[tuple[str, int]] = [("", 0)]
        while todo:
            prefix, depth = todo.pop()
            group = self._file[prefix] if prefix else self._file
            for key in group.keys():  # noqa: SIM118
                path = f"{prefix}/{key}" if prefix else str(key)
                if group.get(key, getclass=True, getlink=True) is not h5py.HardLink:
                    continue
                if group.get(key, getclass=True) is h5py.Group and depth < 8:
                    todo.append((path, depth + 1))
                elif group.get(key, getclass=True) is h5py.Dataset:
                    found.append(path)
                if len(found) + len(todo) > most:
                    raise ValueError(f"more than {most} arrays and groups")
        return sorted(found)

    def kind(self, name: str) -> str:
        """The kind of an array's elements, as NumPy's `dtype.kind`."""
        return str(self._dataset(name).dtype.kind)

    def bytes(self, name: str) -> int:
        """Size of an array in bytes."""
        dataset = self._dataset(name)
        return int(dataset.dtype.itemsize) * math.prod(dataset.shape)

    def shape(self, name: str) -> tuple[int, ...]:
        """The shape of an array."""
        return tuple(self._dataset(name).shape)

    def array(self, name: str) -> NDArray[Any]:
        """All of an array of at most 1 GiB."""
        dataset = self._dataset(name)
        if dataset.dtype.itemsize > _MOST_ELEMENT:
            raise ValueError(f"an element of {name} has {dataset.dtype.itemsize:,} bytes")
        if dataset.dtype.itemsize * math.prod(dataset.shape) > _MOST_BYTES:
            raise ValueError(f"{name} has the shape {dataset.shape}: more than {_MOST_BYTES:,} bytes")
        if dataset.chunks is not None:
            _bound_chunks(dataset, name)
        return np.asarray(dataset[()])

    def _dataset(self, name: str) -> Any:
        import h5py

        if self._file.get(name, getclass=True, getlink=True) is not h5py.HardLink:
            raise ValueError(f"{name} is a link, not an array of this file")
        found = self._file[name]
        if not isinstance(found, h5py.Dataset) or found.shape is None:
            raise ValueError(f"{name} is no array, but {type(found).__name__}")
        if found.is_virtual or found.external:
            raise ValueError(f"{name} is a view of other data, or lies in another file")
        return found


def _bound_chunks(dataset: Any, name: str) -> None:
    """Refuse chunks that are, or unpack to, more than 1 GiB."""
    if dataset.dtype.itemsize * math.prod(dataset.chunks) > _MOST_BYTES:
        raise ValueError(f"{name} has chunks of {dataset.chunks}: more than {_MOST_BYTES:,} bytes")
    packed = [
        dataset.id.get_create_plist().get_filter(i)[0] for i in range(dataset.id.get_create_plist().get_nfilters())
    ]
    import h5py

    known = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
    if not known.issuperset(packed) or packed.count(h5py.h5z.FILTER_DEFLATE) > 1:
        raise ValueError(f"{name} is packed by a filter that is not read; gzip, shuffle and fletcher32 are")
    if h5py.h5z.FILTER_DEFLATE not in packed:
        return
    for index in range(dataset.id.get_num_chunks()):
        info = dataset.id.get_chunk_info(index)
        if info.size * _DEFLATE > _MOST_BYTES:
            _, content = dataset.id.read_direct_chunk(info.chunk_offset)
            # What lies behind the stream (a checksum) is left; the last filter is undone first.
            if len(zlib.decompressobj().decompress(content, _MOST_BYTES + 1)) > _MOST_BYTES:
                raise ValueError(f"a chunk of {name} unpacks to more than {_MOST_BYTES:,} bytes")
