"""Remove what a stranger's process left: folders of any depth and without rights, links, files in place of folders."""

from __future__ import annotations

import os
import secrets
import stat
from contextlib import suppress
from pathlib import Path

__all__ = ["remove"]

_FLAGS = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


def remove(path: Path) -> None:
    """Remove a file, a link, or a folder with all that is in it, as far as the system lets this user; nothing where there is none.

    `shutil.rmtree` ends with RecursionError at a depth of 1,000, and leaves folders without rights. Here every folder is moved
    up into the first one before it is emptied, so that neither depth nor the length of a path counts. No link is followed.
    """
    try:
        top = _opened(str(path), None)
    except OSError:
        with suppress(OSError):
            os.unlink(path)
        return
    try:
        _empty(top, top)
        # Folders that were moved up are entries of the first one; each is emptied in turn.
        while folders := [entry.name for entry in os.scandir(top) if entry.is_dir(follow_symlinks=False)]:
            if sum(_emptied(name, top) for name in folders) == 0:
                break
    except OSError:
        pass
    finally:
        os.close(top)
    with suppress(OSError):
        os.rmdir(path)


def _opened(name: str, place: int | None) -> int:
    """A handle of a folder, which gets the rights of its owner. Raises OSError where there is none, or a link."""
    try:
        handle = os.open(name, _FLAGS, dir_fd=place)
    except PermissionError:
        if not stat.S_ISDIR(os.lstat(name, dir_fd=place).st_mode):
            raise
        os.chmod(name, 0o700, dir_fd=place)
        handle = os.open(name, _FLAGS, dir_fd=place)
    with suppress(OSError):
        os.fchmod(handle, 0o700)
    return handle


def _emptied(name: str, top: int) -> bool:
    """Empty one folder of the first and remove it; whether that went."""
    try:
        handle = _opened(name, top)
    except OSError:
        return False
    try:
        _empty(handle, top)
    finally:
        os.close(handle)
    try:
        os.rmdir(name, dir_fd=top)
    except OSError:
        return False
    return True


def _empty(handle: int, top: int) -> None:
    """Unlink the files of a folder, and move its folders into the first one, under new names."""
    for entry in list(os.scandir(handle)):
        with suppress(OSError):
            if not entry.is_dir(follow_symlinks=False):
                os.unlink(entry.name, dir_fd=handle)
            elif handle != top:
                os.close(_opened(entry.name, handle))  # it must be writable to be moved
                os.rename(entry.name, secrets.token_hex(8), src_dir_fd=handle, dst_dir_fd=top)
