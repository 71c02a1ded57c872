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


#: Time after the first step before which nothing is said of the time that is left, s.
_ENOUGH_S = 6.0


class TimeLeft:
    """How long the rest of a stage takes, at the rate of its steps since the first, which also waits for what is compiled."""

    def __init__(self) -> None:
        #: For each stage since when steps are counted, how many were done then, and whether the first is still to come.
        self._begun: dict[str, tuple[float, int, bool]] = {}

    def __call__(self, stage: str, done: int, total: int, now_s: float) -> str:
        """Words such as "about 2 min left"; "" until a step and six seconds have followed the first one, and after the last."""
        begun, before, waits = self._begun.setdefault(stage, (now_s, done, True))
        if done < before or (waits and done > before):  # the stage begins anew, or its first step is done
            self._begun[stage] = (now_s, done, done < before)
            return ""
        passed, steps = now_s - begun, done - before
        if steps <= 0 or done >= total or passed < _ENOUGH_S:
            return ""
        left = passed / steps * (total - done)
        if left < 100:
            return f"about {left:.0f} s left"
        return f"about {left / 60:.0f} min left" if left < 6000 else f"about {left / 3600:.1f} h left"


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
