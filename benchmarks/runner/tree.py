"""The processes below a child: who they are, their CPU time and their resident memory, as the parent reads them.

A process cannot change what the kernel counts of it. Linux only: the clock of another process is that of
clock_getcpuclockid(3), in nanoseconds, threads that have ended included.
"""

from __future__ import annotations

import os
import time
from contextlib import suppress

__all__ = ["cpu_s", "descendants", "memory_bytes", "reset_peak", "resident_bytes"]

_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")
_PAGE = os.sysconf("SC_PAGE_SIZE")
#: clockid_t of the CPU time of another process: (~pid << 3) | CPUCLOCK_SCHED.
_SCHED = 2


def _children(pid: int) -> list[int]:
    found: list[int] = []
    try:
        for thread in os.listdir(f"/proc/{pid}/task"):
            with open(f"/proc/{pid}/task/{thread}/children", encoding="ascii") as file:
                found += map(int, file.read().split())
    except OSError:
        if os.path.isdir(f"/proc/{pid}") and not os.path.exists(f"/proc/self/task/{os.getpid()}/children"):
            return _children_by_search(pid)  # a kernel without CONFIG_PROC_CHILDREN
    return found


def _children_by_search(pid: int) -> list[int]:
    import psutil

    with suppress(psutil.Error):
        return [member.pid for member in psutil.Process(pid).children()]
    return []


def descendants(pid: int) -> list[int]:
    """All processes below `pid`, nearer ones first; ended ones too that nobody has waited for."""
    found, new = [], [pid]
    while new:
        new = [child for parent in new for child in _children(parent)]
        found += new
    return found


def cpu_s(pid: int) -> float:
    """CPU time of `pid` and of all below it, s: the living, the ended, and those that were waited for.

    Times of processes that were waited for are known to a tick (10 ms). Not counted are processes whose parent ignores SIGCHLD,
    once they have ended.
    """
    total = 0.0
    for member in (pid, *descendants(pid)):
        with suppress(OSError, ValueError, IndexError):
            total += time.clock_gettime((~member << 3) | _SCHED)
            with open(f"/proc/{member}/stat", encoding="utf-8", errors="replace") as file:
                fields = file.read().rpartition(")")[2].split()
            total += _TICK_S * (int(fields[13]) + int(fields[14]))  # cutime, cstime
    return total


def resident_bytes(pids: list[int]) -> int:
    """Resident memory of processes, bytes; pages that they share count for each."""
    total = 0
    for pid in pids:
        with suppress(OSError, ValueError, IndexError), open(f"/proc/{pid}/statm", encoding="ascii") as file:
            total += int(file.read().split()[1]) * _PAGE
    return total


def memory_bytes(pid: int, key: str) -> int:
    """A value of /proc/PID/status in bytes (`VmRSS`, `VmHWM`); -1 where it is unknown."""
    with suppress(OSError, ValueError), open(f"/proc/{pid}/status", encoding="utf-8", errors="replace") as file:
        for line in file:
            if line.startswith(key + ":"):
                return int(line.split()[1]) * 1024
    return -1


def reset_peak(pid: int) -> int:
    """Restart the high-water mark of a process, and return its resident memory, bytes; -1 where the system refuses it."""
    try:
        with open(f"/proc/{pid}/clear_refs", "w", encoding="ascii") as file:
            file.write("5")
    except OSError:
        return -1
    return memory_bytes(pid, "VmRSS")
