"""What a process needs before any library is loaded: standard streams that last, a folder to be in, an orderly end."""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
from typing import Any

from .plain_signs import PLAIN_SIGNS
from .scenes.errors import InputError

__all__ = ["Ended", "check_working_folder", "end_in_order", "keep_standard_streams", "open_standard_streams"]


class _Stream(io.FileIO):
    """A file whose reader may leave: what is written after that goes nowhere, and the work goes on."""

    quiet = False
    """No failure is told: there is nobody to tell that standard error itself cannot be written."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data) or 0
        except OSError as error:
            if not self.quiet and not isinstance(error, BrokenPipeError):
                raise
            return memoryview(data).nbytes


def keep_standard_streams() -> None:
    """Go on where the reader of the output leaves (`beambench run … 2>&1 | head -1`): the results are in files."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is not getattr(sys, f"__{name}__") or not isinstance(stream, io.TextIOWrapper):
            continue  # replaced by a test or a notebook
        stream.flush()
        raw = _Stream(stream.fileno(), "w", closefd=False)
        raw.quiet = name == "stderr"
        setattr(sys, name, io.TextIOWrapper(
            io.BufferedWriter(raw), encoding=stream.encoding, errors=PLAIN_SIGNS,
            line_buffering=stream.line_buffering or name == "stderr",
        ))  # fmt: skip


class Ended(KeyboardInterrupt):
    """The process is to end, by a signal.

    A class of its own: where a plain KeyboardInterrupt leaves the `exec` of a text (a dataclass or named tuple of a module that
    is being imported), CPython remembers it as unhandled and ends the process by SIGINT, although it was handled later
    (`run_eval_code_obj` in Python/pythonrun.c compares with exactly that class).
    """


def end_in_order() -> None:
    """Let SIGINT, SIGTERM and SIGHUP end the process by `Ended`: temporary files are removed, results kept, exit code 130.

    A signal that is ignored, or that the caller handles, stays as it is.
    """
    if threading.current_thread() is not threading.main_thread():
        return

    def interrupt(number: int, frame: object) -> None:
        raise Ended

    for sign in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(sign) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(sign, interrupt)


def open_standard_streams() -> None:
    """Open the null device in place of each standard stream that is closed, as daemons and some schedulers leave them.

    Else the next file that is opened takes the number of the stream, and libraries that use the stream fail.
    """
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        try:
            os.fstat(number)
            continue
        except OSError:
            pass
        opened = os.open(os.devnull, os.O_RDWR)
        if opened != number:
            os.dup2(opened, number)
            os.close(opened)
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, mode, encoding="utf-8", closefd=False))


def check_working_folder() -> None:
    """Raise InputError where the working folder has been deleted: no relative path means anything then."""
    try:
        os.getcwd()
    except OSError as error:
        raise InputError(
            "The working folder no longer exists.", where="working folder", value=os.environ.get("PWD", "(unknown)"),
            next_step="change to a folder that exists: cd ~",
        ) from error  # fmt: skip
