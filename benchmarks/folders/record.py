"""run.json: the suite that was run, machine, versions, duration and warnings."""

from __future__ import annotations

import hashlib
import platform
import sys
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from ...scenes.machine import memory_bytes, usable_cores

__all__ = ["TABLES_VERSION", "machine", "now", "versions"]

#: Version of the tables' contract (columns, failure limit, meaning of status and of figures). 2: docs/decisions 0013 to
#: 0015. 3: 0018 and 0019. 4: 0022.
TABLES_VERSION = 5

_PACKAGES = (
    "beambench", "numpy", "scipy", "numba", "xarray", "zarr", "mitsuba", "drjit", "pandas", "pyarrow", "pydantic",
    "trimesh",
)  # fmt: skip


def now() -> str:
    """UTC, ISO 8601, whole seconds."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def _processor() -> str:
    """The processor's name as reported by the kernel, else the architecture."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            for line in file:
                if line.startswith("model name"):
                    return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.machine()


def _features() -> str:
    """A short hash of the processor's features as the kernel reports them, on which compiled code depends; "" if unknown."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            for line in file:
                if line.partition(":")[0].strip() in ("flags", "Features"):
                    names = sorted(line.partition(":")[2].split())
                    return hashlib.sha256(" ".join(names).encode()).hexdigest()[:12]
    except OSError:
        pass
    return ""


def machine() -> dict[str, Any]:
    """Description of the machine, without names of people or hosts."""
    return {
        "system": f"{platform.system()} {platform.release()}",
        "processor": _processor(),
        "features": _features(),
        "cores_usable": usable_cores(),
        "memory_bytes": memory_bytes(),
        "device_class": "cpu",
        "threads_per_estimator": 1,
    }


def versions() -> dict[str, str]:
    """Versions of Python and of the packages on which results can depend; packages that are not installed are omitted."""
    found = {"python": sys.version.split()[0]}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
