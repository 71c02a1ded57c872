"""A worker: a process that makes whole shards, one after the other, as it is told on standard input.

Lines of JSON both ways. It ends with the process that started it: its standard input closes, and the kernel kills it.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from ...scenes.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

    from ...generator.workshop import Workshop
    from ...scenes.datasets.draws import Drawn, Draws
    from ...scenes.scene import Scene

__all__ = ["Maker", "main"]


class Maker:
    """Makes the captures of a data set by their number; `facts` are what the index tells of one."""

    def __init__(self, draws: Draws, workshop: Workshop | None = None) -> None:
        from ...generator.workshop import Workshop

        self.draws = draws
        self._workshop = workshop or Workshop()
        self._drawn: tuple[int, Drawn, Scene] | None = None

    def capture(self, index: int) -> tuple[xr.Dataset, dict[str, Any]]:
        """Capture `index` and its facts. Raises InputError for an impossible scene, and as `padded`."""
        from ...captures.padding import padded

        data = self.draws.data
        number = index // data.repeats
        if self._drawn is None or self._drawn[0] != number:
            self._drawn = (number, *self.draws.possible(number))
        _, drawn, scene = self._drawn
        capture = self._workshop.make(
            scene, seed=data.seed, capture_key=index, fidelity=self.draws.fidelity(drawn.base), rtol=data.rtol,
            truth_electrons=data.truth_electrons, truth_components=data.truth_components,
            truth_instances=data.truth_instances,
        )  # fmt: skip
        capture = padded(capture, f"capture {index}, {drawn.base}")
        facts = {
            "part": self.draws.part(drawn), "base": drawn.base, "draw": number, "seed": data.seed,
            "scene_sha256": self.draws.content(drawn), "values": drawn.values,
        }  # fmt: skip
        return capture, facts


def main() -> None:
    """Answer the lines of standard input until it ends."""
    out = _own_output()
    _end_with_parent()
    warnings.simplefilter(
        "ignore"
    )  # a scene's warnings are told by the plan, once; here they would come for each capture
    begin = json.loads(sys.stdin.readline())
    worker = _Worker(begin, out)
    for line in sys.stdin:
        worker.answer(json.loads(line))


class _Worker:
    def __init__(self, begin: dict[str, Any], out: IO[str]) -> None:
        from ...scenes.datasets.draws import Draws

        self._out = out
        self._root = Path(begin["root"])
        self._structures = begin["structures"]
        self._identity = begin["identity"]
        _limit_threads(int(begin["threads"]))
        self._maker = Maker(Draws.of(begin["resolved"]))

    def answer(self, task: dict[str, Any]) -> None:
        """Do one task and tell how it went: done, refused (it would be again), stopped (no work can go on), or failed."""
        try:
            told = self._probe(task) if task["kind"] == "probe" else self._shard(task)
            self._tell({"done": told})
        except InputError as error:
            words = {"what": error.what, "where": error.where, "value": None if error.value is None else str(error.value),
                     "allowed": error.allowed, "next_step": error.next_step}  # fmt: skip
            self._tell({"stopped" if isinstance(error.__cause__, OSError) else "refused": words})
        except Exception:
            self._tell({"failed": traceback.format_exc(limit=-4)})

    def _probe(self, task: dict[str, Any]) -> dict[str, Any]:
        """Make a few captures and write them into a shard that is thrown away: layout, sizes and times."""
        from ...captures.store.arrays import structure_of
        from ...captures.store.shard_finish import write_request
        from ...captures.store.shard_writer import ShardWriter
        from .sizes import sizes_of_shard

        times: list[float] = []
        told: list[str] = []
        rows = list(task["rows"])
        with tempfile.TemporaryDirectory(prefix="beambench-pilot-") as place:
            write_request(Path(place), {})
            with ShardWriter(Path(place), task["group"], 0, rows, len(rows), last=True) as writer:
                structure: dict[str, Any] = {}
                for index in rows:
                    began = time.process_time()
                    with warnings.catch_warnings(record=True) as caught:
                        warnings.simplefilter("always")
                        capture, facts = self._maker.capture(index)
                    structure = _one_layout(structure_of(capture), structure, index)
                    writer.append(capture, facts)
                    times.append(time.process_time() - began)
                    told += [str(one.message) for one in caught]
                    self._tell({"capture": index})
                receipt = writer.close()
        sizes = sizes_of_shard(receipt, self._maker.draws.data.repeats)
        decoded = sum(int(capture.variables[name].nbytes) for name in structure)
        return {"structure": structure, "cpu_s": times, "decoded": decoded, "sizes": sizes, "warnings": sorted({*told})}

    def _shard(self, task: dict[str, Any]) -> dict[str, Any]:
        from ...captures.store.shard_writer import ShardWriter
        from .jobs import Job

        job = Job(task["group"], task["shard"], tuple(task["rows"]), task["length"], task["last"])
        began = time.process_time()
        with ShardWriter(
            self._root, job.group, job.shard, job.rows, job.length, last=job.last,
            structure=self._structures[job.group], job=job.key(self._identity),
        ) as writer:  # fmt: skip
            for index in job.rows:
                capture, facts = self._maker.capture(index)
                writer.append(capture, facts)
                self._tell({"capture": index})
            receipt = writer.close()
        return {"content": receipt.content, "cpu_s": time.process_time() - began}

    def _tell(self, what: dict[str, Any]) -> None:
        self._out.write(json.dumps(what) + "\n")
        self._out.flush()


def _one_layout(found: dict[str, Any], first: dict[str, Any], index: int) -> dict[str, Any]:
    """The layout of a capture, which must be that of the first. Raises InputError."""
    if first and found != first:
        other = next(n for n in {**first, **found} if first.get(n) != found.get(n))
        raise InputError(
            "The captures of one modality in a data set have one layout.", where=f"capture {index}: {other}",
            value=found.get(other), allowed=str(first.get(other)),
            next_step="make a data set for each size, or set the sizes in `overrides` of the base scenes",
        )  # fmt: skip
    return found


def _own_output() -> IO[str]:
    """Standard output for answers alone: what libraries print goes to standard error."""
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    return out


def _end_with_parent() -> None:
    """Let the kernel end this process with the one that started it; a signal to the group is the parent's to handle."""
    import ctypes

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, int(signal.SIGKILL), 0, 0, 0)  # PR_SET_PDEATHSIG = 1
    if os.getppid() != int(sys.argv[1]):
        sys.exit(1)  # the parent ended before; it may itself be process 1, in a container


def _limit_threads(count: int) -> None:
    """Let Mitsuba use `count` threads; all others go by the environment."""
    from ...generator.rays.backend import mitsuba

    mitsuba()
    import drjit as dr

    dr.set_thread_count(count)
