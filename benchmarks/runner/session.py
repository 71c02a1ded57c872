"""Run one estimator on many captures in a child process; every failure of the child becomes a status, not an exception.

The parent supervises the child: it limits wall time (less the wait for a processor, `patience`), resident memory (of the child
and its descendants, by polling) and printed output. A child that crashes, hangs or exceeds its memory is killed with its process
group, and started again for the remaining captures.
"""

from __future__ import annotations

import contextlib
import math
import os
import selectors
import shutil
import signal
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...captures.layouts import layout_of, stage_of, stages
from ...captures.quantities import Stage
from ..statistics.skips import GAVE_UP
from ..suites.spec import Limits
from .house import HOUSE, house_error
from .patience import Patience
from .process import Child
from .protocol import files_of, read_results

__all__ = ["Job", "Outcome", "Session", "run_jobs", "run_sessions"]

#: Interval at which the parent measures the child's memory, s. In this time a child can grow beyond its limit.
_POLL_S = 0.02
_REFUSED = "error: refused: "


@dataclass(frozen=True)
class Job:
    """One capture under one condition for one estimator.

    `sizes`: lengths of the capture's dimensions. `timed`: False makes a single call without times and memory, which is
    cheaper if only the estimate is needed.
    """

    index: int
    folder: Path
    condition: str
    modality: str
    sizes: Mapping[str, int]
    timed: bool = True

    @property
    def elements(self) -> int:
        """Number of elements (pixels, shots, rows) of the capture."""
        return math.prod(self.sizes[dim] for dim in layout_of(self.modality).element)


@dataclass
class Outcome:
    """Result of a job. `status` is "ok", or begins with one of crash:, timeout:, memory:, flood:, error:, invalid:, skip:.

    `stage`: stage of the estimator; the modality's first if the estimator ended before it reported its stage.
    `cpu_s`, `wall_s`: medians over the timed calls, s; `cpu_calls`, `wall_calls`: the times of the single calls, s.
    """

    job: Job
    status: str
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    cpu_s: float = float("nan")
    wall_s: float = float("nan")
    peak_bytes: float = float("nan")
    printed: str = ""
    cpu_calls: tuple[float, ...] = ()
    wall_calls: tuple[float, ...] = ()
    word: str = ""

    @property
    def stage(self) -> Stage:
        """The stage of the estimator; the first of the capture's modality if the estimator is of another modality."""
        first = layout_of(self.job.modality).stages[0]
        if not self.word:
            return first
        stage = stage_of(self.word)
        return stage if stage.modality == self.job.modality else first


class Session:
    """One estimator and its jobs: start, warm up, then run.

    The three steps are separate so that several estimators can start and compile in parallel, while a timed call has the
    machine to itself. The same thread must start and run a session, because a child ends with the thread that started it.

    Main arguments:
        label: the estimator, `name[key=value]`. jobs: at least one, in order. limits: limits per capture.
        scratch: a private folder for the child's results, each of which is deleted after it was passed on.
    Other arguments:
        inputs: folder that the child may read, for jobs that are added later; by default only the files of `jobs`, and of these
        only the declared rig of the job's condition. hidden: folders that it may not read wherever they are.
    """

    def __init__(
        self,
        label: str,
        jobs: Sequence[Job],
        limits: Limits,
        scratch: Path,
        *,
        inputs: Path | None = None,
        hidden: Sequence[Path] = (),
    ) -> None:
        self.label, self.jobs, self.limits, self.scratch = label, list(jobs), limits, scratch
        self.inputs, self.hidden = inputs, tuple(hidden)
        self._child: Child | None = None
        self._first: Outcome | None = None
        self._refused = ""
        self._answered = False

    def start(self) -> None:
        """Start the child, which then imports its modules."""
        inputs = [path for job in self.jobs for path in files_of(job.folder, job.condition)]
        self._child = Child(
            self.label, self.scratch / "cwd", inputs=[self.inputs] if self.inputs else inputs, hidden=self.hidden
        )

    def warm_up(self) -> None:
        """Call the estimator on the first capture, untimed. `run` reports a failure of this call."""
        if self._child is not None and self.jobs:
            self._first = self._attempt(self._child, self.jobs[0], only_warm=True)

    def run(self, on_outcome: Callable[[Outcome], None]) -> None:
        """Carry out all jobs, restart the child where needed, and pass each outcome on.

        Raises InputError where the machine failed: no estimator is scored for that.

        An estimator that exceeds its limits `limits.give_up_after` times in a row is not started again. The status of its
        remaining jobs is "skip: gave up ...", which is scored like a refusal of every element.
        """
        exceeded = 0
        for number, job in enumerate(self.jobs):
            if number == 0 and self._first is not None:
                outcome: Outcome | None = self._first
            elif self._refused:
                outcome = Outcome(job, self._refused)
            elif exceeded >= self.limits.give_up_after:
                outcome = Outcome(job, f"{GAVE_UP} {exceeded} times in a row")
            else:
                if self._child is None:
                    self.start()
                assert self._child is not None
                outcome = self._attempt(self._child, job, only_warm=False)
            assert outcome is not None
            if outcome.status.startswith(HOUSE):
                raise house_error(self.label, outcome.status)
            if not outcome.status.startswith(GAVE_UP):
                exceeded = exceeded + 1 if outcome.status.startswith(("timeout:", "memory:")) else 0
            on_outcome(outcome)
            shutil.rmtree(self._answer(job), ignore_errors=True)

    def close(self, *, kill: bool = False) -> None:
        """End the child, and kill it if it does not end."""
        if self._child is not None:
            self._child.end(kill=kill)
            self._child = None

    def kill(self) -> None:
        """Kill the child at once; a thread that waits for it gets a crash. Safe from any thread."""
        if (child := self._child) is not None:
            child.kill()

    def _answer(self, job: Job) -> Path:
        return self.scratch / f"answer-{job.index}-{job.condition}"

    def _attempt(self, child: Child, job: Job, *, only_warm: bool) -> Outcome | None:
        """Carry out one job, or only its warm-up (then None on success). A child that cannot continue is ended."""
        outcome, alive = _one(child, job, self.limits, self._answer(job), only_warm)
        if not alive:
            self.close(kill=True)
            assert outcome is not None
            if outcome.status.startswith(_REFUSED):
                reason = outcome.status.removeprefix(_REFUSED)
                # A skip must be reported before the first estimate; later it is an error, so that no capture is skipped by choice.
                skipped = reason.startswith("skip: ") and not self._answered
                outcome.status = self._refused = reason if skipped else f"error: {reason}"
        elif outcome is not None:
            self._answered = True
        return outcome


def run_jobs(
    label: str, jobs: Sequence[Job], limits: Limits, scratch: Path, on_outcome: Callable[[Outcome], None]
) -> None:
    """Run one estimator on `jobs` in one child, restarted where needed. Arguments as for `Session`."""
    run_sessions([Session(label, jobs, limits, scratch)], lambda _, outcome: on_outcome(outcome))


def run_sessions(sessions: Sequence[Session], on_outcome: Callable[[int, Outcome], None]) -> None:
    """Run sessions in groups, one per core: warm-ups in parallel, then timed calls one at a time.

    `on_outcome` is called with the number of the session and the outcome of each job.
    """
    from concurrent.futures import ThreadPoolExecutor

    width = max(1, len(os.sched_getaffinity(0)))
    for first in range(0, len(sessions), width):
        wave = [(n, session) for n, session in enumerate(sessions[first : first + width], first) if session.jobs]
        try:
            for _, session in wave:
                session.start()
            with ThreadPoolExecutor(max_workers=width) as pool:
                try:
                    list(pool.map(lambda item: item[1].warm_up(), wave))
                except BaseException:  # Ctrl-C: the threads wait for their children, so these are killed first
                    for _, session in wave:
                        session.kill()
                    raise
            for number, session in wave:
                session.run(partial(on_outcome, number))
                session.close()
        finally:
            for _, session in wave:
                session.close(kill=True)


def _one(child: Child, job: Job, limits: Limits, answer: Path, only_warm: bool) -> tuple[Outcome | None, bool]:
    """Send one job and wait: its outcome (None after a warm-up), and whether the child can continue."""
    child.printed, child.tail = 0, b""
    message = {
        "job": job.index, "input": str(job.folder), "condition": job.condition, "output": str(answer),
        "sizes": dict(job.sizes), "modality": job.modality, "only_warm": only_warm, "timed": job.timed,
    }  # fmt: skip
    child.send(message)
    first = not child.warm
    patience = Patience(child.process.pid, limits.warmup_s if first else limits.time_s)
    with selectors.DefaultSelector() as selector:
        selector.register(child.events, selectors.EVENT_READ)
        selector.register(child.output, selectors.EVENT_READ)
        while True:
            ready = {key.fd for key, _ in selector.select(_POLL_S)}
            if child.output in ready and not child.read_output():
                selector.unregister(child.output)
            if child.events in ready:
                try:
                    events, is_open = child.read_events()
                except ValueError:
                    return _outcome(child, job, "crash: broken events"), False
                for event in events:
                    kind = event.get("event")
                    if kind == "started":
                        if event.get("stage") not in stages():
                            return _outcome(child, job, "crash: broken events"), False
                        child.stage = str(event["stage"])
                    elif kind == "refused":
                        return _outcome(child, job, _REFUSED + _line(event)), False
                    if kind == "warm":
                        child.warm = True
                        if only_warm:
                            return None, True
                        patience = Patience(child.process.pid, limits.time_s)
                    elif kind == "house":
                        return _outcome(child, job, HOUSE + _line(event)), False
                    elif kind in ("error", "memory", "invalid", "skip"):
                        return _outcome(child, job, f"{kind}: {_line(event)}"), True
                    elif kind == "done":
                        return _finished(child, job, event, answer), True
                if not is_open:
                    return _outcome(child, job, _crash(child)), False
            if child.printed > limits.output_bytes:
                return _outcome(child, job, f"flood: printed over {limits.output_bytes} bytes"), False
            if child.resident_bytes() > limits.memory_bytes:
                return _outcome(child, job, f"memory: over {limits.memory_bytes / 2**20:.0f} MiB resident"), False
            if patience.over():
                stage = "call" if child.warm else "warm-up"
                return _outcome(child, job, f"timeout: {stage} over {patience.limit_s:g} s"), False


def _finished(child: Child, job: Job, event: dict[str, Any], answer: Path) -> Outcome:
    arrays, wrong = read_results(answer, stage_of(child.stage), dict(job.sizes))
    outcome = _outcome(child, job, f"invalid: {wrong}" if wrong else "ok")
    outcome.arrays = arrays
    for name in ("cpu_s", "wall_s", "peak_bytes"):
        value = event.get(name)
        if isinstance(value, int | float) and value >= 0:
            setattr(outcome, name, float(value))
    for name in ("cpu_calls", "wall_calls"):
        calls = event.get(name)
        if isinstance(calls, list) and all(isinstance(call, int | float) and call >= 0 for call in calls):
            setattr(outcome, name, tuple(map(float, calls)))
    return outcome


def _outcome(child: Child, job: Job, status: str) -> Outcome:
    return Outcome(job, status, printed=child.tail.decode(errors="replace"), word=child.stage)


def _line(event: dict[str, Any]) -> str:
    """The message of an event in one short line, for a table."""
    return " ".join(str(event.get("message", "")).split())[:300]


def _crash(child: Child) -> str:
    if not child.ended(2.0):
        return "crash: closed its pipes"
    code = child.end(kill=True)
    if code < 0:
        with contextlib.suppress(ValueError):
            return f"crash:{signal.Signals(-code).name}"
    return f"crash:exit {code}"
