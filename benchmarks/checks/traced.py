"""A command in a process of its own, stopped or failed at a chosen system call by strace.

The process is forked from this one, in which all modules are loaded, so that an attempt takes a fraction of a second. It
waits until strace is attached, then runs the command as `python -m beambench` does.
"""

from __future__ import annotations

import os
import re
import runpy
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

__all__ = ["CALLS", "NAMES", "Ended", "available", "preload", "run_forked", "run_traced"]

#: System calls by which files are made, changed and removed.
CALLS = (
    "write", "pwrite64", "fsync", "ftruncate", "rename", "renameat", "renameat2", "unlink", "unlinkat", "rmdir", "mkdir", "mkdirat",
)  # fmt: skip
#: Those of them that the children of a run do not make.
NAMES = ("fsync", "rename", "unlink", "rmdir")
_MOST_S = 240.0


@dataclass(frozen=True)
class Ended:
    """How a command ended: exit code (negative: by a signal; None: it hung), what it printed, calls by name, faults injected, and
    the most resident memory of it and of the processes that it waited for, in bytes."""

    code: int | None
    text: str
    each: dict[str, int]
    injected: int
    peak_bytes: int = 0


def available() -> str:
    """Why strace cannot be used here, or ""."""
    if shutil.which("strace") is None:
        return "strace is not installed"
    done = subprocess.run(["strace", "-qq", "-o", os.devnull, "true"], capture_output=True, text=True, check=False)
    return "" if done.returncode == 0 else f"strace does not work here: {done.stderr.strip()[:200]}"


def preload() -> None:
    """Load what the commands need, without a thread of ours; the pools of OpenBLAS and Arrow outlive a fork."""
    import pandas
    import scipy.stats
    import xarray
    import zarr

    from ...captures import finalize, repair, verify
    from ...captures.store.writer import CaptureWriter
    from ...generator import generate
    from ...optics import jit
    from .. import run
    from ..search import sweep

    assert all((pandas, scipy.stats, xarray, zarr, finalize, repair, verify, CaptureWriter, generate, jit, run, sweep))
    _command(["--version"], sys.stderr.fileno())


def _command(words: Sequence[str], output: int) -> int:
    """Run `python -m beambench WORDS` in this process, which is forked for it; its exit code."""
    pid = os.fork()
    if pid == 0:
        _run(words, output)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def _run(words: Sequence[str], output: int) -> None:
    """The command, in a forked process, which ends with it."""
    code = 70
    try:
        os.setsid()
        os.dup2(output, 1)
        os.dup2(output, 2)
        sys.argv = ["beambench", *words]
        runpy.run_module("beambench", run_name="__main__", alter_sys=True)
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        # Whatever fails here, nothing of the parent's stack may run in this process.
        with suppress(BaseException):
            sys.stdout.flush()
        with suppress(BaseException):
            sys.stderr.flush()
        os._exit(code)


def run_forked(words: Sequence[str], folder: Path, *, environment: Mapping[str, str] | None = None) -> Ended:
    """Run a command in a forked process, without strace; `environment`: variables of it and of what it starts."""
    said = folder / "said.log"
    with open(said, "w+b") as output:
        pid = os.fork()
        if pid == 0:
            os.environ.update(environment or {})
            tempfile.tempdir = None  # TMPDIR is read anew
            _run(words, output.fileno())
        code, peak_bytes = _wait(pid)
        if code is None:
            os.killpg(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
        output.seek(0)
        text = output.read().decode(errors="replace")
    said.unlink()
    return Ended(code, text, {}, 0, peak_bytes)


def run_traced(
    words: Sequence[str], folder: Path, *, inject: str = "", calls: Sequence[str] = CALLS, first_thread: bool = False
) -> Ended:
    """Run a command under strace.

    Main arguments:
        words: of the command. folder: for the files of this function.
    Other arguments:
        inject: what happens at which call of a thread, such as "error=ENOSPC:when=7" or "signal=KILL:when=7" (strace, option
            -e inject). calls: that are traced. first_thread: trace the first thread alone, for commands that start many and other
            programs; else all are.
    """
    log, said = folder / "strace.log", folder / "said.log"
    options = [*([] if first_thread else ["-f"]), "-o", str(log), "-e", f"trace={','.join(calls)}"]
    options += ["-e", f"inject={','.join(calls)}:{inject}"] if inject else []
    with open(said, "w+b") as output:
        code, peak_bytes = _attach(words, options, output.fileno())
        output.seek(0)
        text = output.read().decode(errors="replace")
    lines = log.read_text(errors="replace").splitlines() if log.exists() else []
    injected = sum("(INJECTED)" in line for line in lines) + (code == -signal.SIGKILL)
    log.unlink(missing_ok=True)
    said.unlink(missing_ok=True)
    threads = Counter(found.groups() for line in lines if (found := re.match(r"(?:(\d+) +)?(\w+)\(", line)))
    each: dict[str, int] = {}
    for (_, name), count in threads.items():
        each[name] = max(each.get(name, 0), count)
    return Ended(code, text, each, injected, peak_bytes)


def _attach(words: Sequence[str], options: list[str], output: int) -> tuple[int | None, int]:
    """Run a command in a forked process to which strace is attached; its exit code, None where it does not end in time, and its
    memory."""
    begin_read, begin_write = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(begin_write)
        os.read(begin_read, 1)
        _run(words, output)
    os.close(begin_read)
    with subprocess.Popen(["strace", *options, "-p", str(pid)], stderr=subprocess.PIPE) as tracer:
        assert tracer.stderr is not None
        select.select([tracer.stderr], [], [], 30)
        tracer.stderr.readline()  # "strace: Process N attached"
        os.write(begin_write, b"x")
        os.close(begin_write)
        code, peak_bytes = _wait(pid)
        if code is None:
            os.killpg(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
        tracer.stderr.close()
        try:
            tracer.wait(timeout=10)
        except subprocess.TimeoutExpired:
            tracer.kill()
    return code, peak_bytes


def _wait(pid: int) -> tuple[int | None, int]:
    """The exit code of a process, None where it does not end in time, and its peak of resident memory in bytes."""
    deadline = time.monotonic() + _MOST_S
    while time.monotonic() < deadline:
        done, status, usage = os.wait4(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status), usage.ru_maxrss * 1024
        time.sleep(0.005)
    return None, 0
