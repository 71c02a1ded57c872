"""Compile what a run will need while its captures are generated, in a process of its own.

    with Ahead(labels) as ahead:   # generate meanwhile
        ahead.stop()               # before anything is timed

    python -P -m beambench.benchmarks.ahead RUNNER_PID LABEL...

The process calls the built-in estimators on the clean captures of the laws, so that their kernels lie in the folder of compiled
code when they are needed. The estimator with the most kernels comes first: what would keep one processor busy for longest. A
mark in that folder says what has been done, with the same sources; where all has been done, no process is started. What it is
ended in the middle of is compiled when it is needed, as without it. Plug-ins are left out, as their code runs in a jail only.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from ..estimators.chain import is_built_in
from ..estimators.labels import split_label
from ..optics.jit import cache_folder, compiling, kernels_below
from ..scenes.machine import usable_cores
from .runner.child import bind, die_with
from .runner.variables import child_environment, start_beside

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Ahead", "compile_all", "main"]


class Ahead:
    """The process, for as long as captures are generated; none where there is nothing to do, or no processor to spare.

    Main arguments:
        labels: the estimators of the run.
    """

    def __init__(self, labels: Sequence[str]) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        left = [label for label in labels if is_built_in(split_label(label)[0]) and not _mark(label).exists()]
        if left and usable_cores() > 1:
            with contextlib.suppress(OSError):  # then all is compiled when it is needed
                self._process = start_beside("ahead", [str(os.getpid()), *left], child_environment())

    def __enter__(self) -> Ahead:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def stop(self) -> None:
        """End the process, wherever it is."""
        if (process := self._process) is None:
            return
        self._process = None
        process.kill()  # files of compiled code get their names when they are whole
        process.wait()


def _mark(name: str) -> Path:
    return cache_folder() / "compiled" / hashlib.sha256(name.encode()).hexdigest()[:16]


def compile_all(labels: Sequence[str]) -> None:
    """Call estimators on a capture that they read, those with the most kernels first, and mark each as done.

    One that fails is marked, too: it would fail again, and its child tells why.
    """
    from ..captures.hide import hide_truth
    from .laws.check import laws_record

    made: dict[Callable[..., Any], xr.Dataset] = {}
    bound = []
    for label in labels:
        with contextlib.suppress(Exception):
            bound.append((label, *bind(label)))
    for label, call, chosen in sorted(bound, key=lambda one: -kernels_below(one[2].function)):
        with contextlib.suppress(Exception):
            laws = laws_record(chosen.stage)
            for make in laws.own.get(chosen.stage.word, laws.captures):
                if make not in made:
                    made[make] = hide_truth(make())
                if not chosen.unfit(made[make]):
                    call(made[make])
                    break
        with contextlib.suppress(OSError):
            _mark(label).parent.mkdir(exist_ok=True)
            _mark(label).touch()


def main(arguments: Sequence[str]) -> int:
    """Compile until all is done or the runner ends this process."""
    die_with(int(arguments[0]))
    with compiling():
        compile_all(arguments[1:])
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
