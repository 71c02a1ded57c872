"""Fuzzed inputs: every reader gets files with random changes, and must end with a result or a clear error.

    python -m beambench.benchmarks.checks.fuzz --count 10000 --seed 1

An attempt holds if the reader returns, or raises InputError (exit code 2), within 20 s of CPU time and 4 GiB, and touches nothing
outside its folder. Attempts run in child processes, a hundred or so each: a crash (139) or a hang ends the child, counts as a
failure, and the next child goes on after it.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import selectors
import shutil
import signal
import subprocess
import sys
import tempfile
import traceback
import warnings
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

import numpy as np

from .attempts import Attempts, peak_memory, print_attempts, shares
from .fuzz_subjects import SUBJECTS

__all__ = ["fuzz", "main"]

_TIME_S = 20
_MEMORY_BYTES = 4 * 2**30
_BATCH = 150


class _Hang(BaseException):
    """An attempt that takes too long; not an Exception, so that no reader takes it for a damaged file."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign and print its table. Returns 1 where an attempt failed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=10_000, help="attempts, divided among the kinds of input")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="part of the name of a kind")
    parser.add_argument("--child", nargs=4, metavar=("NAME", "FIRST", "COUNT", "SEED"), help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.child:
        name, *numbers = given.child
        _child(name, *map(int, numbers))
        return 0
    return print_attempts(fuzz(given.count, given.seed, given.only))


def fuzz(count: int, seed: int = 1, only: str = "") -> list[Attempts]:
    """`count` attempts, divided among the kinds of input whose name contains `only`."""
    weights = {name: subject.weight for name, subject in SUBJECTS.items() if only in name}
    return [_part(name, share, seed) for name, share in zip(weights, shares(count, weights.values()), strict=True)]


def _part(name: str, count: int, seed: int) -> Attempts:
    part = Attempts(name)
    done = 0
    while done < count:
        reached = _batch(part, name, done, min(_BATCH, count - done), seed)
        done = max(reached, done + 1)
    return part


def _batch(part: Attempts, name: str, first: int, count: int, seed: int) -> int:
    """Attempts `first` to `first + count` in a child. Returns the number of the next attempt."""
    command = [
        sys.executable,
        "-m",
        "beambench.benchmarks.checks.fuzz",
        "--child",
        name,
        str(first),
        str(count),
        str(seed),
    ]
    at = first
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=_environment()) as child:
        assert child.stdout is not None
        with selectors.DefaultSelector() as selector:
            selector.register(child.stdout, selectors.EVENT_READ)
            while selector.select(_TIME_S * 30):
                line = child.stdout.readline()
                if not line:
                    break
                at += 1
                note, told, peak_bytes = json.loads(line)
                part.used(peak_bytes)
                part.failed(f"attempt {at - 1}: {told}") if told else part.held(note)
            else:
                child.kill()
        code = child.wait()
    if at < first + count:
        part.failed(f"attempt {at}: the process ended by {code}")
        at += 1
    return at


def _environment() -> dict[str, str]:
    """As here, with the path on which this package was found."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}


def _child(name: str, first: int, count: int, seed: int) -> None:
    subject = SUBJECTS[name]
    warnings.simplefilter("ignore")
    signal.signal(signal.SIGPROF, _hang)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with tempfile.TemporaryDirectory(prefix="beambench-fuzz-") as place:
        base = Path(place)
        sound = base / "sound"
        sound.mkdir()
        subject.make(sound)
        subject.read(Path(shutil.copytree(sound, base / "first")))  # the sound example is read, and all is imported
        for number in range(first, first + count):
            work = Path(shutil.copytree(sound, base / "work"))
            subject.change(work, np.random.default_rng([seed, *name.encode(), number]))
            note, told = _attempt(name, work)
            shutil.rmtree(work)
            beside = set(os.listdir(base)) - {"sound", "first", "guard", "capture-of-the-cache"}
            told = told or (f"files beside its folder: {beside}" if beside else "")
            print(json.dumps((note, told, peak_memory())), flush=True)


def _hang(number: int, frame: FrameType | None) -> None:
    raise _Hang


def _attempt(name: str, work: Path) -> tuple[str, str]:
    """(what became of an attempt that held, why it failed)."""
    from ...scenes.errors import InputError

    signal.setitimer(signal.ITIMER_PROF, _TIME_S)  # CPU time: a busy machine decides nothing
    try:
        SUBJECTS[name].read(work)
        note = "read"
    except InputError as error:
        try:
            str(error).encode("utf-8", "backslashreplace")
        except ValueError as wrong:
            return "", f"its error cannot be shown: {wrong!r}"
        note = "refused"
    except _Hang:
        return "", f"over {_TIME_S} s: {traceback.format_exc(limit=-2)[-300:]!r}"
    except BaseException as error:
        places = traceback.extract_tb(error.__traceback__)
        ours = next(
            (place for place in reversed(places) if "beambench" in place.filename and "fuzz" not in place.filename),
            places[-1],
        )
        return "", f"{type(error).__name__}: {str(error)[:120]} ({Path(ours.filename).name}:{ours.lineno})"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    # The peak of the whole process: the attempt that passes the limit is the first one that tells so.
    if peak_memory() > _MEMORY_BYTES:
        os._exit(99)
    return note, ""


if __name__ == "__main__":
    sys.exit(main())
