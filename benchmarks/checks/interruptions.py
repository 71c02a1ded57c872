"""Kills and faults of the system at random calls of commands that write.

    python -m beambench.benchmarks.checks.interruptions --kind kills --count 99 --seed 1
    python -m beambench.benchmarks.checks.interruptions --kind faults --count 800 --seed 1

Needs strace. A kill is SIGKILL at a random system call that changes files. A fault makes such a call fail, once (EIO, ENOSPC,
EACCES) or from then on (a full disk). After a kill the command that the documentation names must finish the work, with the
result of undisturbed work and nothing left over. A fault must end with 0 and that result, or with 2, 3 or 130 and a clear
error, and then the same holds. No file of others may change.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import traceback
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from .attempts import Attempts, print_attempts
from .interrupted_work import WORKS, Work
from .traced import CALLS, NAMES, Ended, available, preload, run_traced

__all__ = ["interruptions", "main"]

_FAULTS = (
    "error=EIO:when={}",
    "error=ENOSPC:when={}",
    "error=ENOSPC:when={}+",
    "error=EACCES:when={}",
    "error=EDQUOT:when={}+",
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a campaign and print its table. Returns 1 where an attempt failed, 3 where strace does not work."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--kind", choices=["kills", "faults"], required=True)
    parser.add_argument("--count", type=int, default=99, help="attempts, divided among the commands")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="part of the name of a command")
    given = parser.parse_args(arguments)
    if reason := available():
        print(reason, file=sys.stderr)
        return 3
    return print_attempts(interruptions(given.kind, given.count, given.seed, given.only))


def interruptions(kind: str, count: int, seed: int = 1, only: str = "") -> list[Attempts]:
    """`count` attempts of a kind, "kills" or "faults", divided by weight among the commands whose names contain `only`."""
    preload()
    works = {name: work for name, work in WORKS.items() if only in name}
    total = sum(work.weight for work in works.values())
    parts = []
    for name, work in works.items():
        share = max(1, round(count * work.weight / total))
        parts.append(_part(name, work, kind, share, np.random.default_rng([seed, *name.encode(), *kind.encode()])))
    return parts


def _part(name: str, work: Work, kind: str, count: int, rng: np.random.Generator) -> Attempts:
    part = Attempts(name)
    with tempfile.TemporaryDirectory(prefix="beambench-interrupt-") as place:
        base = Path(place)
        sound, work_folder = base / "sound", base / "work"
        sound.mkdir()
        _forked(partial(work.prepare, sound))
        shutil.copytree(sound, work_folder)
        calls = NAMES if work.first_thread else CALLS
        first = run_traced(work.words(work_folder), base, calls=calls, first_thread=work.first_thread)
        expected, reach = work.result(work_folder), first.each
        if first.code != 0 or not expected:
            part.failed(f"undisturbed: exit {first.code}: {first.text[-200:]!r}")
            return part
        for number in range(count):
            shutil.rmtree(work_folder)
            shutil.copytree(sound, work_folder)
            (work_folder / "guard.txt").write_text("mine")
            call = calls[int(rng.choice(len(calls), p=[reach.get(c, 0) / sum(reach.values()) for c in calls]))]
            when = int(rng.integers(1, reach[call] + 1))
            how = (
                f"signal=KILL:when={when}" if kind == "kills" else _FAULTS[int(rng.integers(len(_FAULTS)))].format(when)
            )
            ended = run_traced(work.words(work_folder), base, inject=how, calls=(call,), first_thread=work.first_thread)
            part.used(ended.peak_bytes)
            problem = _problem(work, kind, ended, expected, work_folder, base, part)
            told = f"attempt {number}, {call} {how}: {problem}"
            part.failed(told) if problem else part.held(_note(kind, ended))
    return part


def _forked(task: Callable[[], object]) -> None:
    """Carry out a task in a forked process, so that this one starts no thread. Raises RuntimeError where it fails."""
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            task()
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    if os.waitpid(pid, 0)[1]:
        raise RuntimeError("the input of the work could not be made")


def _note(kind: str, ended: Ended) -> str:
    if not ended.injected:
        return "not reached"
    return "killed" if kind == "kills" else f"exit {ended.code}"


def _problem(work: Work, kind: str, ended: Ended, expected: str, folder: Path, base: Path, part: Attempts) -> str:
    """Why an attempt did not hold, or ""."""
    if ended.code is None:
        return "it hung"
    if kind == "faults" or not ended.injected:
        if ended.code not in (0, 2, 3, 130) or "Traceback" in ended.text:
            return f"exit {ended.code}: {ended.text[-300:]!r}"
        if ended.code == 0 and work.result(folder) != expected:
            return "exit 0, and another result"
    if (folder / "guard.txt").read_text() != "mine":
        return "a file of others was changed"
    finished = []
    if ended.code != 0:
        for words in work.again(folder):
            done = run_traced(words, base, calls=("mkdir",), first_thread=work.first_thread)
            part.used(done.peak_bytes)
            finished.append(f"{' '.join(words[:2])}: exit {done.code}: {done.text[-250:]!r}")
            if done.code == 0 and work.result(folder) == expected:
                break
        else:
            return "; ".join(finished)
    left = sorted(path.name for path in folder.iterdir() if path.name.endswith((".partial", ".replaced")))
    left += [
        path.name for path in (folder / "out").glob("*") if path.name in ("unfinished", "replaced", "exchange.json")
    ]
    return f"left over: {left}" if left else ""


if __name__ == "__main__":
    sys.exit(main())
