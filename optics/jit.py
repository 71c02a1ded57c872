"""The only module that uses Numba: compiled kernels with a cache that is never stale.

Numba keys its cache on the file of the *decorated* function: after an edit of a callee in another file the cached caller
is stale, silently. The cache is therefore kept in a folder named by the hash of every source file that mentions a
kernel, and any edit of these uses a new folder. Where that cannot be written, a temporary folder is used.

Numba trusts what its cache holds. Here every file ends in the SHA-256 of its content, and one that a power cut, a full disk
or a bad sector has damaged is compiled anew. Of processes that need the same function at once, one compiles it, and the others wait
for it (`turns`).
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import io
import os
import tempfile
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .turns import Turn

if TYPE_CHECKING:
    prange = range

__all__ = [
    "GIVEN_HASH",
    "c_callback",
    "cache_folder",
    "compiling",
    "damaged_files",
    "kernel",
    "kernels_below",
    "load_compiler",
    "prange",
    "source_hash",
    "user_cache",
]

_DIGEST_BYTES = 32
#: Environment variable in which a runner gives the hash of the sources to its children.
GIVEN_HASH = "BEAMBENCH_SOURCE_HASH"


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

    if given := os.environ.get(GIVEN_HASH):  # in the jail of a child some of the sources cannot be read
        return given
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


def user_cache() -> Path:
    """(user cache)/beambench, which need not exist or be writable."""
    return Path(os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")) / "beambench"


@lru_cache(maxsize=1)
def cache_folder() -> Path:
    """The writable folder for compiled kernels: (user cache)/beambench/numba/(source hash), else a temporary one."""
    folder = user_cache() / "numba" / source_hash()
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
    if len(args) == 1 and callable(args[0]):
        return _checked(numba.njit(**options)(args[0]))
    decorate = numba.njit(*args, **options)
    return lambda function: _checked(decorate(function))


@contextlib.contextmanager
def compiling() -> Iterator[None]:
    """Search for garbage seldom meanwhile: Numba makes so many objects that the search takes a seventh of its time."""
    before = gc.get_threshold()
    gc.set_threshold(50_000, 20, 50)
    try:
        yield
    finally:
        gc.set_threshold(*before)


def kernels_below(function: Any) -> int:
    """Number of kernels that a function may call, directly or through others, by the names of its module that it uses."""
    seen: dict[int, Any] = {}
    left = [function]
    while left:
        one = left.pop()
        inner = getattr(one, "py_func", one)
        code = getattr(inner, "__code__", None)
        if code is None or id(one) in seen:
            continue
        seen[id(one)] = one
        left += [inner.__globals__[name] for name in code.co_names if name in inner.__globals__]
    return sum(hasattr(one, "py_func") for one in seen.values())


def load_compiler() -> None:
    """Load what Numba loads at the first call of any kernel: its tables of types and of functions, .2 s of processor time."""
    from numba.core.registry import cpu_target

    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()


def _checked(dispatcher: Any) -> Any:
    """A compiled function whose files in the cache are checked before they are used, and written by one process at a time."""
    cache = getattr(dispatcher, "_cache", None)
    file = getattr(cache, "_cache_file", None)
    if cache is not None and file is not None:
        file.__class__ = _checked_file()
        cache.__class__ = _cache_in_turn()
        cache.turn = Turn(Path(cache.cache_path) / "turns" / f"{cache._impl.filename_base}.lock")
    return dispatcher


@lru_cache(maxsize=1)
def _cache_in_turn() -> type:
    """Numba's cache of a function, where a process that misses a signature first waits for one that compiles it already."""
    from numba.core.caching import FunctionCache

    class CacheInTurn(FunctionCache):
        turn: Turn

        def load_overload(self, sig: Any, target_context: Any) -> Any:
            found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            if found is None and self.turn.take():
                found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
                if found is not None:
                    self.turn.end()
            return found

        def save_overload(self, sig: Any, data: Any) -> None:
            try:
                super().save_overload(sig, data)  # type: ignore[no-untyped-call]
            finally:
                self.turn.end()

    return CacheInTurn


@lru_cache(maxsize=1)
def _checked_file() -> type:
    """Numba's cache file whose content is followed by its SHA-256, which unpickling does not read."""
    from numba.core.caching import IndexDataCacheFile

    class CheckedFile(IndexDataCacheFile):
        @contextlib.contextmanager
        def _open_for_write(self, filepath: str) -> Iterator[io.BytesIO]:
            content = io.BytesIO()
            yield content
            body = content.getvalue()
            with super()._open_for_write(filepath) as file:
                file.write(body + hashlib.sha256(body).digest())

        def _load_index(self) -> Any:
            return super()._load_index() if _whole(Path(self._index_path)) else {}  # type: ignore[no-untyped-call]

        def _load_data(self, name: str) -> Any:
            if not _whole(Path(self._data_path(name))):  # type: ignore[no-untyped-call]
                raise OSError(f"damaged: {name}")  # which Numba takes as a file to make anew
            return super()._load_data(name)  # type: ignore[no-untyped-call]

        def save(self, key: Any, data: Any) -> None:
            with contextlib.suppress(OSError):  # a full disk ends no calculation: the function is compiled all the same
                super().save(key, data)  # type: ignore[no-untyped-call]

    return CheckedFile


def _whole(path: Path) -> bool:
    try:
        content = path.read_bytes()
    except OSError:
        return False
    body, digest = content[:-_DIGEST_BYTES], content[-_DIGEST_BYTES:]
    return hashlib.sha256(body).digest() == digest


def damaged_files(folder: Path) -> list[Path]:
    """The files of compiled kernels in a cache folder that are not as they were written."""
    return sorted(path for path in folder.rglob("*.nb[ic]") if not _whole(path))


def c_callback(signature: Any) -> Any:
    """`numba.cfunc`: compile a function of `signature` that a C library can call."""
    import numba

    return numba.cfunc(signature)
