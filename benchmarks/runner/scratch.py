"""Folders for temporary files that are removed also after a kill: the next run removes those whose owner has ended.

An owner holds a lock on `LOCK` in its folder until it ends, whatever ends it. The lock is taken before the file has its name,
so that a folder with this name and no lock has no owner. A folder without the file, of another user, or that is a link is
never touched.
"""

from __future__ import annotations

import fcntl
import os
import re
import secrets
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .removal import remove

__all__ = ["LOCK", "scratch_folder", "sweep"]

LOCK = ".beambench-scratch"
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
            remove(folder)
        except BaseException:  # a signal, which passes on when the rest is removed
            remove(folder)
            raise


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
            handle = os.open(folder / LOCK, os.O_RDWR | os.O_NOFOLLOW)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                remove(folder)
                removed.append(folder)
            finally:
                os.close(handle)
    return removed
