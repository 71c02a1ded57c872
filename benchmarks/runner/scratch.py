"""Folders for temporary files that are removed also after a kill: the next run removes those whose owner has ended.

An owner holds a lock on `LOCK` in its folder until it ends, whatever ends it. The lock is taken before the file has its name,
so that a folder with this name and no lock has no owner. A kill between the making of a folder and its file leaves it empty: such
a folder is removed when it is an hour old. One that holds anything without the file, of another user, or that is a link is never
touched.
"""

from __future__ import annotations

import fcntl
import os
import re
import secrets
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .removal import remove

__all__ = ["LOCK", "scratch_folder", "sweep"]

LOCK = ".beambench-scratch"
#: Age of an empty folder whose owner must have ended: the file is made at once, s.
_OLD_S = 3600.0
_NAME = re.compile(r"beambench-(run-|truth-|estimate-)[A-Za-z0-9_]{8}")


@contextmanager
def scratch_folder(kind: str) -> Iterator[Path]:
    """A private temporary folder, removed at the end; `kind` is "run", "truth" or "estimate". Raises OSError.

    What owners that have ended left behind is removed first.
    """
    sweep()
    # The name is known before the folder is made: a signal in between would leave it behind, without a lock and so for good.
    folder = Path(tempfile.gettempdir()) / f"beambench-{kind}-{secrets.token_hex(4)}"
    try:
        try:
            os.mkdir(folder, 0o700)
        except FileExistsError:
            folder = Path(tempfile.mkdtemp(prefix=f"beambench-{kind}-"))
        handle = os.open(folder / f"{LOCK}.new", os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600)
        try:
            with suppress(OSError):  # some file systems have no locks: then nothing is swept either
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                os.rename(folder / f"{LOCK}.new", folder / LOCK)
            yield folder
        finally:
            os.close(handle)
    finally:
        try:
            _clear(folder)
        except BaseException:  # a signal, which passes on when the rest is removed
            _clear(folder)
            raise


def _clear(folder: Path) -> None:
    """Remove a folder, its file last: what a kill leaves of it is still known as nobody's."""
    with suppress(OSError):
        for name in os.listdir(folder):
            if name not in (LOCK, f"{LOCK}.new"):
                remove(folder / name)
    remove(folder)


def _lock_file(folder: Path) -> int | None:
    """The file that an owner locks, also before it has its name; None where there is none. Raises OSError."""
    for name in (LOCK, f"{LOCK}.new"):
        with suppress(FileNotFoundError):
            return os.open(folder / name, os.O_RDWR | os.O_NOFOLLOW)
    return None


def sweep() -> list[Path]:
    """Remove the temporary folders whose owner has ended, and return them."""
    removed = []
    try:
        names = [name for name in os.listdir(tempfile.gettempdir()) if _NAME.fullmatch(name)]
    except OSError:
        return []
    for name in names:
        folder = Path(tempfile.gettempdir()) / name
        with suppress(OSError):
            status = os.lstat(folder)
            if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.geteuid():
                continue
            handle = _lock_file(folder)
            if handle is None:
                if time.time() - status.st_mtime > _OLD_S:
                    os.rmdir(folder)  # only an empty one goes
                    removed.append(folder)
                continue
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                _clear(folder)
                removed.append(folder)
            finally:
                os.close(handle)
    return removed
