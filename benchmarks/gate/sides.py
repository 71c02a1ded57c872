"""Versions of the code in processes of their own, timed call by call in random order.

Three processes run side by side: two of the reference, A and A', and one of the present version, B. In each round the three
carry out the same number of calls, each timed by itself, in a random order, so that a change of the processor's clock or of
the load by others falls on all three alike. A process keeps, for its life, a speed of its own (where its memory lies), by
which two processes of one version differ by more than their rounds tell; therefore the three are started afresh several times,
and a start is one observation.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import selectors
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ..runner.variables import child_environment

__all__ = ["Failed", "Paired", "Plan", "Side", "Timer", "any_core", "interleaved", "open_all", "typical"]

Float = npt.NDArray[np.float64]

_WORKER = Path(__file__).with_name("worker.py")


class Failed(Exception):
    """A side could not carry out a call: the reason."""


class Timer(Protocol):
    """What can open targets and time calls of them."""

    def open(self, number: int, target: Mapping[str, Any]) -> dict[str, Any]:
        """Prepare a target and call it: CPU time of one call in a list, and the files of its code."""

    def time(self, number: int, count: int) -> Sequence[float]:
        """CPU times of `count` calls of a target, s."""

    def close(self) -> None:
        """End."""


@dataclass(frozen=True)
class Plan:
    """How long is measured: fresh starts of the processes, rounds in each, CPU time of one turn of one side, s."""

    starts: int = 8
    rounds: int = 9
    turn_s: float = 0.03


@dataclass(frozen=True)
class Paired:
    """Logarithms of CPU times of one target, one value per start (medians over rounds).

    change: ln B − (ln A + ln A')/2. same: ln A' − ln A. cpu_s: CPU time of one call of A, s.
    """

    change: Float
    same: Float
    cpu_s: float


class Side:
    """A worker process of one version.

    Main arguments:
        path: what its import path begins with; empty for the version that runs this. core: the only core that it runs on.
    Other arguments:
        limit_s: wall time of one command, s.
    """

    def __init__(self, path: Sequence[str] = (), *, core: int | None = None, limit_s: float = 600.0) -> None:
        environment = child_environment()
        environment["PYTHONPATH"] = os.pathsep.join([*path, environment["PYTHONPATH"]])
        if path:
            # The hash of the sources, which names the folder of compiled code, is that of the other version.
            from ...optics.jit import GIVEN_HASH

            environment.pop(GIVEN_HASH, None)
        self._limit = limit_s
        command = [sys.executable, "-P", str(_WORKER), *([] if core is None else [str(core)])]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment
        )

    def open(self, number: int, target: Mapping[str, Any]) -> dict[str, Any]:
        """As `Timer.open`. Raises Failed."""
        return self._ask({"do": "open", "id": number, **target})

    def time(self, number: int, count: int) -> Sequence[float]:
        """As `Timer.time`. Raises Failed."""
        return [float(x) for x in self._ask({"do": "call", "id": number, "count": count})["cpu_s"]]

    def close(self) -> None:
        """End the process."""
        with contextlib.suppress(OSError):
            self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()

    def _ask(self, command: Mapping[str, Any]) -> dict[str, Any]:
        source, sink = self._process.stdout, self._process.stdin
        assert source is not None and sink is not None
        try:
            sink.write((json.dumps(command) + "\n").encode())
            sink.flush()
            line = self._line(source.fileno())
        except (OSError, ValueError) as error:  # a closed pipe is a ValueError
            raise Failed(f"its process ended: {error}") from error
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise Failed(str(answer["error"]))
        return answer

    def _line(self, source: int) -> bytes:
        deadline, line = time.monotonic() + self._limit, b""
        with selectors.DefaultSelector() as selector:
            selector.register(source, selectors.EVENT_READ)
            while not line.endswith(b"\n"):
                if not selector.select(max(deadline - time.monotonic(), 0.0)):
                    raise Failed(f"no answer within {self._limit:g} s")
                part = os.read(source, 65536)
                if not part:
                    raise Failed("its process ended")
                line += part
        return line


def any_core(rng: np.random.Generator) -> int | None:
    """One of the cores of this process, on which all sides of a start run: two cores may have different neighbours."""
    if not hasattr(os, "sched_getaffinity"):
        return None
    cores = sorted(os.sched_getaffinity(0))
    return int(cores[rng.integers(len(cores))])


def open_all(
    start: Callable[[], Sequence[Timer]], targets: Mapping[int, Mapping[str, Any]]
) -> dict[int, list[dict[str, Any]] | str]:
    """Start the sides once and open every target: the answers of the sides, or the reason why a target cannot be timed."""
    found: dict[int, list[dict[str, Any]] | str] = {}
    sides = start()
    try:
        for number, target in targets.items():
            try:
                found[number] = [side.open(number, target) for side in sides]
            except Failed as error:
                found[number] = str(error)
    finally:
        for side in sides:
            side.close()
    return found


def interleaved(
    start: Callable[[], Sequence[Timer]],
    targets: Mapping[int, Mapping[str, Any]],
    plan: Plan,
    rng: np.random.Generator,
    *,
    tell: Callable[[int], None] = lambda done: None,
) -> dict[int, Paired]:
    """Time the targets on three sides (A, A', B) in random order.

    Main arguments:
        start: starts the three sides afresh. targets: {number: what a worker opens}. plan: how long.
    Other arguments:
        rng: of the order. tell: called with the number of finished starts.

    Raises:
        Failed: a side could not carry out a call.
    """
    logs = {number: np.zeros((plan.starts, plan.rounds, 3)) for number in targets}
    counts: dict[int, int] = {}
    for run in range(plan.starts):
        sides = start()
        try:
            for number, target in targets.items():
                seconds = [max(float(side.open(number, target)["cpu_s"][0]), 1e-6) for side in sides]
                counts.setdefault(number, max(1, math.ceil(plan.turn_s / min(seconds))))
                for turn in range(plan.rounds):
                    for which in rng.permutation(3):
                        logs[number][run, turn, which] = typical(sides[which].time(number, counts[number]))
        finally:
            for side in sides:
                side.close()
        tell(run + 1)
    return {number: _paired(log) for number, log in logs.items()}


def typical(times: Sequence[float]) -> float:
    """Logarithm of the lower quartile of the CPU times of one turn: calls that were interrupted, after which the caches are cold,
    are above it as long as they are not most."""
    return math.log(max(float(np.quantile(times, 0.25)), 1e-9))


def _paired(log: Float) -> Paired:
    a, twin, b = log[..., 0], log[..., 1], log[..., 2]
    return Paired(
        np.median(b - 0.5 * (a + twin), axis=1),
        np.median(twin - a, axis=1),
        float(np.exp(np.median(0.5 * (a + twin)))),
    )
