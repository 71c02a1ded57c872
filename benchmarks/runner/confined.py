"""A plug-in in the jail of a run, outside a run: its import, and its laws.

    with confined(label) as place:   # the child gets place.rules on standard input, and calls `enter` before anything else

The jail is that of `process.jail_rules`: the child writes in a temporary folder that is removed at the end, and ends with all
that it started.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["ENTER", "Confined", "confined", "enter", "plugin_row"]

#: Longest time for the import of a plug-in, without the wait for a processor [s].
PLUGIN_IMPORT_S = 30.0
#: How the code of a child (`python -P -c`) begins.
ENTER = "from beambench.benchmarks.runner.confined import enter; "
#: The record of a plug-in is on the last line, whatever the plug-in printed before.
_ROW = (
    ENTER + "enter(); import json, sys; from beambench.estimators.listing import row; "
    "print('\\n' + json.dumps(row(sys.argv[1], 'plug-in'), default=str))"
)


@dataclass(frozen=True)
class Confined:
    """What a child gets. rules: one line for its standard input. environment: its variables."""

    rules: bytes
    environment: dict[str, str]


@contextmanager
def confined(label: str, *, read: Iterable[Path] = ()) -> Iterator[Confined]:
    """The rules and the environment of a child, and its temporary folder for as long.

    Main arguments:
        label: of the estimator. read: folders that it may read beside those of a run.

    Raises OSError.
    """
    from .process import jail_rules, own_cache
    from .scratch import scratch_folder
    from .variables import child_environment

    with scratch_folder("estimate") as folder:
        work = folder / "cwd"
        temporary = work / "tmp"
        temporary.mkdir(parents=True)
        environment = child_environment() | {"TMPDIR": str(temporary)}
        if cache := own_cache(label):
            environment["XDG_CACHE_HOME"] = str(cache)
        rules = jail_rules(label, work, ())
        if "read" in rules:
            rules["read"] += map(str, read)
        yield Confined(json.dumps(rules).encode() + b"\n", environment)


def enter(*close: int) -> None:
    """In the child, before anything else is imported: take on the rules from standard input; `close`: files of the worker alone."""
    from .namespaces import supervised

    rules = json.loads(sys.stdin.buffer.readline())
    supervised(own=bool(rules.get("own")), close=close)
    if rules.get("read"):
        from .jail import seal

        seal(read=rules["read"], write=rules["write"])


def plugin_row(name: str) -> dict[str, Any]:
    """The record of a plug-in (`estimators.listing.row`), imported in a child, as its code may end the process or never return."""
    from ...estimators.listing import failed

    with confined(name) as place, subprocess.Popen(
        [sys.executable, "-P", "-c", _ROW, name],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=place.environment,
    ) as process:  # fmt: skip
        told = _told(process, place.rules, PLUGIN_IMPORT_S)
    if told is None:
        return failed(name, "plug-in", f"its import did not end within {PLUGIN_IMPORT_S:g} s")
    lines = told[0].decode(errors="replace").strip().splitlines()
    try:
        record = json.loads(lines[-1]) if lines else None
    except ValueError:
        record = None
    if process.returncode or not isinstance(record, dict):
        said = (told[1].decode(errors="replace").strip().splitlines() or ["nothing"])[-1]
        return failed(name, "plug-in", f"its import ended the process (exit code {process.returncode}): {said[:200]}")
    return record


def _told(process: subprocess.Popen[bytes], given: bytes, limit_s: float) -> tuple[bytes, bytes] | None:
    """What a process prints and says until it ends; None where it was killed after `limit_s`, less its wait for a processor."""
    from .patience import Patience

    patience, rest = Patience(process.pid, limit_s), given
    try:
        while True:
            try:
                return process.communicate(rest, timeout=0.2)
            except subprocess.TimeoutExpired:
                rest = b""  # it goes on with what it was given
                if patience.over():
                    return None
    finally:
        process.kill()  # nothing, where it has ended
