"""Hostile plug-ins that tamper with what their process shares with the runner: pipes, limits, folders, modules. See `plugins`."""

from __future__ import annotations

import atexit
import builtins
import contextlib
import ctypes
import gc
import json
import os
import resource
import shutil
import signal
import sys
import warnings
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import xarray as xr

from .gated_cheats import answer, planted

__all__: list[str] = []


def _events() -> int:
    return int(sys.argv[3])


# ---------------------------------------------------------------- pipes


@planted
def closes_all(capture: xr.Dataset) -> Any:
    """Close every file but the standard ones."""
    os.closerange(3, 4096)
    return answer(capture)


@planted
def closes_standard_files(capture: xr.Dataset) -> Any:
    """Close standard input, output and error."""
    os.closerange(0, 3)
    return answer(capture)


@planted
def prints_much(capture: xr.Dataset) -> Any:
    """Print 16 MB."""
    for _ in range(4096):
        os.write(1, b"x" * 4096)
    return answer(capture)


@planted
def prints_odd(capture: xr.Dataset) -> Any:
    """Print control sequences and bytes that are no text, on both outputs."""
    for number in (1, 2):
        os.write(number, b"\x1b[2J\x1b]0;mine\x07\xff\xfe\x00" * 100)
    return answer(capture)


@planted
def writes_no_events(capture: xr.Dataset) -> Any:
    """Write bytes that are no event on the pipe of events."""
    os.write(_events(), b"\xff\x00 no event\n")
    return answer(capture)


@planted
def event_without_end(capture: xr.Dataset) -> Any:
    """Write 16 MB without a line feed on the pipe of events."""
    for _ in range(4096):
        os.write(_events(), b"1" * 4096)
    return answer(capture)


@planted
def event_of_brackets(capture: xr.Dataset) -> Any:
    """Write an event of 60,000 brackets."""
    os.write(_events(), b"[" * 60_000 + b"\n")
    return answer(capture)


@planted
def event_of_digits(capture: xr.Dataset) -> Any:
    """Write an event with a number of 5,000 digits."""
    os.write(_events(), b'{"event": "called", "at": ' + b"9" * 5000 + b"}\n")
    return answer(capture)


@planted
def event_of_the_house(capture: xr.Dataset) -> Any:
    """Say on the pipe of events that the machine failed."""
    os.write(_events(), b'{"event": "house", "message": "\\u001b[2J the disk is full"}\n')
    return answer(capture)


@planted
def events_of_odd_types(capture: xr.Dataset) -> Any:
    """Write events whose values are of other types."""
    os.write(_events(), b'{"event": ["called"], "message": {"a": null}}\n{"event": null}\n')
    return answer(capture)


@planted
def pipe_is_output(capture: xr.Dataset) -> Any:
    """Turn its standard output into the pipe of events, and print."""
    os.dup2(_events(), 1)
    print("not an event", flush=True)
    return answer(capture)


# ---------------------------------------------------------------- limits, folders, environment


@planted
def no_files_allowed(capture: xr.Dataset) -> Any:
    """Set its limit of open files to none."""
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, 0))
    return answer(capture)


@planted
def no_bytes_allowed(capture: xr.Dataset) -> Any:
    """Set the size of files that it may write to none, and ignore the signal."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    return answer(capture)


@planted
def no_memory_allowed(capture: xr.Dataset) -> Any:
    """Set its limit of memory to what it has."""
    resource.setrlimit(resource.RLIMIT_AS, (1, 1))
    return answer(capture)


@planted
def no_time_allowed(capture: xr.Dataset) -> Any:
    """Set its limit of CPU time to a second, and use it."""
    resource.setrlimit(resource.RLIMIT_CPU, (1, 1))
    while True:
        pass


@planted
def no_rights(capture: xr.Dataset) -> Any:
    """Let what it makes have no rights (umask)."""
    os.umask(0o777)
    return answer(capture)


@planted
def other_user(capture: xr.Dataset) -> Any:
    """Become another user, who may write nothing here."""
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)
    return answer(capture)


@planted
def removes_its_folder(capture: xr.Dataset) -> Any:
    """Remove the folder in which it was started, and all beside it that it may."""
    shutil.rmtree(Path.cwd().parent, ignore_errors=True)
    return answer(capture)


@planted
def file_in_place_of_its_answer(capture: xr.Dataset) -> Any:
    """Put files where the folders of its answers would be."""
    for number in range(8):
        for condition in ("matched", "calibrated"):
            Path.cwd().parent.joinpath(f"answer-{number}-{condition}").write_text("mine")
    return answer(capture)


@planted
def links_in_place_of_its_answer(capture: xr.Dataset) -> Any:
    """Put links to a folder of others where the folders of its answers would be."""
    for number in range(8):
        with contextlib.suppress(OSError):
            os.symlink("/etc", Path.cwd().parent / f"answer-{number}-matched")
    return answer(capture)


@planted
def locks_its_folder(capture: xr.Dataset) -> Any:
    """Take all rights from its folder."""
    os.chmod(Path.cwd().parent, 0)
    return answer(capture)


@planted
def no_environment(capture: xr.Dataset) -> Any:
    """Empty its environment and its path of imports."""
    os.environ.clear()
    ctypes.CDLL(None).clearenv()
    sys.path.clear()
    return answer(capture)


# ---------------------------------------------------------------- modules


@planted
def breaks_numpy(capture: xr.Dataset) -> Any:
    """Replace functions of NumPy by ones that raise as a bad disk does."""

    def broken(*given: Any, **named: Any) -> NoReturn:
        raise OSError(5, "Input/output error")

    found = answer(capture)
    for name in ("save", "ascontiguousarray", "asarray", "array", "load"):
        setattr(np, name, broken)
    return found


@planted
def writes_pickles(capture: xr.Dataset) -> Any:
    """Write its answer as a pickle that would run a command."""
    held = np.save

    class Runs:
        def __reduce__(self) -> Any:
            return os._exit, (70,)

    def pickled(file: Any, array: Any, **named: Any) -> None:
        held(file, np.array([Runs()], object))

    np.save = pickled  # type: ignore[assignment]
    return answer(capture)


@planted
def writes_half(capture: xr.Dataset) -> Any:
    """Cut the files of its answer in half."""
    held = np.save

    def halved(file: Any, array: Any, **named: Any) -> None:
        held(file, array, **named)
        os.truncate(file, os.path.getsize(file) // 2)

    np.save = halved  # type: ignore[assignment]
    return answer(capture)


@planted
def empties_modules(capture: xr.Dataset) -> Any:
    """Remove all modules, and put None for some."""
    found = answer(capture)
    for name in [name for name in sys.modules if not name.startswith("_")]:
        del sys.modules[name]
    sys.modules["numpy"] = sys.modules["json"] = None  # type: ignore[assignment]
    return found


@planted
def breaks_json(capture: xr.Dataset) -> Any:
    """Replace json.dumps by one that returns no text."""
    found = answer(capture)
    json.dumps = lambda *given, **named: "{" * 100  # type: ignore[assignment]
    return found


@planted
def breaks_builtins(capture: xr.Dataset) -> Any:
    """Replace open, isinstance and len."""
    found = answer(capture)
    builtins.open = builtins.isinstance = builtins.len = lambda *given, **named: 0  # type: ignore[assignment]
    return found


@planted
def shallow(capture: xr.Dataset) -> Any:
    """Allow only a few calls in calls."""
    found = answer(capture)
    sys.setrecursionlimit(25)
    return found


@planted
def traces(capture: xr.Dataset) -> Any:
    """Trace every call, and raise in it."""

    def trace(*given: Any) -> NoReturn:
        raise KeyboardInterrupt

    found = answer(capture)
    sys.setprofile(trace)
    return found


@planted
def deaf_and_strict(capture: xr.Dataset) -> Any:
    """Ignore signals, stop the collection of garbage, and turn warnings and odd numbers into errors."""
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)
    gc.disable()
    warnings.simplefilter("error")
    np.seterr(all="raise")
    return answer(capture)


@planted
def never_ends(capture: xr.Dataset) -> Any:
    """Leave functions for the end of the process that never end."""

    def forever() -> None:
        while True:
            pass

    atexit.register(forever)
    return answer(capture)


@planted
def not_dying_with_its_parent(capture: xr.Dataset) -> Any:
    """Ask the kernel not to end it with its parent, and to protect it from signals where it can."""
    ctypes.CDLL(None).prctl(1, 0, 0, 0, 0)
    with contextlib.suppress(OSError):
        os.setsid()
    return answer(capture)
