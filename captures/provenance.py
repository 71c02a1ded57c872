"""Provenance of a capture: versions, processor and the generator's arguments, from which it can be generated again.

Equal bits are promised for equal versions and processor features. The provenance names no person, machine or folder and
contains no time of day, so that two runs on one machine have equal provenance.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from functools import cache
from importlib import metadata
from typing import Any

from ..scenes.errors import InputError

__all__ = ["cpu", "provenance", "versions"]

_PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "mitsuba", "drjit", "mitransient")
_ABSENT = "not installed as a package"
_FEATURES = (
    "sse2", "sse4_1", "sse4_2", "avx", "f16c", "fma", "avx2", "avx512f", "avx512bw", "avx512cd", "avx512dq",
    "avx512vl", "avx512_fp16", "avx512_bf16", "amx_tile", "asimd", "fphp", "asimdhp", "sve", "sve2",
)  # fmt: skip


def provenance(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Provenance of a capture as a JSON object.

    Main arguments:
        arguments: every argument of the generator (scene, seed, capture_key, fidelity, rtol, ...), as JSON values.

    Packages are listed if they are installed, whether this scene used them or not: what the process did before must not change a
    capture's bytes. Raises InputError for arguments that JSON cannot
    hold.
    """
    try:
        kept = json.loads(json.dumps(dict(arguments), allow_nan=False))
    except (TypeError, ValueError) as error:
        raise InputError(
            f"The arguments are not representable as JSON: {error}.", where="provenance", allowed="JSON without NaN"
        ) from error
    return {
        "beambench": _version("beambench"),
        "python": platform.python_version(),
        "implementation": platform.python_implementation(),
        "packages": versions(),
        "platform": {"system": platform.system(), "machine": platform.machine(), "libc": " ".join(platform.libc_ver())},
        "cpu": cpu(),
        "arguments": kept,
    }


def versions() -> dict[str, str]:
    """Versions of the installed packages on which the bits of a capture may depend."""
    found = {name: _version(name) for name in _PACKAGES}
    return {name: version for name, version in found.items() if version != _ABSENT}


@cache
def cpu() -> dict[str, Any]:
    """Model and vector features of the processor, on which the instructions of kernels, and so their rounding, depend."""
    fields: dict[str, str] = {}
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            for line in file:
                key, _, value = line.partition(":")
                fields.setdefault(key.strip(), value.strip())
    except OSError:
        return {"model": platform.processor() or "unknown", "features": None}
    flags = (fields.get("flags") or fields.get("Features") or "").split()
    return {
        "model": fields.get("model name") or fields.get("CPU part") or "unknown",
        "features": [name for name in _FEATURES if name in flags],
    }


@cache
def _version(name: str) -> str:
    # Cached: to look it up in a package's metadata takes 2 ms, and a loaded package does not change.
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return _ABSENT
