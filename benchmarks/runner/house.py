"""Failures of the house: the machine or this project, not the estimator. They end a run, and are never a score."""

from __future__ import annotations

import errno
import traceback
from pathlib import Path

from ...scenes.errors import InputError

__all__ = ["HOUSE", "house_error", "house_failure"]

#: How the status of an outcome begins that no estimator is to blame for.
HOUSE = "house: "

#: A full disk, a full quota, a disk that errs, a system without file handles, a share that has gone.
_MACHINE_ERRNO = {errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.ENFILE, errno.ESTALE}
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


def house_error(label: str, status: str) -> InputError:
    """The error that ends a run: which estimator was being measured, and what failed."""
    return InputError(
        "The machine failed, not the estimator; nothing is scored.",
        where=f"estimator {label}",
        value=status.removeprefix(HOUSE),
        allowed="a machine with room on its disks, and a whole cache of compiled kernels",
        next_step="beambench doctor; then the same command with --resume",
    )
