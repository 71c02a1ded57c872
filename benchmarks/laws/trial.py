"""The laws of a plug-in, tried in a process of its own: the code of others may end the process, or never return.

The child writes one JSON document per line to a pipe: first the names of its laws, then each law as it begins and with its
result. If the child ends during a law, that law is broken and another child tries the rest; if a law takes too long, the rest
is not tried.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ...scenes import spec_files
from ...scenes.errors import InputError
from ..folders.progress import Progress, silent
from ..runner.confined import ENTER, Confined, confined
from ..runner.estimator_labels import check_estimators
from ..runner.patience import Patience
from .suite import LawResult

__all__ = ["LAW_LIMIT_S", "try_laws"]

#: Longest time for one law, or for the import before the laws, without the wait for a processor [s]; a first call may compile.
LAW_LIMIT_S = 120.0

_CHILD = (
    ENTER + "import sys; enter(int(sys.argv[-1])); from beambench.benchmarks.laws.trial import _serve; "
    "_serve(sys.argv[1], sys.argv[2:-1], int(sys.argv[-1]))"
)


def try_laws(label: str, limit_s: float = LAW_LIMIT_S, progress: Progress = silent) -> list[LawResult]:
    """Check a plug-in against the laws of its stage; what it prints goes to standard error.

    Main arguments:
        label: `name` or `name[key=value,...]`. limit_s: longest time for one law. progress: told of every law that begins.

    Raises:
        InputError: no such estimator or parameter, a stage without laws, or an import that fails or never ends.
    """
    (chosen,) = check_estimators([label])  # names the files of its parameters, which the jail lets it read
    # Laws are tried on public scenes, which hide nothing.
    library = Path(spec_files.__file__).parent / "library"
    with confined(chosen.label, read=[library]) as place:
        return _tried(chosen.label, limit_s, place, progress)


def _tried(label: str, limit_s: float, place: Confined, progress: Progress) -> list[LawResult]:
    results: dict[str, LawResult] = {}
    names: list[str] = []
    while True:
        begun, end = "", _End()
        for event in _events(label, list(results), limit_s, end, place):
            if "refused" in event:
                raise InputError(**event["refused"])
            if "laws" in event:
                names = list(event["laws"])
            elif "begins" in event:
                begun = str(event["begins"])
                progress("laws", len(results), len(names), begun)
            elif "law" in event:
                results[event["law"]] = LawResult(str(event["law"]), bool(event["holds"]), str(event["seen"]))
                begun = ""
        left = [name for name in names if name not in results]
        if names and not left:
            progress("laws", len(names), len(names), "")
            return [results[name] for name in names]
        if not names:
            raise InputError(
                "The plug-in cannot be imported.",
                where=label,
                value=end.why,
                allowed="a module whose import ends, and leaves the process alone",
                next_step="beambench estimators list",
            )
        broken = begun or left[0]
        results[broken] = LawResult(broken, False, end.why)
        if end.late:
            for name in left:
                results.setdefault(name, LawResult(name, False, "Not tried: an earlier law did not end."))
            return [results[name] for name in names]


class _End:
    """How a child ended: why, and whether it had to be stopped."""

    def __init__(self) -> None:
        self.why, self.late = "", False


def _events(label: str, done: Sequence[str], limit_s: float, end: _End, place: Confined) -> Iterator[dict[str, Any]]:
    """The events that a child writes, until it ends or writes nothing for `limit_s`; `end` then holds the reason."""
    read, write = os.pipe()
    try:
        process = subprocess.Popen(
            [sys.executable, "-P", "-c", _CHILD, label, *done, str(write)],
            stdin=subprocess.PIPE,
            stdout=2 if sys.stderr else subprocess.DEVNULL,
            pass_fds=(write,),
            start_new_session=True,
            env=place.environment,
        )
    except BaseException:
        os.close(read)
        raise
    finally:
        os.close(write)
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError), process.stdin:
        process.stdin.write(place.rules)
    try:
        buffer, patience = b"", Patience(process.pid, limit_s)
        while True:
            if not select.select([read], [], [], 0.2)[0]:
                if not patience.over():
                    continue
                end.why, end.late = f"It did not end within {limit_s:g} s.", True
                return
            data = os.read(read, 1 << 16)
            if not data:
                break
            *lines, buffer = (buffer + data).split(b"\n")
            for line in lines:
                yield json.loads(line)
                patience = Patience(process.pid, limit_s)
        try:
            code = process.wait(timeout=10.0)
        except subprocess.TimeoutExpired:
            end.why, end.late = "It closed its files and did not end.", True
            return
        end.why = f"It ended the process (exit code {code})." if code >= 0 else f"The process died of signal {-code}."
    finally:
        os.close(read)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _serve(label: str, done: Sequence[str], pipe: int) -> None:
    """The child: try the laws that are not `done`."""
    from .check import laws_of

    def send(event: dict[str, Any]) -> None:
        os.write(pipe, (json.dumps(event, default=str) + "\n").encode())

    def report(name: str, result: LawResult | None) -> bool:
        if result is not None:
            send({"law": name, "holds": result.holds, "seen": result.seen})
            return True
        if name not in done:
            send({"begins": name})
        return name not in done

    try:
        names, judge = laws_of(label)
    except InputError as error:
        send(
            {
                "refused": {
                    "what": error.what, "where": error.where, "value": error.value, "allowed": error.allowed,
                    "next_step": error.next_step,
                }
            }
        )  # fmt: skip
        return
    send({"laws": names})
    judge(report)
