"""What runs inside a Dask worker: one process of its own for each of its threads, which makes the shards that it is given.

All arguments and results are texts: JSON.
"""

from __future__ import annotations

import json
import os
import platform
import secrets
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...captures.provenance import cpu, versions
from ...optics.jit import source_hash
from ...scenes.errors import InputError
from ...scenes.machine import usable_cores
from .crew import Crew, Task

__all__ = ["about", "leave", "look", "make", "unfit"]

#: Longest wait for the token to be seen: shared folders may show a new file later, s.
_LAG_S = 10.0


class _Crews:
    """The process of each thread, kept from one shard to the next: its start takes longer than a small shard."""

    def __init__(self) -> None:
        self._held: dict[int, tuple[str, str, Crew]] = {}
        self._turn = threading.Lock()

    def of_thread(self, told: str) -> Crew:
        """The crew of this thread for what is `told` first; that of another data set is ended."""
        own, told_all = threading.get_ident(), json.loads(told)
        with self._turn:
            held = self._held.pop(own, None)
        if held is not None and held[0] != told:
            held[2].__exit__()
            held = None
        if held is None:
            threads = max(1, usable_cores() // _threads())
            crew = Crew(
                told_all["begin"], 1, threads, limit_s=told_all["limit_s"], expected_s=told_all["expected_s"], tries=1,
                wanted=lambda: _read(told_all["begin"]["root"])[0] == told_all["token"],
            )  # fmt: skip
            held = (told, told_all["token"], crew)
        with self._turn:
            self._held[own] = held
        return held[2]

    def end(self, token: str = "") -> None:
        """End the process of this thread, or all processes of the run with a token."""
        with self._turn:
            names = [n for n, one in self._held.items() if (one[1] == token if token else n == threading.get_ident())]
            ended = [self._held.pop(name) for name in names]
        for one in ended:
            one[2].__exit__()


_CREWS = _Crews()


def make(told: str, line: str) -> str:
    """Make one shard; what became of it, as JSON: done, refused, stopped or failed, and events.

    Main arguments:
        told: JSON of `begin` (what a worker is told first), `token`, `about`, `limit_s`, `expected_s`. line: the task.
    """
    asked, words = json.loads(told), json.loads(line)
    root = asked["begin"]["root"]
    found, problem = _read_soon(root, asked["token"])
    seen = {"token": found, "problem": problem, "about": about()}
    if wrong := unfit(seen, asked["token"], root, asked["about"], _where()):
        # A worker that fails every shard at once would be given all of them.
        return json.dumps({"stopped": wrong})
    task = Task(f"{words['group']}, shard {words['shard']}, {_where()}", words)
    crew = _CREWS.of_thread(told)
    before = len(crew.events)
    try:
        (ended,) = crew.run([task], lambda index: None)
    except InputError as error:
        _CREWS.end()
        if _read(root)[0] != asked["token"]:
            return json.dumps({"failed": f"{_where()}: the run that asked for it has ended"})
        return json.dumps({"stopped": _words(error)})
    except BaseException:
        _CREWS.end()
        raise
    events = crew.events[before:]
    if ended.done is not None:
        return json.dumps({"done": ended.done, "events": events})
    if ended.error is not None:
        return json.dumps({"refused": _words(ended.error)})
    return json.dumps({"failed": ended.lost, "events": events})


def look(root: str, token: str) -> str:
    """Whether this worker sees the folder, and may write there: the token that it reads, versions and processor, as JSON."""
    found, problem = _read_soon(root, token)
    if found == token:
        trial = Path(root) / "receipts" / f"trial.0.z.{secrets.token_hex(16)}.new"
        try:
            trial.write_bytes(b"")
            trial.unlink()
        except OSError as error:
            found, problem = "", f"{error.strerror}: it cannot write there"
    return json.dumps({"token": found, "problem": problem, "about": about(), "cpu": cpu()})


def unfit(seen: Mapping[str, Any], token: str, root: str, mine: Mapping[str, str], where: str) -> dict[str, Any]:
    """Why a worker that saw this cannot make shards, as the words of an error; empty where it can.

    Main arguments:
        seen: its `token`, `problem` and `about`. token, mine: those of the run. root: the folder. where: the worker.
    """
    if seen["token"] != token:
        return {
            "what": "A worker of the scheduler does not see the folder of the data set, or may not write it.", "where": where,
            "value": seen["problem"] or "the file of another run stands there", "allowed": root,
            "next_step": "write to a folder that all machines share under one path",
        }  # fmt: skip
    if differ := [f"{key} {seen['about'].get(key)}" for key in mine if seen["about"].get(key) != mine[key]]:
        return {
            "what": "A worker of the scheduler has other versions, so that its captures could differ.", "where": where,
            "value": ", ".join(differ), "allowed": ", ".join(f"{key} {value}" for key, value in mine.items()),
            "next_step": "install the same versions on all machines",
        }  # fmt: skip
    return {}


def leave(token: str) -> None:
    """End all processes of a run."""
    _CREWS.end(token)


def about() -> dict[str, str]:
    """Versions on which the bits of captures and files depend."""
    from importlib.metadata import version

    stores = {name: version(name) for name in ("zarr", "numcodecs", "pyarrow")}
    own = {"beambench": version("beambench"), "kernels": source_hash()[:16]}
    return {**own, "python": platform.python_version(), **versions(), **stores}


def _read_soon(root: str, token: str) -> tuple[str, str]:
    """As `_read`; waits a while for `token`."""
    until = time.monotonic() + _LAG_S
    while True:
        found = _read(root)
        if found[0] == token or time.monotonic() > until:
            return found
        time.sleep(0.5)


def _read(root: str) -> tuple[str, str]:
    """(the token in the folder, or why it cannot be read)."""
    from ...captures.store.manifest import regular_size
    from ...captures.store.ownership import TOKEN

    path = Path(root) / TOKEN
    try:
        size = regular_size(path)
        if size is None or size > 64:
            return "", "no such folder, or no run is at work there"
        return path.read_text(encoding="ascii"), ""
    except (OSError, UnicodeDecodeError) as error:
        return "", str(error)


def _words(error: InputError) -> dict[str, Any]:
    return {"what": error.what, "where": error.where, "value": None if error.value is None else str(error.value),
            "allowed": error.allowed, "next_step": error.next_step}  # fmt: skip


def _where() -> str:
    return f"worker {platform.node()}, process {os.getpid()}"


def _threads() -> int:
    """Threads of this Dask worker; 1 outside of one."""
    try:
        from distributed import get_worker

        return int(get_worker().state.nthreads)
    except (ImportError, ValueError):
        return 1
