"""A child process and its pipes: start it with one thread, exchange messages, supervise it, end it with its descendants."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

from ...optics.jit import cache_folder
from ...scenes.json_keys import read_json
from . import tree
from .forked import Forked, Prepared
from .jail import OFF, abi, readable
from .namespaces import works
from .removal import remove
from .variables import TOKEN, child_environment

__all__ = ["Child", "jail_rules"]

_TAIL = 2000  # bytes kept of a child's printed output


def jail_rules(label: str, folder: Path, hidden: Iterable[Path]) -> dict[str, Any]:
    """The first line that a child reads: {"own": whether it gets namespaces, "read": [path], "write": [path]}.

    Main arguments:
        label: the files that its parameters name (weights) may be read. folder: working folder; the answers lie beside it.
        hidden: folders that it may not read wherever they are.

    Captures are in no folder that it may read: it gets their handles. Without a jail, and where the kernel has no Landlock, there
    are no paths.
    """
    if os.environ.get(OFF) == "none":
        return {"own": False}
    own = works()
    if not abi():
        return {"own": own}
    from ...estimators.labels import parse_label

    values = [value for value in parse_label(label)[1].values() if isinstance(value, str) and os.path.isabs(value)]
    # Its own /proc shows its own processes only, and its own /dev/shm is not that of the machine.
    return {
        "own": own,
        "read": [*_readable(tuple(hidden), tuple(sys.path)), *(["/proc"] if own else []), *values],
        "write": [str(folder.parent), str(own_cache(label) or cache_folder()), *(["/dev/shm"] if own else [])],
    }


def own_cache(label: str) -> Path | None:
    """The folder of compiled code that a plug-in may write; None for built-ins, which share the one of the house.

    What a plug-in plants there, no other estimator loads. It starts as a copy of the shared folder, so that built-in kernels are
    not compiled again. Raises OSError where it cannot be written.
    """
    from ...estimators import BUILTIN
    from ...estimators.labels import links_of, parse_label

    foreign = [link for link in links_of(parse_label(label)[0]) if link not in BUILTIN]
    if not foreign:
        return None
    shared = cache_folder()
    own = shared.parent / "beambench-plug-ins" / hashlib.sha256("+".join(foreign).encode()).hexdigest()[:16]
    place = own / "beambench" / "numba" / shared.name
    if not place.is_dir():
        place.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(dir=place.parent))
        for path in sorted(shared.rglob("*")):
            with contextlib.suppress(OSError):  # what another process removes meanwhile is compiled anew
                target = partial / path.relative_to(shared)
                target.mkdir(exist_ok=True) if path.is_dir() else shutil.copyfile(path, target)
        with contextlib.suppress(OSError):  # another run was faster
            partial.rename(place)
    return own


@lru_cache(maxsize=4)
def _readable(hidden: tuple[Path, ...], import_path: tuple[str, ...]) -> list[str]:
    """`readable`, once per import path."""
    return readable(hidden)


class Child:
    """A started child and its pipes."""

    def __init__(
        self, label: str, folder: Path, *, hidden: Iterable[Path] = (), prepared: Prepared | None = None
    ) -> None:
        self.token, self.folder = secrets.token_hex(16), folder
        rules = jail_rules(label, folder, hidden)
        self.jobs, theirs = socket.socketpair()
        events_read, events_write = os.pipe()
        command = [
            sys.executable,
            "-P",
            "-m",
            "beambench.benchmarks.runner.child",
            label,
            str(theirs.fileno()),
            str(events_write),
            str(os.getpid()),
        ]
        (folder / "tmp").mkdir(parents=True, exist_ok=True)
        environment = child_environment() | {"TMPDIR": str(folder / "tmp"), TOKEN: self.token}
        cache = own_cache(label)
        #: Whether it runs code that is not of this package.
        self.plugin = cache is not None
        if cache:
            environment["XDG_CACHE_HOME"] = str(cache)
        forked = None
        try:
            if prepared is not None and not self.plugin:
                forked = prepared.start(label, folder, environment, theirs.fileno(), events_write)
            self.process: subprocess.Popen[bytes] | Forked = forked or subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                pass_fds=(theirs.fileno(), events_write),
                start_new_session=True,
                cwd=folder,
                env=environment,
            )
        except BaseException:
            self.jobs.close()
            os.close(events_read)
            raise
        finally:
            theirs.close()
            os.close(events_write)
        assert self.process.stdout is not None
        self.events, self.output = events_read, self.process.stdout.fileno()
        self.warm = False
        self.waiting: list[dict[str, Any]] = []  # events that were read and not yet expected
        self.stage = ""
        self.buffer = b""
        self.printed, self.tail = 0, b""
        #: Processes that only wait for the worker: this one, and its `init` in namespaces of its own.
        self._above = 2 if rules["own"] else 1
        for fd in (self.events, self.output):
            os.set_blocking(fd, False)
        self.send(rules)

    def send(self, message: dict[str, Any], handle: int | None = None) -> None:
        """Send one line of JSON, and with it the handle of a file."""
        line = (json.dumps(message | ({} if handle is None else {"handle": True})) + "\n").encode()
        with contextlib.suppress(OSError):  # the end of the events shows that the child has ended
            sent = socket.send_fds(self.jobs, [line], [] if handle is None else [handle])
            self.jobs.sendall(line[sent:])

    def read_output(self) -> bool:
        """Read the printed output of the estimator, and keep its end. False at the end of the stream."""
        data = _read(self.output)
        if data is None:
            return True
        self.printed += len(data)
        self.tail = (self.tail + data)[-_TAIL:]
        return bool(data)

    def read_events(self) -> bool:
        """Read complete lines of events into `waiting`; False if the pipe is closed.

        Raises ValueError for a line that is not an event; it ends the child.
        """
        data = _read(self.events)
        if data is None:
            return True
        self.buffer += data
        *lines, self.buffer = self.buffer.split(b"\n")
        events = [read_json(line) for line in lines]
        if len(self.buffer) > 1 << 16 or any(not isinstance(event, dict) for event in events):
            raise ValueError("the child sent no events")
        self.waiting += events
        return bool(data)

    def resident_bytes(self) -> int:
        """Resident memory of the worker and of all that it started, bytes."""
        return tree.resident_bytes(tree.descendants(self.process.pid)[self._above - 1 :])

    def worker(self) -> int:
        """The process that runs the estimator."""
        below = tree.descendants(self.process.pid)
        return below[self._above - 1] if len(below) >= self._above else self.process.pid

    def cpu_s(self) -> float:
        """CPU time of the worker and of all that it started, s."""
        return tree.cpu_s(self.process.pid)

    def ended(self, timeout_s: float) -> bool:
        """Wait for the end of the child without reaping it, so that its process group keeps its id until it is killed."""
        until = time.monotonic() + timeout_s
        while os.waitid(os.P_PID, self.process.pid, os.WEXITED | os.WNOWAIT | os.WNOHANG) is None:
            if time.monotonic() > until:
                return False
            time.sleep(0.005)
        return True

    def kill(self) -> None:
        """Kill the child's process group."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)

    def _kill_strays(self) -> None:
        """Kill the processes that a child started and that left its group and its tree: they carry its token."""
        import psutil

        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error, OSError):
                if process.environ().get(TOKEN) == self.token:
                    process.kill()

    def clear(self) -> None:
        """Remove what an ended child left in its folder, and the answers beside it."""
        remove(self.folder.parent)

    def end(self, *, kill: bool) -> int:
        """Close the pipes, wait for the child or kill it with its descendants, and return its exit code."""
        if self.process.returncode is not None:
            return self.process.returncode

        self.jobs.close()
        if not kill:
            self.ended(2.0)
        below = tree.descendants(self.process.pid)
        self.kill()
        for pid in below:  # those that left the group, where there is no namespace
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        code = self.process.wait()
        if self._above == 1:  # a namespace ends with all that is in it
            self._kill_strays()
        os.close(self.events)
        assert self.process.stdout is not None
        self.process.stdout.close()
        return code


def _read(fd: int) -> bytes | None:
    """Up to 64 KiB; b"" at the end of the stream, None if no data are waiting."""
    try:
        return os.read(fd, 1 << 16)
    except BlockingIOError:
        return None
