"""The only module that uses Numba: compiled kernels with a cache that is never stale.

Numba keys its cache on the file of the *decorated* function: after an edit of a callee in another file the cached caller
is stale, silently. The cache is therefore kept in a folder named by the hash of every source file that mentions a
kernel, and any edit of these uses a new folder. Where that cannot be written, a temporary folder is used.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    prange = range

__all__ = ["c_callback", "cache_folder", "kernel", "prange", "source_hash"]


def __getattr__(name: str) -> Any:
    """`prange` of Numba, imported on first use."""
    if name == "prange":
        import numba

        return numba.prange
    raise AttributeError(name)


@lru_cache(maxsize=1)
def source_hash() -> str:
    """SHA-256 (16 hex digits) over every Python source that may hold a kernel, names and contents."""
    import importlib.util

    digest = hashlib.sha256()
    for room in ("optics", "generator", "estimators", "benchmarks"):
        spec = importlib.util.find_spec(f"beambench.{room}")
        if spec is None or not spec.submodule_search_locations:
            continue
        folder = Path(next(iter(spec.submodule_search_locations)))
        for path in sorted(folder.rglob("*.py")):
            text = path.read_bytes()
            if b"kernel" in text:  # a file that mentions no kernel is neither a caller nor a callee
                digest.update(f"{room}/{path.relative_to(folder)}".encode())
                digest.update(text)
    return digest.hexdigest()[:16]


@lru_cache(maxsize=1)
def cache_folder() -> Path:
    """The writable folder for compiled kernels: (user cache)/beambench/numba/(source hash), else a temporary one."""
    base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    folder = Path(base) / "beambench" / "numba" / source_hash()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        return folder
    except OSError:
        # One folder per user, so that the next process finds the kernels again where the system keeps temporary files.
        folder = Path(tempfile.gettempdir()) / f"beambench-numba-{os.getuid()}" / source_hash()
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            owner = folder.parent.stat()
            if owner.st_uid == os.getuid() and owner.st_mode & 0o022 == 0:
                with tempfile.TemporaryFile(dir=folder):
                    return folder
        except OSError:
            pass
        return Path(tempfile.mkdtemp(prefix="beambench-numba-"))


def kernel(*args: Any, **options: Any) -> Any:
    """`numba.njit` with the project's cache. Use as `@kernel` or `@kernel(fastmath=True, parallel=True)`.

    Main arguments: those of `numba.njit`. `cache` is True by default.
    """
    # Threads of Mitsuba and of Numba share the cores: threads that spin while they wait slow the others by a third.
    # The OpenMP runtime reads this when it is loaded; a value set by the user is kept.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    import numba

    # Numba chooses the cache folder when the function is decorated, so it is set just before.
    numba.config.CACHE_DIR = str(cache_folder())  # type: ignore[attr-defined]
    options.setdefault("cache", True)
    options.setdefault("nogil", True)
    if len(args) == 1 and callable(args[0]) and not options.keys() - {"cache", "nogil"}:
        return numba.njit(**options)(args[0])
    return numba.njit(*args, **options)


def c_callback(signature: Any) -> Any:
    """`numba.cfunc`: compile a function of `signature` that a C library can call."""
    import numba

    return numba.cfunc(signature)
