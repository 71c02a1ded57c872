"""Failures of the house: the machine or this project, not the estimator. They end a run, and are never a score."""

from __future__ import annotations

import errno
import os
import tempfile
import traceback
from pathlib import Path

from ...scenes.errors import InputError

__all__ = ["HOUSE", "house_error", "house_failure", "machine_failure"]

#: How the status of an outcome begins that no estimator is to blame for.
HOUSE = "house: "

#: A full disk, a full quota, a disk that errs, a system without file handles, a share that has gone.
_MACHINE_ERRNO = {errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.ENFILE, errno.ESTALE}
#: What a run must be able to keep.
_KEPT_BYTES = 2**22
#: The cache of compiled kernels: an exception that passes through it is not the estimator's.
_CACHE = (("numba", "core", "caching.py"), ("optics", "jit.py"))


def house_failure(error: BaseException) -> str:
    """The reason in one line where the machine or the kernel cache failed; "" where the exception is the estimator's own.

    Main arguments:
        error: as the call of an estimator raised it, with its causes.
    """
    seen: BaseException | None = error
    while seen is not None and not isinstance(seen, ImportError):
        if isinstance(seen, OSError) and seen.errno in _MACHINE_ERRNO:
            return f"{type(seen).__name__}: {seen}"[:500]
        for frame in traceback.extract_tb(seen.__traceback__):
            if any(Path(frame.filename).parts[-len(end) :] == end for end in _CACHE):
                return f"cache of compiled kernels: {type(seen).__name__}: {seen}"[:500]
        seen = seen.__cause__ or seen.__context__
    return ""


def machine_failure(folder: Path) -> str:
    """Why this process cannot keep 4 MiB in a folder, where the answers lie; "" where it can.

    A plug-in may say that the machine failed. It is believed where the runner finds so too; else a word would end everybody's run.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder, buffering=0) as file:
            file.write(bytes(_KEPT_BYTES))
            os.fsync(file.fileno())
    except OSError as error:
        return f"{type(error).__name__}: {error}"[:500]
    return ""


def house_error(label: str, status: str) -> InputError:
    """The error that ends a run: which estimator was being measured, and what failed."""
    return InputError(
        "The machine failed, not the estimator; nothing is scored.",
        where=f"estimator {label}",
        value=status.removeprefix(HOUSE),
        allowed="a machine with room on its disks, and a whole cache of compiled kernels",
        next_step="beambench doctor; then the same command with --resume",
    )
