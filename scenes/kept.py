"""What was read of a file last, kept as long as the file stays as it is: checked before a capture, and used for it."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Generic, TypeVar

__all__ = ["Kept"]

T = TypeVar("T")


class Kept(Generic[T]):
    """The last few things that were read of files.

    Main arguments:
        most: how many. most_bytes: larger files are not kept.
    """

    def __init__(self, most: int = 4, most_bytes: int = 2**26) -> None:
        self._most, self._most_bytes = most, most_bytes
        self._held: OrderedDict[Hashable, T] = OrderedDict()

    def of(self, path: Path, read: Callable[[], T]) -> T:
        """What `read` gives for the file as it is now: kept, or read. Who gets it does not change it. Errors are not kept."""
        stat = path.stat()
        name = (str(path.resolve()), stat.st_ino, stat.st_mtime_ns, stat.st_size)
        if name in self._held:
            self._held.move_to_end(name)
            return self._held[name]
        made = read()
        if stat.st_size <= self._most_bytes:
            self._held[name] = made
            while len(self._held) > self._most:
                self._held.popitem(last=False)
        return made
