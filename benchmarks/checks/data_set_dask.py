"""A data set made by Dask: a scheduler and workers as processes of this machine, one of them killed every few seconds.

    python -m beambench.benchmarks.checks.data_set_dask --workers 3 --every 10 --shards 300 --kills 20

The data set is made once by one process, and once by the workers of the scheduler, in rounds: each ends when the command is killed
(`--rounds` times), and the next goes on with --resume. A killed worker is replaced by a new one. The campaign holds if all captures
are there, `verify` finds nothing, and every file is that of the undisturbed store.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from .attempts import Attempts, print_attempts
from .data_set_kills import differing, shards_of, words_for

__all__ = ["Machines", "data_set_dask", "main"]

#: Longest wait for the scheduler to begin, s.
_START_S = 120.0


class Machines:
    """A scheduler and its workers, each a process with a folder of its own, in a `with` block."""

    def __init__(self, folder: Path, workers: int) -> None:
        self._folder, self._file, self._count = folder, folder / "scheduler.json", workers
        self.workers: list[subprocess.Popen[bytes]] = []
        self.address = ""

    def __enter__(self) -> Machines:
        self._scheduler = self._start(
            "dask_scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            "0",
            "--no-dashboard",
            "--scheduler-file",
            str(self._file),
        )
        until = time.monotonic() + _START_S
        while not self.address:
            with suppress(OSError, ValueError):
                self.address = str(json.loads(self._file.read_text())["address"])
            if time.monotonic() > until or self._scheduler.poll() is not None:
                raise RuntimeError("the scheduler does not start")
            time.sleep(0.2)
        for _ in range(self._count):
            self.add()
        return self

    def __exit__(self, *_: object) -> None:
        for one in (*self.workers, self._scheduler):
            one.kill()
            one.wait()

    def add(self) -> None:
        """Start a worker."""
        self.workers.append(
            self._start(
                "dask_worker", self.address, "--no-nanny", "--no-dashboard", "--nthreads", "1", "--host", "127.0.0.1",
                "--local-directory", str(self._folder / "dask"),
            )
        )  # fmt: skip

    def kill(self, number: int) -> None:
        """Kill a worker, as the kernel does where memory is short."""
        one = self.workers.pop(number)
        one.send_signal(signal.SIGKILL)
        one.wait()

    def _start(self, module: str, *words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.{module}", *words]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign and print its table. Returns 1 where an attempt failed."""
    if find_spec("distributed") is None:
        sys.exit("The campaign needs the extra `dask`: pip install 'beambench[dask]'")
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--workers", type=int, default=3)
    parser.add_argument("--every", type=float, default=10.0, help="time between two kills of a worker, s")
    parser.add_argument("--shards", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=0, help="kills of the command itself")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(arguments)
    return print_attempts([data_set_dask(given.workers, given.every, given.shards, given.rounds, given.seed)])


def data_set_dask(workers: int, every_s: float, shards: int, rounds: int = 0, seed: int = 1) -> Attempts:
    """The campaign: an attempt for each kill, and a last one for the finished store."""
    part = Attempts(f"a data set of {shards} shards by {workers} Dask workers")
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory(prefix="beambench-dask-") as place:
        base = Path(place)
        file = base / "set.json"
        file.write_text(json.dumps(shards_of(shards)))
        subprocess.run(words_for(file, base / "whole", "--workers", "1"), check=True, capture_output=True)
        with Machines(base, workers) as machines:
            words = words_for(file, base / "broken", "--dask", machines.address)
            left = rounds
            while True:
                end_s = float(rng.uniform(0.3, 1.0)) * 2.0 * every_s if left else float("inf")
                code, said = _round(words, machines, every_s, end_s, rng, part)
                if code == 0:
                    break
                if code != -signal.SIGKILL:
                    part.failed(f"exit {code}: {said[-500:]}")
                    return part
                part.held("the command")
                left -= 1
        problem = differing(base / "whole", base / "broken", len(list((base / "whole" / "receipts").glob("*.z"))))
        part.failed(problem) if problem else part.held("finished")
    return part


def _round(
    words: list[str], machines: Machines, every_s: float, end_s: float, rng: np.random.Generator, part: Attempts
) -> tuple[int, str]:
    """Start or continue the data set, kill a worker every `every_s`, and the command after `end_s`; its exit code and words."""
    with (
        tempfile.TemporaryFile() as errors,
        subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=errors) as process,
    ):
        began = last = time.monotonic()
        while process.poll() is None:
            time.sleep(0.1)
            now = time.monotonic()
            if now - began > end_s:
                process.send_signal(signal.SIGKILL)
                process.wait()
            elif now - last > every_s:
                machines.kill(int(rng.integers(len(machines.workers))))
                machines.add()
                part.held("a worker")
                last = now
        errors.seek(0, os.SEEK_SET)
        return process.returncode, errors.read().decode(errors="replace")


if __name__ == "__main__":
    sys.exit(main())
