"""Progress of a run: bars in a terminal, plain lines elsewhere. Any callable with the same arguments can replace them."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Protocol, TextIO

from ...scenes.plain_text import plain_text

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID

__all__ = ["Bars", "Lines", "Progress", "TimeLeft", "silent", "terminal_progress"]


class Progress(Protocol):
    """Called after every step: `stage` ("generate", "estimate", "report"), steps `done` of `total`, and a description."""

    def __call__(self, stage: str, done: int, total: int, text: str) -> None: ...


def silent(stage: str, done: int, total: int, text: str) -> None:
    """Say nothing."""


class TimeLeft:
    """How long the rest of a stage takes, at the rate of its steps so far."""

    def __init__(self) -> None:
        self._begun: dict[str, tuple[float, int]] = {}

    def __call__(self, stage: str, done: int, total: int, now_s: float) -> str:
        """Words such as "about 2 min left"; "" before a step is done, after the last, and within the first two seconds."""
        begun, before = self._begun.setdefault(stage, (now_s, done))
        passed, steps = now_s - begun, done - before
        if done < before:  # the stage begins anew
            self._begun[stage] = (now_s, done)
        if steps <= 0 or done >= total or passed < 2.0:
            return ""
        left = passed / steps * (total - done)
        return f"about {left:.0f} s left" if left < 100 else f"about {left / 60:.0f} min left"


class Lines:
    """One plain line per step, with the time that is left: at most one per second and stage, and always the last."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream if stream is not None else sys.stderr
        self._last: dict[str, float] = {}
        self._left = TimeLeft()

    def __enter__(self) -> Lines:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stream.flush()

    def __call__(self, stage: str, done: int, total: int, text: str) -> None:
        now = time.monotonic()
        left = self._left(stage, done, total, now)
        if done < total and now - self._last.get(stage, -1e9) < 1.0:
            return
        self._last[stage] = now
        words = f"{stage} {done}/{total} {text}".rstrip() + (f" ({left})" if left else "")
        print(plain_text(words), file=self._stream, flush=True)


class Bars:
    """One bar per stage. Use in a `with` block."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        self._bars: RichProgress = Progress(
            TextColumn("{task.fields[stage]:<9}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn(),
            TextColumn("{task.description}"), console=Console(stderr=True), transient=False,
        )  # fmt: skip
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> Bars:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()

    def __call__(self, stage: str, done: int, total: int, text: str) -> None:
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(text, total=total, stage=stage)
        # Names come from suites and plug-ins: square brackets in labels are not markup.
        self._bars.update(
            self._tasks[stage], completed=done, total=total, description=plain_text(text).replace("[", "\\[")
        )


def terminal_progress(stream: TextIO | None = None) -> Bars | Lines:
    """Bars where standard error is a terminal, else lines."""
    chosen = stream if stream is not None else sys.stderr
    return Bars() if chosen.isatty() and stream is None else Lines(chosen)
