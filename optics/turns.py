"""Turns of processes that would all do the same work: one does it, and the others find it done.

A turn is a lock on a file (flock(2)), which ends with the process that holds it. Where no file can be written, or the other is not
done in time, nobody waits any longer and the work is done twice, as without turns.
"""

from __future__ import annotations

import fcntl
import os
import time
from pathlib import Path

__all__ = ["Turn"]

#: Longest wait for another process, s: less than the time that a runner allows for a warm-up.
_PATIENCE_S = 60.0
_POLL_S = 0.02


class Turn:
    """A turn that is taken at most once in a process.

    Main arguments:
        path: the file of the lock; its folder is made.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = -1

    def take(self) -> bool:
        """Wait for the turn, and hold it until `end`. False where it was held here before, or cannot be had."""
        if self._file >= 0:
            return False
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError:
            return False
        until = time.monotonic() + _PATIENCE_S
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() < until:
                    time.sleep(_POLL_S)
                    continue
                os.close(file)
                return False
            except OSError:  # a file system without locks
                os.close(file)
                return False
            self._file = file
            return True

    def end(self) -> None:
        """Let the next one have it."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
