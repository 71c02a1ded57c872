"""A child process and its pipes: start it with one thread, exchange messages, supervise it, end it with its descendants."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

from ...optics.jit import GIVEN_HASH, cache_folder, source_hash
from ...scenes.json_keys import read_json
from .jail import OFF, abi, readable
from .protocol import THREAD_VARIABLES

__all__ = ["Child", "child_environment", "jail_rules"]

#: Variable by which the descendants of a child are known.
_TOKEN = "BEAMBENCH_CHILD"

_SCAN_S = 0.5  # for descendants, as their list needs a pass over all processes
_TAIL = 2000  # bytes kept of a child's printed output


def child_environment() -> dict[str, str]:
    """The parent's environment and import path, with one thread for every library and reproducible hashes."""
    environment = dict(os.environ)
    environment.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    # The child starts in an empty folder, but can import everything that the parent can.
    environment["PYTHONPATH"] = os.pathsep.join(path or os.getcwd() for path in sys.path)
    environment["PYTHONHASHSEED"] = "0"
    environment[GIVEN_HASH] = source_hash()
    environment.pop("PYTHONSTARTUP", None)
    return environment


def jail_rules(label: str, folder: Path, inputs: Iterable[Path], hidden: Iterable[Path]) -> dict[str, Any]:
    """The first line that a child reads: {"read": [path], "write": [path]}, or {} without a jail.

    Main arguments:
        label: the files that its parameters name (weights) may be read. folder: working folder; the answers lie beside it.
        inputs: what it may read of the run. hidden: folders that it may not read wherever they are.
    """
    if os.environ.get(OFF) == "none" or not abi():
        return {}
    from ...estimators.labels import parse_label

    values = [value for value in parse_label(label)[1].values() if isinstance(value, str) and os.path.isabs(value)]
    return {
        "read": [*_readable(tuple(hidden), tuple(sys.path)), *map(str, inputs), *values],
        "write": [str(folder.parent), str(cache_folder())],
    }


@lru_cache(maxsize=4)
def _readable(hidden: tuple[Path, ...], import_path: tuple[str, ...]) -> list[str]:
    """`readable`, once per import path."""
    return readable(hidden)


class Child:
    """A started child and its pipes."""

    def __init__(self, label: str, folder: Path, *, inputs: Iterable[Path] = (), hidden: Iterable[Path] = ()) -> None:
        self.token = secrets.token_hex(16)
        rules = jail_rules(label, folder, inputs, hidden)
        jobs_read, jobs_write = os.pipe()
        events_read, events_write = os.pipe()
        command = [
            sys.executable,
            "-P",
            "-m",
            "beambench.benchmarks.runner.child",
            label,
            str(jobs_read),
            str(events_write),
        ]
        (folder / "tmp").mkdir(parents=True, exist_ok=True)
        try:
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                pass_fds=(jobs_read, events_write),
                start_new_session=True,
                cwd=folder,
                env=child_environment() | {"TMPDIR": str(folder / "tmp"), _TOKEN: self.token},
            )
        except BaseException:
            os.close(jobs_write)
            os.close(events_read)
            raise
        finally:
            os.close(jobs_read)
            os.close(events_write)
        assert self.process.stdout is not None
        self.jobs, self.events, self.output = jobs_write, events_read, self.process.stdout.fileno()
        self.started = self.warm = False
        self.stage = ""
        self.buffer = b""
        self.printed, self.tail = 0, b""
        self._descendants: list[Any] = []
        self._scanned = 0.0
        for fd in (self.events, self.output):
            os.set_blocking(fd, False)
        self.send(rules)

    def send(self, message: dict[str, Any]) -> None:
        """Send one line of JSON."""
        with contextlib.suppress(BrokenPipeError):  # the end of the events shows that the child has ended
            os.write(self.jobs, (json.dumps(message) + "\n").encode())

    def read_output(self) -> bool:
        """Read the printed output of the estimator, and keep its end. False at the end of the stream."""
        data = _read(self.output)
        if data is None:
            return True
        self.printed += len(data)
        self.tail = (self.tail + data)[-_TAIL:]
        return bool(data)

    def read_events(self) -> tuple[list[dict[str, Any]], bool]:
        """Complete lines of events, and whether the pipe is still open. A line that is not an event ends the child."""
        data = _read(self.events)
        if data is None:
            return [], True
        self.buffer += data
        *lines, self.buffer = self.buffer.split(b"\n")
        events = [read_json(line) for line in lines]
        if len(self.buffer) > 1 << 16 or any(not isinstance(event, dict) for event in events):
            raise ValueError("the child sent no events")
        return events, bool(data)

    def resident_bytes(self) -> int:
        """Resident memory of the child and of its known descendants, bytes."""
        import psutil

        total = 0
        try:
            process = psutil.Process(self.process.pid)
            if time.monotonic() - self._scanned > _SCAN_S:
                self._descendants, self._scanned = process.children(recursive=True), time.monotonic()
            for member in (process, *self._descendants):
                with contextlib.suppress(psutil.NoSuchProcess):
                    total += member.memory_info().rss
        except psutil.Error:
            return total
        return total

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
                if process.environ().get(_TOKEN) == self.token:
                    process.kill()

    def end(self, *, kill: bool) -> int:
        """Close the pipes, wait for the child or kill it with its descendants, and return its exit code."""
        import psutil

        if self.process.returncode is not None:
            return self.process.returncode

        with contextlib.suppress(OSError):
            os.close(self.jobs)
        try:
            descendants = psutil.Process(self.process.pid).children(recursive=True)
        except psutil.Error:
            descendants = []
        if not kill:
            self.ended(2.0)
        self.kill()
        for member in (*self._descendants, *descendants):  # descendants that left the group
            with contextlib.suppress(psutil.Error):
                member.kill()
        code = self.process.wait()
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
