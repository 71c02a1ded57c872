"""One capture for one child: hand it over, measure the call, limit it, and read the answer.

The parent measures. It reads the clocks of the child and of all that the child started when the child has the capture and waits,
and again when the call is over and the child waits; a patched clock in the child changes nothing. Whatever the child does before
and after, beyond what it takes to map a capture and to write an answer, counts as part of the call. Wall time includes some
50 us in which the two processes wake each other.

Each call gets data that the child has not seen: the answer of the first is scored; those that repeat it get other noise of the
same light, and the warm-up gets data that are drawn from a few elements (`sealed`).
"""

from __future__ import annotations

import contextlib
import os
import selectors
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy.typing as npt

from ...captures.layouts import layout_of, stage_of, stages
from ...scenes.plain_text import plain_text
from ..suites.spec import Limits
from . import tree
from .house import HOUSE, machine_failure
from .job import Job, Outcome
from .patience import Patience
from .process import Child
from .protocol import read_results
from .sealed import Alter, block, drawn, fresh, stale

__all__ = ["REFUSED", "STALE", "attempt"]

#: Interval at which the parent measures the child's memory, s. In this time a child can grow beyond its limit.
_POLL_S = 0.02
REFUSED = "error: refused: "
#: Why an answer to other data is refused that is the answer to the first.
STALE = "gave the same answer to other data"
#: Calls whose total time is shorter than this are repeated, so that a time is a median with a spread.
_ENOUGH_S = 0.1
_MOST_CALLS = 5
#: Least number of calls, unless the calls have already taken this long.
_LEAST_CALLS, _LONG_S = 3, 1.0
#: What a child may need beside its call: to map a capture and to write an answer [s], and per byte [s].
_BESIDE_S, _BESIDE_PER_BYTE_S = 5e-3, 2e-9
#: Wall time that writing an answer may take beyond that, when the disk or the processor is busy, s.
_LATE_S = 0.25


class _Over(Exception):
    """The end of an attempt: its outcome, and whether the child can continue."""

    def __init__(self, outcome: Outcome, alive: bool) -> None:
        self.outcome, self.alive = outcome, alive


def attempt(child: Child, job: Job, limits: Limits, answer: Path, *, only_warm: bool) -> tuple[Outcome | None, bool]:
    """Carry out one job, or only its warm-up: its outcome (None after a warm-up), and whether the child can continue."""
    child.printed, child.tail = 0, b""
    try:
        _begin(child, job, limits)
        if only_warm:
            return None, True
        return _Calls(child, job, limits, answer).outcome(), True
    except _Over as over:
        return over.outcome, over.alive


def _begin(child: Child, job: Job, limits: Limits) -> None:
    """Name the job, with data for a warm-up, and wait until the child is idle."""
    layout = layout_of(job.modality)
    with _handed(child, job, drawn(layout.data, layout.element)) as handle:
        child.send({"job": job.index, "modality": job.modality}, handle)
        warm = _wait(child, job, limits, "warm")
        child.warm = child.warm or warm.get("warm") is True
        _wait(child, job, limits, "idle")


@contextmanager
def _handed(child: Child, job: Job, alter: Alter | None) -> Iterator[int]:
    """The handle of the job's capture, with other data if `alter` is given; a failure here is the machine's."""
    try:
        handle = block(job.folder, job.condition, alter)
    except OSError as error:
        told = f"{HOUSE}the capture cannot be read: {error}"
        raise _Over(_outcome(child, job, told), False) from error
    try:
        yield handle
    finally:
        os.close(handle)


class _Calls:
    """The calls of one job."""

    def __init__(self, child: Child, job: Job, limits: Limits, answer: Path) -> None:
        self.child, self.job, self.limits, self.answer = child, job, limits, answer
        self.cpu: list[float] = []
        self.wall: list[float] = []
        self.peak = -1.0

    def outcome(self) -> Outcome:
        """Call until the times are known well enough; the answer is that of the first call."""
        first = self._call(self.answer, None)
        outcome = _outcome(self.child, self.job, f"invalid: {first[1]}" if first[1] else "ok")
        outcome.arrays = first[0]
        if not self.job.timed:
            return outcome
        data = layout_of(self.job.modality).data
        while self._again() and outcome.status == "ok":
            # New noise for every call: a second call with the same would be answered from memory.
            arrays, wrong = self._call(self.answer.with_name(self.answer.name + "-again"), fresh(data))
            if not wrong and stale(outcome.arrays, arrays):
                outcome.status, outcome.arrays = f"invalid: {STALE}", {}
        middle = (len(self.wall) - 1) // 2
        outcome.cpu_s, outcome.wall_s = sorted(self.cpu)[middle], sorted(self.wall)[middle]
        outcome.cpu_calls, outcome.wall_calls = tuple(self.cpu), tuple(self.wall)
        outcome.peak_bytes = self.peak if self.peak >= 0 else float("nan")
        return outcome

    def _again(self) -> bool:
        """Whether more calls are needed for a reliable median of these times."""
        spent = sum(self.wall)
        few = len(self.wall) < _LEAST_CALLS and spent < _LONG_S
        return few or (len(self.wall) < _MOST_CALLS and spent < _ENOUGH_S)

    def _call(self, answer: Path, alter: Alter | None) -> tuple[dict[str, npt.NDArray[Any]], str]:
        """One measured call: the arrays of its answer and what is wrong with them."""
        child, job = self.child, self.job
        with _handed(child, job, alter) as handle:
            beside = _BESIDE_S + _BESIDE_PER_BYTE_S * os.fstat(handle).st_size
            cpu, wall = [child.cpu_s()], [time.perf_counter()]
            child.send({"output": str(answer), "sizes": dict(job.sizes)}, handle)
            self._mark("ready", cpu, wall)
            before = tree.reset_peak(child.worker()) if not self.wall else -1
            cpu[1], wall[1] = child.cpu_s(), time.perf_counter()
            child.send({"go": True})
            self._mark("called", cpu, wall)
            if before >= 0:
                self.peak = max(float(tree.memory_bytes(child.worker(), "VmHWM") - before), 0.0)
            kept = time.perf_counter()
            child.send({"keep": True})
            self._mark("done", cpu, wall)
        child.warm = True
        self.cpu.append(cpu[2] - cpu[1] + max(cpu[1] - cpu[0] + cpu[3] - cpu[2] - beside, 0.0))
        self.wall.append(wall[2] - wall[1] + max(wall[3] - kept - beside - _LATE_S, 0.0))
        return read_results(answer, stage_of(child.stage), dict(job.sizes))

    def _mark(self, wanted: str, cpu: list[float], wall: list[float]) -> dict[str, Any]:
        """Wait for an event, and read the clocks."""
        event = _wait(self.child, self.job, self.limits, wanted)
        wall.append(float(event["at"]))
        cpu.append(self.child.cpu_s())
        return event


def _wait(child: Child, job: Job, limits: Limits, wanted: str) -> dict[str, Any]:
    """Wait for an event of the child, and return it with the time `at` which it came. Raises _Over for any other end."""
    limit_s = limits.time_s if child.warm else limits.warmup_s
    patience = Patience(child.process.pid, limit_s)
    with selectors.DefaultSelector() as selector:
        selector.register(child.events, selectors.EVENT_READ)
        selector.register(child.output, selectors.EVENT_READ)
        while True:
            ready = {key.fd for key, _ in selector.select(0.0 if child.waiting else _POLL_S)}
            at = time.perf_counter()
            if child.output in ready and not child.read_output():
                selector.unregister(child.output)
            is_open = True
            if child.events in ready:
                try:
                    is_open = child.read_events()
                except ValueError:
                    raise _broken(child, job) from None
            while child.waiting:
                event = child.waiting.pop(0)
                if _told(child, job, event, wanted):
                    return event | {"at": at}
            if not is_open:
                raise _Over(_outcome(child, job, _crash(child)), False)
            _within(child, job, limits, patience)


def _told(child: Child, job: Job, event: dict[str, Any], wanted: str) -> bool:
    """Whether an event is the one that is waited for. Raises _Over for one that ends the job."""
    kind = event.get("event")
    if kind == "started" and not child.stage:
        word = event.get("stage")
        if not isinstance(word, str) or word not in stages():  # a plug-in may write events as it is imported
            raise _broken(child, job)
        child.stage = word
        return False
    if kind == wanted and child.stage:
        return True
    if kind == "refused":
        raise _Over(_outcome(child, job, REFUSED + _line(event)), False)
    if kind == "house":
        raise _Over(_outcome(child, job, _blamed(child) + _line(event)), False)
    if kind in ("error", "memory", "invalid", "skip"):
        raise _Over(_outcome(child, job, f"{kind}: {_line(event)}"), True)
    raise _broken(child, job)


def _blamed(child: Child) -> str:
    """Whose failure it is that a child calls the machine's: the machine's, but a plug-in's where the runner finds it sound."""
    if child.plugin:
        child.end(kill=True)
        child.clear()
        return "error: " if not machine_failure(child.folder) else HOUSE
    return HOUSE


def _within(child: Child, job: Job, limits: Limits, patience: Patience) -> None:
    """Raise _Over for a child beyond its limits."""
    status = ""
    if child.printed > limits.output_bytes:
        status = f"flood: printed over {limits.output_bytes} bytes"
    elif child.resident_bytes() > limits.memory_bytes:
        status = f"memory: over {limits.memory_bytes / 2**20:.0f} MiB resident"
    elif patience.over():
        status = f"timeout: {'call' if child.warm else 'warm-up'} over {patience.limit_s:g} s"
    if status:
        raise _Over(_outcome(child, job, status), False)


def _broken(child: Child, job: Job) -> _Over:
    return _Over(_outcome(child, job, "crash: broken events"), False)


def _outcome(child: Child, job: Job, status: str) -> Outcome:
    return Outcome(job, status, printed=child.tail.decode(errors="replace"), word=child.stage)


def _line(event: dict[str, Any]) -> str:
    """The message of an event in one short line, for a table."""
    return plain_text(" ".join(str(event.get("message", "")).split())[:300])


def _crash(child: Child) -> str:
    if not child.ended(2.0):
        return "crash: closed its pipes"
    code = child.end(kill=True)
    if code < 0:
        with contextlib.suppress(ValueError):
            return f"crash:{signal.Signals(-code).name}"
    return f"crash:exit {code}"
