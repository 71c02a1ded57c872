"""The machine: Python, processor and disks."""

from __future__ import annotations

import os
import platform
import shutil
import sys
import tempfile
from pathlib import Path

from ..benchmarks.runner.jail import abi, isolation
from ..scenes.machine import usable_cores
from .finding import Finding
from .packages import version_of

__all__ = ["disks", "jail", "python"]

#: Below this a run of quickstart may not fit.
_DISK_BYTES = 2 * 2**30


def python() -> list[Finding]:
    """Python, Beambench and the processor's cores."""
    text = f"{platform.python_implementation()} {platform.python_version()} on {platform.system()} {platform.machine()}"
    good = sys.version_info >= (3, 11)
    cores = usable_cores()
    return [
        Finding("python", "python", "ok" if good else "broken", text, "" if good else "install Python 3.11 or newer"),
        Finding("python", "beambench", "ok", version_of("beambench") or "not installed as a package"),
        Finding("python", "cores", "ok", str(cores)),
    ]


def jail() -> Finding:
    """The isolation in which estimators run on this machine."""
    text = isolation()
    held = bool(abi()) and text.startswith("Landlock")
    advice = "" if held else "publish rankings from a machine with Linux 5.13 or newer and Landlock"
    return Finding("estimators", "isolation", "ok" if held else "warning", text, advice)


def disks() -> list[Finding]:
    """Free space of the working folder and the temporary folder."""
    found = []
    for name, folder in (("working folder", Path.cwd()), ("temporary folder", Path(tempfile.gettempdir()))):
        free = shutil.disk_usage(folder).free
        writable = os.access(folder, os.W_OK)
        state = "ok" if writable and free > _DISK_BYTES else "warning"
        advice = "" if writable else "give --out in a writable folder"
        if writable and free <= _DISK_BYTES:
            advice = "free some space: a run of quickstart takes up to 2 GiB"
        found.append(Finding("disk", name, state, f"{folder}: {free / 2**30:.1f} GiB free", advice))
    return found
