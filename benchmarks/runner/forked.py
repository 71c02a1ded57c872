"""Children of the runner that are forked from a process with everything imported (`prepared`).

    with Prepared(labels) as prepared:
        child = prepared.start(label, folder, variables, jobs, events)   # None where it cannot: then the runner starts one itself

Built-in estimators only: a plug-in imports what it likes in a process of its own, before anything else is there. Linux only.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from .variables import child_environment, start_beside

__all__ = ["Forked", "Prepared"]

_SET_SUBREAPER, _GET_SUBREAPER = 36, 37  # PR_SET_CHILD_SUBREAPER, PR_GET_CHILD_SUBREAPER
#: Longest wait for a child, s: the imports before the first one, on a busy machine.
_PATIENCE_S = 60.0
_REPLY_BYTES = 1 << 10
#: Variables that a process, or a library that it imports, reads once.
_AT_START = re.compile(r"PYTHON|NUMBA|LD_|OMP_|OPENBLAS_|MKL_|XDG_|LC_|LANG$|HOME$|BEAMBENCH_(?!CHILD$)")


class Forked:
    """What `subprocess.Popen` is for a started process: its number, its output, its end."""

    def __init__(self, pid: int, stdout: BinaryIO) -> None:
        self.pid, self.stdout = pid, stdout
        self.returncode: int | None = None

    def wait(self) -> int:
        """Wait for its end: the exit code, or the negative number of the signal that ended it."""
        if self.returncode is None:
            self.returncode = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self.returncode


@contextmanager
def _reaping() -> Iterator[None]:
    """Be the parent of orphans below this process, and afterwards what it was before."""
    libc = ctypes.CDLL(None, use_errno=True)
    before = ctypes.c_int(0)
    if libc.prctl(_GET_SUBREAPER, ctypes.byref(before), 0, 0, 0) or libc.prctl(_SET_SUBREAPER, 1, 0, 0, 0):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    try:
        yield
    finally:
        libc.prctl(_SET_SUBREAPER, before.value, 0, 0, 0)


class Prepared:
    """A process that forks children; it is started at once, and imports while the runner does other things.

    Main arguments:
        labels: the estimators whose modules it imports; plug-ins among them are left out.

    It ends with the thread that made it, and with `close`.
    """

    def __init__(self, labels: Sequence[str]) -> None:
        self._turn = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        if sys.platform != "linux":
            return
        from ...estimators.chain import is_built_in
        from ...estimators.labels import split_label

        own = list(dict.fromkeys(label for label in labels if is_built_in(split_label(label)[0])))
        if not own:
            return
        self._environment = child_environment()
        self._control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._control.settimeout(_PATIENCE_S)
        arguments = [str(os.getpid()), str(theirs.fileno()), *own]
        try:
            self._process = start_beside("runner.prepared", arguments, self._environment, pass_fds=(theirs.fileno(),))
        except OSError:  # the runner says why when it cannot start a child either
            self._control.close()
        finally:
            theirs.close()

    def __enter__(self) -> Prepared:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the process; children that it has forked go on."""
        with self._turn:
            if self._process is not None:
                self._control.close()
                with contextlib.suppress(OSError):
                    os.killpg(self._process.pid, signal.SIGKILL)
                self._process.wait()
                self._process = None

    def start(self, label: str, folder: Path, environment: Mapping[str, str], jobs: int, events: int) -> Forked | None:
        """A child with these handles, working folder and variables; None where it has to be started anew.

        That is where this process could not be prepared, or was prepared under other variables.
        """
        if self._process is None:
            return None
        own = {name: value for name, value in environment.items() if self._environment.get(name) != value}
        gone = set(self._environment) - set(environment)
        if any(_AT_START.match(name) for name in gone | set(own)):
            return None
        output, theirs = os.pipe()
        order = {"label": label, "folder": str(folder), "environment": own, "gone": sorted(gone)}
        try:
            with self._turn, _reaping():
                socket.send_fds(self._control, [json.dumps(order).encode()], [jobs, events, theirs])
                pid = int(json.loads(self._control.recv(_REPLY_BYTES))["pid"])
        except (OSError, ValueError, KeyError):
            os.close(output)
            self.close()
            return None
        finally:
            os.close(theirs)
        return Forked(pid, os.fdopen(output, "rb", buffering=0))
