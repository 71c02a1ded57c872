"""A process that has imported what built-in estimators need, and forks a child of the runner for each that is asked for.

    python -P -m beambench.benchmarks.runner.prepared RUNNER_PID CONTROL_FD LABEL...

To import numpy, numba, pandas and xarray takes over a second of processor time, a fork some milliseconds. This process runs no code
of plug-ins and reads no capture, so a child finds in its memory nothing but modules. Each order is one message,
{"label", "folder", "environment", "gone"}, with three handles: of the child's orders, events and output.

The runner becomes the parent of the child: it is forked twice, and as the process between ends, the kernel gives it to the runner,
which is a reaper of orphans meanwhile (PR_SET_CHILD_SUBREAPER, prctl(2)). So the runner waits for it, reads its clocks and
kills it as if it had started it itself. The runner's side is `forked`.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import socket
import sys
import tempfile
import time
from collections.abc import Sequence
from typing import Any

__all__ = ["main", "prepare"]

#: Longest time until the runner is the parent of a child, s: the end of one process.
_ADOPTION_S = 5.0
_HANDLES, _MESSAGE_BYTES = 3, 1 << 16


def prepare(labels: Sequence[str]) -> None:
    """Import what the children of these estimators import, and nothing that is kept from them (`jail.readable`)."""
    # Arrow, which pandas imports where it is installed, starts a thread; no estimator of this package reads its files.
    sys.modules["pyarrow"] = None  # type: ignore[assignment]
    import psutil  # noqa: F401
    import xarray  # noqa: F401

    from ...optics.jit import load_compiler
    from . import estimator_labels, house, jail, protocol, sealed  # noqa: F401
    from .child import bind

    for label in labels:
        with contextlib.suppress(Exception):  # the child finds the same error, and tells it
            bind(label)
    load_compiler()
    # What is here is never searched for garbage: that would write into every page, which a child then has to copy.
    gc.collect()
    gc.freeze()


def _threads() -> int:
    return len(os.listdir("/proc/self/task"))


def _adopted(runner: int) -> bool:
    """Wait until this process is a child of the runner."""
    until = time.monotonic() + _ADOPTION_S
    while os.getppid() != runner:
        if time.monotonic() > until:
            return False
        time.sleep(0.0002)
    return True


def _become(order: dict[str, Any], handles: Sequence[int], control: socket.socket, runner: int) -> tuple[int, int]:
    """Make this fork what a started child is: its session, folder, variables, files. Returns the handles of orders and events."""
    jobs, events, output = handles
    os.setsid()
    os.chdir(order["folder"])
    os.environ.update(order["environment"])
    for name in order["gone"]:
        os.environ.pop(name, None)
    tempfile.tempdir = None  # it was chosen for the process before
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    for fd in (1, 2):
        os.dup2(output, fd)
    if not _adopted(runner):
        os._exit(1)
    control.send(json.dumps({"pid": os.getpid()}).encode())
    kept = {0, 1, 2, jobs, events}
    for fd in sorted(int(name) for name in os.listdir("/proc/self/fd")):
        if fd not in kept:
            with contextlib.suppress(OSError):
                os.close(fd)
    return jobs, events


def _fork(order: dict[str, Any], handles: Sequence[int], control: socket.socket, runner: int) -> None:
    """Fork a child and hand it to the runner; returns in this process only."""
    if between := os.fork():
        os.waitpid(between, 0)
        return
    try:
        if os.fork() == 0:
            jobs, events = _become(order, handles, control, runner)
            from .child import main as serve

            os._exit(serve([order["label"], str(jobs), str(events), str(runner)]))
    finally:
        os._exit(1)  # the process between, and a child that could not begin: the runner starts one of its own


def main(arguments: list[str]) -> int:
    """Import, and fork until the runner closes the socket."""
    from .child import die_with

    runner, control = int(arguments[0]), socket.socket(fileno=int(arguments[1]))
    die_with(runner)
    os.set_inheritable(control.fileno(), False)
    prepare(arguments[2:])
    if _threads() > 1:  # a fork of a process with threads may find their locks taken for ever
        return 1
    while True:
        data, handles, _, _ = socket.recv_fds(control, _MESSAGE_BYTES, _HANDLES)
        if not data:
            return 0
        _fork(json.loads(data), handles, control, runner)
        for fd in handles:
            os.close(fd)


if __name__ == "__main__":
    os._exit(main(sys.argv[1:]))
