"""Load drjit and Mitsuba with a libLLVM that works, before anything else imports them.

drjit finds libLLVM at its first import; set too late, `DRJIT_LIBLLVM_PATH` is silently ignored, and Debian's libLLVM 14 and 15
abort the process. The `karellen-llvm-core` wheel carries a recent one; its files are located by the wheel's own
record (never sys.prefix), and its C++ runtime is loaded first because the wheel's library does not name a path to it.
"""

from __future__ import annotations

import ctypes
import os
import sys
from contextlib import suppress
from functools import lru_cache
from typing import Any

from ...optics.jit import cache_folder
from ...scenes.errors import InputError
from ...scenes.forks import refuse_forked

__all__ = ["load", "mitsuba", "opaque", "ray_scene", "wheel_files"]

_WHEEL = "karellen-llvm-core"
_RUNTIME = ("libunwind.so.1.0", "libc++abi.so.1.0", "libc++.so.1.0")
#: 14 and 15 end in "LLVM ERROR: Cannot select" on some kernels; 19 and 23 work.
_OLDEST_LLVM = 16


def wheel_files() -> dict[str, str]:
    """File name → absolute path of the libraries in the LLVM wheel; empty where it is not installed."""
    from importlib.metadata import PackageNotFoundError, distribution

    try:
        files = distribution(_WHEEL).files or []
    except PackageNotFoundError:
        return {}
    return {f.name: os.path.realpath(str(f.locate())) for f in files if ".so" in f.name}


def _point_drjit_to_llvm() -> str:
    """Set `DRJIT_LIBLLVM_PATH` unless the user did; returns "user", "wheel" or "system"."""
    _keep_kernels()
    if os.environ.get("DRJIT_LIBLLVM_PATH"):
        return "user"
    files = wheel_files()
    names = sorted((n for n in files if n.startswith("libLLVM.so.")), reverse=True)
    if not names:
        return "system"
    for name in _RUNTIME:
        if name in files:
            # Local, not global: libLLVM finds them by their sonames, while a global libc++abi would take over the
            # exceptions of Mitsuba, which is built on libstdc++, and end the process at the first one.
            ctypes.CDLL(files[name], mode=ctypes.RTLD_LOCAL)
    os.environ["DRJIT_LIBLLVM_PATH"] = files[names[0]]
    return "wheel"


def _keep_kernels() -> None:
    """Let drjit keep its kernels where Numba's are kept if it cannot do so in the user's home: it would compile them in each
    process, and say so on the terminal."""
    home = os.environ.get("HOME", "")
    own = os.path.join(home, ".drjit")
    if os.environ.get("DRJIT_CACHE_DIR") or (home and os.access(own if os.path.isdir(own) else home, os.W_OK)):
        return
    folder = cache_folder() / "drjit"
    with suppress(OSError):
        folder.mkdir(exist_ok=True)
        os.environ["DRJIT_CACHE_DIR"] = str(folder)


def _mapped_llvm() -> str | None:
    """The libLLVM that this process has mapped (Linux), by the kernel's own account."""
    try:
        with open("/proc/self/maps", encoding="utf-8") as maps:
            for line in maps:
                path = line.split(maxsplit=5)[-1].strip()
                if "libLLVM" in os.path.basename(path):
                    return path
    except OSError:
        pass
    return None


@lru_cache(maxsize=1)
def load() -> dict[str, Any]:
    """Import drjit and Mitsuba, choose the fastest mono variant that works, and report what was loaded.

    Returns a dict: `variant`, `llvm_version` (tuple or None), `llvm_path` (mapped file or None), `llvm_source`
    ("user", "wheel", "system", "imported-before"), `cuda` (bool), `mitsuba`, `drjit` (versions).

    Raises:
        InputError: no variant can run, with what to install.
    """
    from importlib.metadata import version

    source = "imported-before" if "drjit" in sys.modules else _point_drjit_to_llvm()
    try:
        import drjit as dr
        import mitsuba as mi
    except ImportError as error:
        raise InputError(
            "Rendering needs Mitsuba, and it cannot be imported.",
            where="mitsuba",
            value=str(error),
            next_step="pip install 'mitsuba<3.10' drjit",
        ) from error
    cuda = bool(dr.has_backend(dr.JitBackend.CUDA)) and _cuda_driver_present()
    if not cuda and not dr.has_backend(dr.JitBackend.LLVM):
        raise InputError(
            "Mitsuba's CPU backend cannot load a libLLVM that works.",
            where="DRJIT_LIBLLVM_PATH",
            value=os.environ.get("DRJIT_LIBLLVM_PATH", "(not set)"),
            allowed="libLLVM 16 or newer",
            next_step=f"pip install {_WHEEL}, or set DRJIT_LIBLLVM_PATH to a libLLVM.so; then: beambench doctor",
        )
    variant = "cuda_ad_mono" if cuda else "llvm_ad_mono"
    if mi.variant() != variant:
        mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    llvm_version = None if cuda else _llvm_version(dr)
    if llvm_version is not None and llvm_version[0] < _OLDEST_LLVM:
        # Better a message now than the process aborted in the middle of a rendering.
        early = source == "imported-before"
        raise InputError(
            "Mitsuba was imported before Beambench could choose libLLVM, and the libLLVM that it loaded is too old."
            if early
            else "The libLLVM that Mitsuba loaded is too old: it aborts the process on some kernels.",
            where=_mapped_llvm() or "libLLVM",
            value=".".join(map(str, llvm_version)),
            allowed=f"{_OLDEST_LLVM} or newer",
            next_step="import beambench.generator.rays.backend and call load() before importing mitsuba or drjit"
            if early
            else f"pip install {_WHEEL}, and unset DRJIT_LIBLLVM_PATH",
        )
    return {
        "variant": variant,
        "llvm_version": llvm_version,
        "llvm_path": _mapped_llvm(),
        "llvm_source": source,
        "cuda": cuda,
        "mitsuba": version("mitsuba"),
        "drjit": version("drjit"),
    }


def _cuda_driver_present() -> bool:
    """Probe the driver library itself before trusting the list of backends (never tried on a machine with a GPU)."""
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return False
    return bool(driver.cuInit(0) == 0)


def _llvm_version(dr: Any) -> tuple[int, ...] | None:
    dr.llvm.Float(0)  # the version is known once the backend has started
    version = dr.detail.llvm_version()
    return tuple(version) if version else None


def mitsuba() -> Any:
    """The `mitsuba` module, loaded and with its variant set."""
    refuse_forked()
    load()
    import mitsuba as mi

    return mi


def ray_scene(parts: dict[str, Any]) -> Any:
    """Mitsuba's scene of `parts` (name → shape), whose triangles leak no ray along the edges that they share.

    Embree's default test drops about one in twenty rays that run exactly along a shared edge; its robust one drops none. A
    ray through a shared vertex may still pass, one in two hundred: `trace.Tracer` looks to both sides of those. OptiX, on a
    GPU, is watertight by itself and has no such switch.
    """
    mi = mitsuba()
    whole: dict[str, Any] = {"type": "scene", **parts}
    if mi.variant().startswith("llvm"):
        whole["embree_use_robust_intersections"] = True
    return mi.load_dict(whole, parallel=False, optimize=False)


def opaque(value: float) -> Any:
    """A number that compiled code takes as data, so that another value does not compile it anew."""
    import drjit as dr

    return dr.opaque(mitsuba().Float, value)
