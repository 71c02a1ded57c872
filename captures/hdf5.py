"""Write an HDF5 file completely or not at all, even on a full disk, where HDF5 would abort the process on closing."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer, WriteableBuffer

    from ..scenes.errors import InputError

__all__ = ["Hdf5Output", "hdf5_output"]


class _Sink(io.RawIOBase):
    """A file whose writes never fail: after the first error, which is stored in `error`, it holds the data in memory.

    If HDF5 cannot write the last blocks, it leaves the file open and tries again when the process ends, which then aborts.
    Therefore every write reports success to HDF5, and the caller checks `error`.
    """

    def __init__(self, file: io.FileIO) -> None:
        self.file = file
        self.error: OSError | None = None
        self._kept: list[tuple[int, bytes]] = []
        self._size, self._at = 0, 0

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._size}[whence]
        return self._at

    def tell(self) -> int:
        return self._at

    def seekable(self) -> bool:
        return True

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def write(self, data: ReadableBuffer, /) -> int:
        view = memoryview(data).cast("B")
        try:
            if self.error is None:
                self._write_through(view)
        except OSError as error:
            self.error = error
        if self.error is not None:
            self._kept.append((self._at, bytes(view)))
        self._at += len(view)
        self._size = max(self._size, self._at)
        return len(view)

    def _write_through(self, view: memoryview) -> None:
        done = 0
        while done < len(view):
            done += os.pwrite(self.file.fileno(), view[done:], self._at + done)

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        view = memoryview(buffer).cast("B")
        begin, end = self._at, self._at + len(view)
        view[:] = os.pread(self.file.fileno(), len(view), begin).ljust(len(view), b"\0")
        for start, content in self._kept:
            low, high = max(begin, start), min(end, start + len(content))
            if low < high:
                view[low - begin : high - begin] = content[low - start : high - start]
        self._at = end
        return len(view)

    def truncate(self, size: int | None = None, /) -> int:
        self._size = self._at if size is None else size
        try:
            if self.error is None:
                os.ftruncate(self.file.fileno(), self._size)
        except OSError as error:
            self.error = error
        return self._size


class Hdf5Output:
    """The open file `h5` (an `h5py.File`), and `check()`, which reports a full disk early."""

    def __init__(self, h5: Any, sink: _Sink, path: Path) -> None:
        self.h5, self._sink, self._path = h5, sink, path

    def check(self) -> None:
        """Raise InputError if a write has failed."""
        if self._sink.error is not None:
            raise _refused(self._sink.error, self._path) from self._sink.error


@contextmanager
def hdf5_output(path: Path, *, track_order: bool = False) -> Iterator[Hdf5Output]:
    """Write an HDF5 file under a temporary name and rename it when the block ends without an error.

    Main arguments:
        path: the file to write.
    Other arguments:
        track_order: keep the order in which names are created, as NetCDF-4 demands.

    Raises:
        InputError: the file cannot be written, or the disk is full; then neither file is left.
    """
    import h5py

    partial = path.with_name(path.name + ".partial")
    try:
        file = io.FileIO(partial, "w+")
    except OSError as error:
        raise _refused(error, path) from error
    try:
        with file:
            sink = _Sink(file)
            with h5py.File(sink, "w", track_order=track_order) as h5:
                output = Hdf5Output(h5, sink, path)
                yield output
            output.check()
            try:
                os.fsync(file.fileno())
                os.replace(partial, path)
            except OSError as error:
                raise _refused(error, path) from error
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def _refused(error: OSError, path: Path) -> InputError:
    from .store.publish import disk_error

    return disk_error(error, "writing the file", path)
