"""The workers of a data set: processes that make shards; one that dies or hangs is replaced, and its job done by another.

Workers are programs of their own (no fork), each with its share of the processors. A job that has ended three workers is set
aside and named, and the rest goes on.
"""

from __future__ import annotations

import json
import os
import selectors
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import IO, Any

from ...scenes.errors import InputError
from ..runner.protocol import THREAD_VARIABLES

__all__ = ["MOST_TRIES", "Crew", "Task", "error_of"]

#: Workers that one job may end before it is set aside.
MOST_TRIES = 3
#: Time after which a worker that uses no processor counts as hung, and least time for one that completes no capture, s.
LEAST_S = 60.0
#: A worker that uses a processor and completes nothing counts as hung after so many times the longest capture, ...
_TIMES = 20.0
#: ... and where none has been made yet (its start compiles kernels), after this time, s.
_UNKNOWN_S = 1800.0
#: What a worker may take longer for its first capture: it imports and compiles, s.
_START_S = 120.0
#: Time between two looks at the workers, s.
_LOOK_S = 1.0
#: Processor time above which a worker works, as a share of the time.
_BUSY = 0.001
_COMMAND = "from beambench.benchmarks.datasets.worker import main; main()"


@dataclass
class Task:
    """One line for a worker, and what became of it: `done` what it told, `lost` why it was set aside."""

    name: str
    line: dict[str, Any]
    tries: int = 0
    done: dict[str, Any] | None = None
    lost: str = ""
    error: InputError | None = None
    told: list[str] = field(default_factory=list)


class _Member:
    """One worker process."""

    def __init__(self, begin: dict[str, Any], threads: int, keep: int | None) -> None:
        environment = os.environ | dict.fromkeys(THREAD_VARIABLES, str(threads))
        self.errors = tempfile.TemporaryFile()  # noqa: SIM115 (closed by end)
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-c", _COMMAND, str(os.getpid())],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.errors,
            env=environment, pass_fds=() if keep is None else (keep,),
        )  # fmt: skip
        self.task: Task | None = None
        self.buffer = b""
        #: When its processor time last grew, when it last completed a capture or began a task, and how many captures it made.
        self.worked = self.progressed = time.monotonic()
        self.cpu_s, self.made = 0.0, 0
        self.send(begin)

    def begins(self, task: Task) -> None:
        """Give it a task."""
        self.task = task
        self.worked = self.progressed = time.monotonic()
        self.send(task.line)

    def wait(self, seconds: float) -> None:
        """Take no account of a time in which nobody listened."""
        self.worked, self.progressed = self.worked + seconds, self.progressed + seconds

    def look(self, now: float) -> None:
        """Note whether it has had a processor since: one that waits for ever, or is stopped, has none."""
        import psutil

        with suppress(psutil.Error):
            used = psutil.Process(self.process.pid).cpu_times()
            if used.user + used.system - self.cpu_s > _BUSY * (now - self.worked):
                self.worked, self.cpu_s = now, used.user + used.system

    @property
    def out(self) -> IO[bytes]:
        assert self.process.stdout is not None
        return self.process.stdout

    def send(self, line: dict[str, Any]) -> None:
        assert self.process.stdin is not None
        with suppress(BrokenPipeError):  # it has ended: its output tells
            self.process.stdin.write(json.dumps(line).encode() + b"\n")
            self.process.stdin.flush()

    def said(self) -> str:
        """The last line that it wrote on standard error."""
        size = self.errors.seek(0, os.SEEK_END)
        self.errors.seek(max(0, size - 2000))
        lines = self.errors.read().decode(errors="replace").strip().splitlines()
        return lines[-1][:200] if lines else ""

    def end(self) -> int:
        """End the process and return its exit code."""
        assert self.process.stdin is not None
        with suppress(OSError):
            self.process.stdin.close()
        self.process.kill()
        code = self.process.wait()
        self.out.close()
        self.errors.close()
        return code


class Crew:
    """Workers, in a `with` block.

    Main arguments:
        begin: what each worker is told first. workers: how many. threads: of each.
    Other arguments:
        keep: a file that they hold open, such as the lock of the store: it is free only when all of them have ended.
        limit_s: time after which a worker counts as hung that uses no processor, or completes no capture; None: 60 s, and for
            captures 20 times the longest so far, or `expected_s`, if that is more. Its first capture may take two minutes longer.
        expected_s: time of a capture by a pilot. tries: workers that a task may end. wanted: asked now and then; once it says
            no, all is stopped.
    """

    def __init__(
        self,
        begin: dict[str, Any],
        workers: int,
        threads: int,
        *,
        keep: int | None = None,
        limit_s: float | None = None,
        expected_s: float = 0.0,
        tries: int = MOST_TRIES,
        wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        self._begin, self._workers, self._threads = begin | {"threads": threads}, workers, threads
        self._keep, self._limit, self._longest, self._tries = keep, limit_s, expected_s, tries
        self._wanted = wanted
        self._members: list[_Member] = []
        self._selector = selectors.DefaultSelector()
        self._again: deque[Task] = deque()
        #: What happened to workers, for the report: one line each.
        self.events: list[str] = []

    def __enter__(self) -> Crew:
        return self

    def __exit__(self, *_: object) -> None:
        for member in self._members:
            member.end()
        self._members.clear()
        self._selector.close()

    def run(self, tasks: Iterable[Task], heard: Callable[[int], None]) -> Iterator[Task]:
        """Every task when it has ended, done or set aside; `heard` is told of every capture that was made.

        Raises InputError where no work can go on (a full disk): what is complete stays.
        """
        waiting = iter(tasks)
        listened = looked = time.monotonic()
        while True:
            self._hand_out(waiting)
            busy = [member for member in self._members if member.task is not None]
            if not busy:
                return
            for key, _ in self._selector.select(timeout=1.0):
                yield from self._hear(key.data, heard)
            if (gap := time.monotonic() - listened) > 3.0:
                # This process itself was stopped, or had no processor: its workers may have been, too.
                for member in busy:
                    member.wait(gap)
            listened += gap
            if listened - looked > _LOOK_S:
                looked = listened
                yield from self._look(busy)

    def _look(self, busy: list[_Member]) -> Iterator[Task]:
        """Whether the work is still wanted, and whether workers hang: the tasks that are set aside for that. Raises InputError."""
        if not self._wanted():
            raise InputError("The run that this work is part of has ended.", where="worker")
        for member in busy:
            why = self._hung(member) if member.task is not None and member in self._members else ""
            lost = self._bury(member, why) if why else None
            if lost is not None:
                yield lost

    def _hung(self, member: _Member) -> str:
        """Why a worker counts as hung, or ""."""
        now = time.monotonic()
        member.look(now)
        least = most = LEAST_S if self._limit is None else self._limit
        if self._limit is None:
            most = max(least, _TIMES * self._longest if self._longest else _UNKNOWN_S)
        if not member.made:
            least, most = least + _START_S, most + _START_S
        if now - member.worked > least:
            return f"used no processor for {least:.3g} s"
        if now - member.progressed > most:
            return f"completed no capture in {most:.3g} s"
        return ""

    def _hand_out(self, waiting: Iterator[Task]) -> None:
        """Give a task to every worker that has none, and start workers while there are tasks."""
        while True:
            member = next((one for one in self._members if one.task is None), None)
            if member is None and len(self._members) >= self._workers:
                return
            task = self._again.popleft() if self._again else next(waiting, None)
            if task is None:
                return
            if member is None:
                member = _Member(self._begin, self._threads, self._keep)
                self._members.append(member)
                self._selector.register(member.out, selectors.EVENT_READ, member)
            member.begins(task)

    def _hear(self, member: _Member, heard: Callable[[int], None]) -> Iterator[Task]:
        """What a worker has said since; the tasks that it ended."""
        content = os.read(member.out.fileno(), 2**16)
        *lines, member.buffer = (member.buffer + content).split(b"\n")
        for line in lines:
            ended = self._line(member, line, heard)
            if ended is not None:
                yield ended
        if not content:
            lost = self._bury(member, "")
            if lost is not None:
                yield lost

    def _line(self, member: _Member, line: bytes, heard: Callable[[int], None]) -> Task | None:
        told = json.loads(line)
        task = member.task
        if "capture" in told:
            now = time.monotonic()
            if member.made:
                self._longest = max(self._longest, now - member.progressed)
            member.progressed, member.made = now, member.made + 1
            heard(int(told["capture"]))
            return None
        if "stopped" in told:
            raise error_of(told["stopped"])
        assert task is not None
        member.task = None
        if "done" in told:
            task.done = told["done"]
            return task
        if "refused" in told:
            task.error = error_of(told["refused"])
            task.lost = str(task.error)
            return task
        return self._tried(task, str(told.get("failed", "")).strip().splitlines()[-1:], "failed")

    def _bury(self, member: _Member, why: str) -> Task | None:
        """Remove a worker that ended or hangs; its task goes to another, or is set aside."""
        self._selector.unregister(member.out)
        self._members.remove(member)
        with suppress(subprocess.TimeoutExpired):
            member.process.wait(timeout=0.5 if not why else 0.0)
        said = member.said()
        code = member.end()
        how = why or (f"was ended by signal {-code}" if code < 0 else f"ended with code {code}")
        if member.task is None:
            if not why and code >= 0:
                raise InputError("A worker cannot start.", where="worker", value=said, next_step="beambench doctor")
            return None
        return self._tried(member.task, [said] if said and code >= 0 else [], how)

    def _tried(self, task: Task, said: list[str], how: str) -> Task | None:
        task.tries += 1
        told = f"{task.name}: a worker {how}" + (f" ({said[0]})" if said else "")
        self.events.append(told)
        task.told.append(told)
        if task.tries < self._tries:
            self._again.append(task)
            return None
        task.lost = f"it ended {task.tries} worker{'s' if task.tries > 1 else ''}: {task.told[-1]}"
        return task


def error_of(words: dict[str, Any]) -> InputError:
    """The error that a worker told in words."""
    return InputError(
        words["what"],
        where=words["where"],
        value=words["value"],
        allowed=words["allowed"],
        next_step=words["next_step"],
    )
