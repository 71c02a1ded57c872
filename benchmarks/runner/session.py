"""Run one estimator on many captures in a child process; every failure of the child becomes a status, not an exception.

A child that crashes, hangs or exceeds its limits (`attempt`) is killed with its process group, and started again for the remaining
captures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from ...estimators.labels import links_of, split_label
from ...scenes.machine import usable_cores
from ..statistics.skips import GAVE_UP
from ..suites.spec import Limits
from .attempt import REFUSED, attempt
from .forked import Prepared
from .house import HOUSE, house_error
from .job import Job, Outcome
from .process import Child
from .removal import remove

__all__ = ["Job", "Outcome", "Session", "run_jobs", "run_sessions", "waves"]


def _nothing(job: Job) -> None:
    pass


class Session:
    """One estimator and its jobs: start, warm up, then run.

    The three steps are separate so that several estimators can start and compile in parallel, while a timed call has the
    machine to itself. The same thread must start and run a session, because a child ends with the thread that started it.

    Main arguments:
        label: the estimator, `name[key=value]`. jobs: at least one, in order. limits: limits per capture.
        scratch: a private folder for the child's results, each of which is deleted after it was passed on.
    Other arguments:
        hidden: folders that the child may not read wherever they are. fresh_child: a new child for every job, which cannot
            remember the others. prepared: forks the children of built-in estimators, which are started anew without it.
        lay, clear: called before a job is carried out and after its outcome was passed on, such as to write its capture, which need
            not be there before, and to remove it.
    """

    def __init__(
        self,
        label: str,
        jobs: Sequence[Job],
        limits: Limits,
        scratch: Path,
        *,
        hidden: Sequence[Path] = (),
        fresh_child: bool = False,
        prepared: Prepared | None = None,
        lay: Callable[[Job], None] = _nothing,
        clear: Callable[[Job], None] = _nothing,
    ) -> None:
        self.label, self.jobs, self.limits, self.scratch = label, list(jobs), limits, scratch
        self.hidden, self.fresh_child, self.prepared = tuple(hidden), fresh_child, prepared
        self._lay, self._clear = lay, clear
        self._child: Child | None = None
        self._first: Outcome | None = None
        self._refused = ""
        self._answered = False

    def start(self) -> None:
        """Start the child, which then imports its modules."""
        self._child = Child(self.label, self.scratch / "cwd", hidden=self.hidden, prepared=self.prepared)

    def warm_up(self) -> None:
        """Call the estimator on data of the first capture's kind, untimed. `run` reports a failure of this call."""
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
            remove(self._answer(job))
            self._clear(job)
            if self.fresh_child:
                self.close()
                remove(self.scratch)

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
        self._lay(job)
        outcome, alive = attempt(child, job, self.limits, self._answer(job), only_warm=only_warm)
        if not alive:
            self.close(kill=True)
            assert outcome is not None
            if outcome.status.startswith(REFUSED):
                reason = outcome.status.removeprefix(REFUSED)
                # A skip must be reported before the first estimate; later it is an error, so that no capture is skipped by choice.
                skipped = reason.startswith("skip: ") and not self._answered
                outcome.status = self._refused = reason if skipped else f"error: {reason}"
        elif outcome is not None:
            self._answered = True
        return outcome


def waves(labels: Sequence[str], width: int) -> Iterator[list[int]]:
    """Places of labels in groups of up to `width`, in order, but no function twice in a group.

    Children that start together would compile the same kernels, each for itself; those of a later group find them compiled. So
    conditions and parameters of one estimator, and chains with a link in common, are in groups of their own.
    """
    left = [(n, {*links_of(split_label(label)[0])}) for n, label in enumerate(labels)]
    while left:
        group: list[int] = []
        names: set[str] = set()
        for n, links in left:
            if len(group) < width and not names & links:
                group.append(n)
                names |= links
        yield group
        left = [one for one in left if one[0] not in group]


def run_jobs(
    label: str,
    jobs: Sequence[Job],
    limits: Limits,
    scratch: Path,
    on_outcome: Callable[[Outcome], None],
    *,
    lay: Callable[[Job], None] = _nothing,
    clear: Callable[[Job], None] = _nothing,
) -> None:
    """Run one estimator on `jobs` in one child, restarted where needed. Arguments as for `Session`."""
    session = Session(label, jobs, limits, scratch, lay=lay, clear=clear)
    run_sessions([session], lambda _, outcome: on_outcome(outcome))


def run_sessions(
    sessions: Sequence[Session],
    on_outcome: Callable[[int, Outcome], None],
    *,
    before_timed: Callable[[], None] | None = None,
) -> None:
    """Run sessions in groups (`waves`), one per core: warm-ups in parallel, then timed calls one at a time.

    `on_outcome` is called with the number of the session and the outcome of each job, `before_timed` before a group's timed calls.
    """
    from concurrent.futures import ThreadPoolExecutor

    width = usable_cores()
    asked = [n for n, session in enumerate(sessions) if session.jobs]
    for numbers in waves([sessions[n].label for n in asked], width):
        wave = [(asked[n], sessions[asked[n]]) for n in numbers]
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
            if before_timed is not None:
                before_timed()
            for number, session in wave:
                session.run(partial(on_outcome, number))
                session.close()
        finally:
            for _, session in wave:
                session.close(kill=True)
