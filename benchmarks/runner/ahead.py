"""Compile the kernels of built-in estimators while captures are still generated.

    with Ahead(limits, scratch, prepared) as ahead:
        if ahead.lacks(label):
            ahead.add(label, job)   # as soon as the first capture that the estimator reads is there
        ahead.stop()            # before anything is timed

Each estimator is warmed up once in a child of its own, one at a time, which leaves its kernels in the folder of compiled code:
later children load them. The last one added comes first, as the timed runs begin with the first. An estimator whose warm-up has
passed before, with the same sources, is left out: a mark in that folder says so.
"""

from __future__ import annotations

import contextlib
import hashlib
import threading
from pathlib import Path
from types import TracebackType

from ...estimators.chain import is_built_in
from ...estimators.labels import split_label
from ...optics.jit import cache_folder
from ..suites.spec import Limits
from .forked import Prepared
from .removal import remove
from .session import Job, Session

__all__ = ["Ahead"]


class Ahead:
    """Warm-ups of estimators by a thread of its own.

    Main arguments:
        limits: of a warm-up. scratch: a private folder that need not exist. prepared: forks the children.
    """

    def __init__(self, limits: Limits, scratch: Path, prepared: Prepared) -> None:
        self._limits, self._scratch, self._prepared = limits, scratch, prepared
        self._seen: set[str] = set()
        self._captures: set[Path] = set()
        self._waiting: list[tuple[str, Job]] = []
        self._turn = threading.Lock()
        self._thread: threading.Thread | None = None
        self._session: Session | None = None

    def __enter__(self) -> Ahead:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop(kill=kind is not None)

    def lacks(self, label: str) -> bool:
        """Whether an estimator has yet to be warmed up: it is built in, was not added, and has no mark."""
        return label not in self._seen and is_built_in(split_label(label)[0]) and not _mark(label).exists()

    def add(self, label: str, job: Job) -> None:
        """Warm an estimator up on a capture, which `stop` removes."""
        self._seen.add(label)
        self._captures.add(job.folder)
        with self._turn:
            self._waiting.append((label, job))
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="compile-ahead", daemon=True)
                self._thread.start()

    def stop(self, *, kill: bool = False) -> None:
        """Begin no other warm-up, wait for the one that has begun or kill it, and remove the captures."""
        with self._turn:
            self._waiting.clear()
            thread, session = self._thread, self._session
        if kill and session is not None:
            session.kill()
        if thread is not None:
            thread.join()
        while self._captures:
            remove(self._captures.pop())

    def _run(self) -> None:
        """Warm up what waits, until nothing does."""
        while True:
            with self._turn:
                if not self._waiting:
                    self._thread = None
                    return
                label, job = self._waiting.pop()
            # What goes wrong here goes wrong again when the estimator is run, and is told there.
            with contextlib.suppress(Exception):
                self._warm(label, job)

    def _warm(self, label: str, job: Job) -> None:
        session = self._session = Session(label, [job], self._limits, self._scratch, prepared=self._prepared)
        try:
            session.start()
            if session.warm_up():
                mark = _mark(label)
                mark.parent.mkdir(exist_ok=True)
                mark.touch()
        finally:
            self._session = None
            session.close(kill=True)
            remove(self._scratch)


def _mark(label: str) -> Path:
    return cache_folder() / "compiled" / hashlib.sha256(label.encode()).hexdigest()[:16]
