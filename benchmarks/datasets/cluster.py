"""Workers on many machines: the shards of a data set as tasks of a Dask scheduler.

Each Dask worker makes a shard in a process of its own (`remote`), in the folder that all machines share. Dask runs the task of a
worker that died elsewhere; here a shard whose process died, hung or failed is given out again, and set aside after the third time.
A shard counts as done when this process has read it from the shared folder and found it sound.

Dask sends functions and their arguments as pickles: whoever reaches the scheduler can run code on its workers and, by what tasks
return, on its clients. This package sends names of functions and texts of JSON, and reads texts of JSON; give the scheduler TLS
certificates, or a network of its own. Source: distributed.dask.org, "Limitations: Security", and "TLS/SSL".
"""

from __future__ import annotations

import json
import queue
import secrets
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from ...captures.provenance import cpu
from ...scenes.errors import InputError
from .crew import MOST_TRIES, Task, error_of
from .place import sound_receipt
from .remote import about, leave, look, make, unfit

__all__ = ["Cluster"]

#: Longest wait for a scheduler, for a first worker, and for one to come back after the last one was lost, s.
_SCHEDULER_S, _FIRST_S, _GONE_S = 10.0, 20.0, 300.0
#: Longest wait for a shard that a worker has completed to be seen here: shared folders may show it later, s.
_SEEN_S = 30.0
#: Tasks that the scheduler holds for each thread of its workers.
_AHEAD = 2


class Cluster:
    """The workers of a scheduler, in a `with` block; as `Crew`.

    Main arguments:
        begin: what each worker is told first; its `root` is the folder that all share. address: of the scheduler, tcp://HOST:PORT
            or tls://HOST:PORT.
    Other arguments:
        limit_s, expected_s: as of `Crew`.

    Raises InputError: Dask is not installed, the scheduler does not answer, has no worker, or one that does not see the folder or
    has other versions.
    """

    def __init__(self, begin: dict[str, Any], address: str, *, limit_s: float | None, expected_s: float) -> None:
        self._root, self._address = Path(begin["root"]), address
        self._token = secrets.token_hex(16)
        settings = {"token": self._token, "about": about(), "limit_s": limit_s, "expected_s": expected_s}
        self._begin = json.dumps({"begin": begin, **settings})
        self._again: deque[Task] = deque()
        self._ended: queue.SimpleQueue[tuple[Any, Task]] = queue.SimpleQueue()
        self._sent = 0
        self._client: Any = None
        #: What happened to workers, for the report: one line each.
        self.events: list[str] = []

    def __enter__(self) -> Cluster:
        from ...captures.store.journal import write_file
        from ...captures.store.ownership import TOKEN

        self._client = _client(self._address)
        try:
            # From here on, workers of an earlier run that still write stop: it was another token that they were told.
            write_file(self._root / TOKEN, self._token.encode())
            self._check(self._threads(_FIRST_S))
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        from contextlib import suppress

        from ...captures.store.ownership import TOKEN

        (self._root / TOKEN).unlink(missing_ok=True)
        with suppress(Exception):  # whatever became of the scheduler
            self._client.run(leave, self._token, on_error="ignore")
        self._client.close(timeout=5)

    def run(self, tasks: Iterable[Task], heard: Callable[[int], None]) -> Iterator[Task]:
        """Every task when it has ended, done or set aside; `heard` is told of every capture of one that is done.

        Raises InputError where no work can go on: a full disk, no worker left, a scheduler that is gone.
        """
        waiting, running = iter(tasks), 0
        left = time.monotonic()
        while True:
            threads = sum(self._threads(0.0).values())
            while running < _AHEAD * max(threads, 1):
                task = self._again.popleft() if self._again else next(waiting, None)
                if task is None:
                    break
                self._send(task)
                running += 1
            if not running:
                return
            left = time.monotonic() if threads else left
            if time.monotonic() - left > _GONE_S:
                raise InputError(
                    "The scheduler has no worker any more; what is complete is kept.", where=self._address,
                    next_step="start workers, then --resume",
                )  # fmt: skip
            try:
                future, task = self._ended.get(timeout=2.0)
            except queue.Empty:
                continue
            running -= 1
            if self._judge(task, self._told(future)):
                if task.done is not None:
                    for row in task.line["rows"]:
                        heard(int(row))
                yield task

    def _send(self, task: Task) -> None:
        self._sent += 1
        name = f"beambench-{self._token[:8]}-{task.line['group']}-{task.line['shard']}-{self._sent}"
        future = self._client.submit(make, self._begin, json.dumps(task.line), key=name, pure=False, retries=0)
        future.add_done_callback(lambda ended, task=task: self._ended.put((ended, task)))

    def _told(self, future: Any) -> dict[str, Any]:
        """What a worker told of its task; where Dask tells instead, that it failed."""
        if future.cancelled():
            raise InputError(
                "The scheduler is gone, or has dropped the work; what is complete is kept.", where=self._address,
                next_step="start it, then --resume",
            )  # fmt: skip
        error = future.exception()
        if error is not None:
            # KilledWorker: Dask has seen so many workers die with this task (`distributed.scheduler.allowed-failures`).
            return {"failed": f"{type(error).__name__}: {error}", "final": type(error).__name__ == "KilledWorker"}
        told: dict[str, Any] = json.loads(future.result())
        return told

    def _judge(self, task: Task, told: dict[str, Any]) -> bool:
        """Take note of what became of a task; False where it is to be tried again."""
        self.events += told.get("events", [])
        if "stopped" in told:
            raise error_of(told["stopped"])
        if "refused" in told:
            task.error = error_of(told["refused"])
            task.lost = str(task.error)
            return True
        if "done" in told and self._seen(task):
            task.done = told["done"]
            return True
        why = told.get("failed") or "its shard is not sound in the shared folder"
        task.tries += 1
        if "events" not in told or "done" in told:
            self.events.append(f"{task.name}: {why}")
        if task.tries < MOST_TRIES and not told.get("final"):
            self._again.append(task)
            return False
        ended = "as many workers as the scheduler allows" if told.get("final") else f"{task.tries} workers"
        task.lost = f"it ended {ended}: {why}"
        return True

    def _seen(self, task: Task) -> bool:
        """Whether the shard is there and sound, as this machine sees the folder."""
        until = time.monotonic() + _SEEN_S
        while sound_receipt(self._root, (task.line["group"], task.line["shard"])) is None:
            if time.monotonic() > until:
                return False
            time.sleep(0.5)
        return True

    def _threads(self, wait_s: float) -> dict[str, int]:
        """Threads by worker; waits for a first one. Raises InputError where there is none after that."""
        until = time.monotonic() + wait_s
        while True:
            found = {str(name): int(one["nthreads"]) for name, one in
                     self._client.scheduler_info(n_workers=-1)["workers"].items()}  # fmt: skip
            if found or not wait_s:
                return found
            if time.monotonic() > until:
                raise InputError(
                    "The scheduler has no workers.", where=self._address, next_step=f"dask worker {self._address}"
                )
            time.sleep(0.5)

    def _check(self, workers: dict[str, int]) -> None:
        """Refuse workers that do not see the same folder, or have other versions; those that come later are asked with their first
        shard. Raises InputError."""
        told = self._client.run(look, str(self._root), self._token, workers=list(workers), on_error="return")
        others = []
        for name, text in told.items():
            if isinstance(text, OSError):
                continue  # it has died since
            if not isinstance(text, str):
                raise InputError(
                    "A worker of the scheduler cannot run Beambench.", where=str(name), value=f"{type(text).__name__}: {text}",
                    next_step="install the same version of beambench[dask] there",
                )  # fmt: skip
            found = json.loads(text)
            if words := unfit(found, self._token, str(self._root), about(), str(name)):
                raise error_of(words)
            if found["cpu"] != cpu():
                others.append(str(name))
        if others:
            self.events.append(
                f"other processors, whose captures may differ in their last bits: {', '.join(sorted(others))}"
            )


def _client(address: str) -> Any:
    """A connection to the scheduler. Raises InputError."""
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "Dask is not installed.", where="--dask", value=address, next_step="pip install 'beambench[dask]'"
        ) from error
    try:
        return Client(address, timeout=_SCHEDULER_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            "No Dask scheduler answers there.", where="--dask", value=address, allowed="tcp://HOST:PORT or tls://HOST:PORT",
            next_step="dask scheduler, and dask worker on each machine",
        ) from error  # fmt: skip
