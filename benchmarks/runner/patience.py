"""A limit on the wall time of a child that does not count the time in which it was ready to run and the processor was taken.

On a busy machine a limit of plain wall time is reached by estimators that are fast enough, so that a loaded machine would decide
which rows fail. A child that hangs waits for something else, and reaches the limit as before.
"""

from __future__ import annotations

import os
import time

from .tree import descendants

__all__ = ["Patience", "waited_s"]

#: The limit is at most this many times as long in plain wall time.
_MOST = 30.0


class Patience:
    """The time that a child may take.

    Main arguments:
        pid: of the child; its threads and descendants in its session count. limit_s: wall time less the wait for a processor, s.
    """

    def __init__(self, pid: int, limit_s: float) -> None:
        self.limit_s, self._pid = limit_s, pid
        self._start, self._before = time.monotonic(), waited_s(pid)

    def over(self) -> bool:
        """Whether the limit is reached."""
        spent = time.monotonic() - self._start
        if spent <= self.limit_s:
            return False
        if spent > _MOST * self.limit_s:
            return True
        now = waited_s(self._pid)
        # Threads wait side by side: the one that waited longest counts.
        waited = max((value - self._before.get(thread, 0.0) for thread, value in now.items()), default=0.0)
        return spent - waited > self.limit_s


def waited_s(pid: int) -> dict[int, float]:
    """Seconds that each thread of a process and of its descendants was ready to run and waited for a processor.

    From /proc/PID/task/TID/schedstat (Linux, Documentation/scheduler/sched-stats.rst); empty where the kernel has none.
    """
    found: dict[int, float] = {}
    for process in (pid, *descendants(pid)):
        try:
            threads = os.listdir(f"/proc/{process}/task")
        except OSError:
            continue
        for thread in threads:
            try:
                with open(f"/proc/{process}/task/{thread}/schedstat", encoding="ascii") as file:
                    found[int(thread)] = int(file.read().split()[1]) * 1e-9
            except (OSError, ValueError, IndexError):
                continue
    return found
