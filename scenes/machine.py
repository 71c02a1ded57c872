"""What this process may use of its machine: processors and memory, by affinity and by the limits of its control group.

In a container the machine shows all of its processors and memory, and a process that takes more than its share is slowed or killed.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

__all__ = ["free_bytes", "memory_bytes", "usable_cores"]

#: Where control groups are, and the file that tells the group of this process.
GROUPS, OWN = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
#: A limit above this is none (version 1 writes nearly 2⁶³).
_NONE = 2**60


def usable_cores() -> int:
    """Processors that this process may use: its affinity, and the quota of its control group (cgroup v2 or v1)."""
    own = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota = _quota()
    return max(1, min(own, int(quota) if quota >= 1 else 1)) if quota else own


def memory_bytes() -> int:
    """Memory of the machine, or the limit of the control group where that is less."""
    import psutil

    return min([int(psutil.virtual_memory().total), *_limits("memory.max", "memory.limit_in_bytes")])


def free_bytes() -> int:
    """Memory that can be had without swapping and below the limit of the control group."""
    import psutil

    held = [int(psutil.virtual_memory().available)]
    for limit, name in (("memory.max", "memory.current"), ("memory.limit_in_bytes", "memory.usage_in_bytes")):
        for folder in _folders("memory"):
            with suppress(OSError, ValueError):
                most = int((folder / limit).read_text(encoding="ascii"))
                if most < _NONE:
                    held.append(max(0, most - int((folder / name).read_text(encoding="ascii"))))
    return min(held)


def _quota() -> float:
    """Processors by the least quota of the control group and those above it; 0 without one."""
    found = []
    for folder in _folders("cpu"):
        with suppress(OSError, ValueError):
            most, period = (folder / "cpu.max").read_text(encoding="ascii").split()
            found += [] if most == "max" else [float(most) / float(period)]
        with suppress(OSError, ValueError):
            most_us = float((folder / "cpu.cfs_quota_us").read_text(encoding="ascii"))
            found += (
                [most_us / float((folder / "cpu.cfs_period_us").read_text(encoding="ascii"))] if most_us > 0 else []
            )
    return min(found, default=0.0)


def _limits(*names: str) -> list[int]:
    found = []
    for folder in _folders("memory"):
        for name in names:
            with suppress(OSError, ValueError):  # "max" is no number: no limit
                limit = int((folder / name).read_text(encoding="ascii"))
                found += [limit] if limit < _NONE else []
    return found


def _folders(controller: str) -> list[Path]:
    """Folders of the control group of this process and of those above it: version 2, and version 1 of a controller."""
    places = {GROUPS: "/", GROUPS / controller: "/"}
    with suppress(OSError, ValueError):
        for line in OWN.read_text(encoding="ascii").splitlines():
            _, controllers, place = line.split(":", 2)
            if not controllers:
                places[GROUPS] = place
            elif controller in controllers.split(","):
                places[GROUPS / controller] = place
    found = []
    for root, place in places.items():
        inside = root / place.strip("/")
        while True:
            found.append(inside)
            if inside == root or root not in inside.parents:
                break
            inside = inside.parent
        found.append(root)
    return list(dict.fromkeys(found))
