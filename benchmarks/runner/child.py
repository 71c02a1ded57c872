"""One estimator in its own process: reads captures, times the calls, writes the estimates. Started by `runner`.

    python -P -m beambench.benchmarks.runner.child LABEL JOBS_FD EVENTS_FD

Jobs arrive as lines of JSON on one pipe, and events are sent on another; standard output belongs to the estimator. Neither
the truth nor its location is ever sent to this process.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import json
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

__all__ = ["main"]

#: Calls whose total time is shorter than this are repeated, so that a time is a median with a spread.
_ENOUGH_S = 0.1
_MOST_CALLS = 5
#: Least number of calls, unless the calls have already taken this long.
_LEAST_CALLS, _LONG_S = 3, 1.0


def _die_with_parent() -> None:
    """Make Linux end this process when the runner ends, for any reason."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, int(signal.SIGKILL), 0, 0, 0)  # PR_SET_PDEATHSIG = 1
        if os.getppid() == 1:
            os._exit(1)


def _status_bytes(key: str) -> int:
    """A value of /proc/self/status in bytes (`VmRSS`, `VmHWM`)."""
    with open("/proc/self/status", encoding="ascii") as file:
        for line in file:
            if line.startswith(key + ":"):
                return int(line.split()[1]) * 1024
    raise OSError(f"no {key}")


def _baseline() -> int:
    """Return freed memory to the system, restart the high-water mark, and return the resident size in bytes."""
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:  # glibc only: with other allocators freed pages stay in the baseline
        trim(0)
    with open("/proc/self/clear_refs", "w", encoding="ascii") as file:
        file.write("5")
    return _status_bytes("VmRSS")


def _cpu_s() -> float:
    """CPU time of all threads of this process and of its ended children, s."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime


def _touch(capture: Any) -> None:
    """Read every page of the input, so that no call includes the time of the disk."""
    for variable in capture.variables.values():
        if variable.values.size and variable.dtype.kind in "fiub":
            variable.values.max()


def _again(wall: list[float]) -> bool:
    """Whether more calls are needed for a reliable median of these times."""
    spent = sum(wall)
    few = len(wall) < _LEAST_CALLS and spent < _LONG_S
    return not wall or few or (len(wall) < _MOST_CALLS and spent < _ENOUGH_S)


def _measure(call: Callable[[Any], Any], capture: Any) -> tuple[Any, dict[str, Any]]:
    """The estimate; CPU and wall time of each call and their medians, s; peak memory of the first call above the baseline."""
    _touch(capture)
    try:
        before = _baseline()
    except OSError:
        before = -1  # a system without these files: the peak is reported as unknown
    cpu: list[float] = []
    wall: list[float] = []
    result, peak = None, -1
    while _again(wall):
        cpu_start, wall_start = _cpu_s(), time.perf_counter()
        answer = call(capture)
        wall.append(time.perf_counter() - wall_start)
        cpu.append(_cpu_s() - cpu_start)
        if len(wall) == 1:
            result = answer
            peak = max(_status_bytes("VmHWM") - before, 0) if before >= 0 else -1
    middle = (len(wall) - 1) // 2
    return result, {
        "cpu_s": sorted(cpu)[middle],
        "wall_s": sorted(wall)[middle],
        "cpu_calls": cpu,
        "wall_calls": wall,
        "peak_bytes": peak,
    }


def _save(result: Any, folder: Path, stage: Any, sizes: dict[str, int]) -> str:
    """Write the arrays of a stage's result; return the reason why it is invalid, or ""."""
    import numpy as np
    import xarray as xr

    from .protocol import misshapen

    if not isinstance(result, xr.Dataset):
        return f"returned {type(result).__name__}, not a Dataset"
    folder.mkdir(parents=True, exist_ok=True)
    known = dict(sizes)
    for name, dims in stage.dims().items():
        if name not in result:
            return f"no variable {name!r}"
        variable = result[name]
        if tuple(map(str, variable.dims)) != dims:
            return f"{name} has dims {tuple(map(str, variable.dims))}, not {dims}"
        if wrong := misshapen(name, dims, tuple(variable.shape), known):
            return wrong
        if variable.dtype.kind not in "fbiu":
            return f"{name} is of type {variable.dtype}"
        np.save(folder / f"{name}.npy", np.ascontiguousarray(variable.values), allow_pickle=False)
    return ""


def _bind(label: str) -> tuple[Callable[[Any], Any], Any]:
    """The estimator's function with the label's parameters (only its own work is timed), and the estimator."""
    from ...estimators.labels import check_parameters, parse_label
    from ...estimators.registry import get_estimator

    name, params = parse_label(label)
    chosen = get_estimator(name)
    return partial(chosen.function, **check_parameters(chosen.function, params, where=name)), chosen


def _another(chosen: Any, modality: str) -> str:
    """Reason why an estimator does not read captures of a modality, or ""."""
    stage = chosen.stage
    if stage.modality != modality:
        return f"reads {stage.modality} captures, not {modality}"
    return (
        "" if chosen.reads_captures else f"reads the results of another stage ({', '.join(stage.takes)}), no captures"
    )


def _home(label: str) -> str:
    """The place of a plug-in's function, as "module:function"; "" for a built-in."""
    from importlib.metadata import entry_points

    from ...estimators.labels import links_of, split_label
    from ...estimators.registry import ENTRY_POINT_GROUP

    names = links_of(split_label(label)[0])
    found = [point.value for point in entry_points(group=ENTRY_POINT_GROUP) if point.name in names]
    return found[0] if found else ""


def _describe(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"[:500]


class _HouseError(Exception):
    """What the runner itself could not do."""


@contextlib.contextmanager
def _ours(what: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise _HouseError(f"{what}: {_describe(error)}") from error


class _Server:
    """An estimator that carries out jobs, and reports each result."""

    def __init__(self, label: str, tell: Callable[..., None]) -> None:
        self.label, self.tell, self.warm = label, tell, False
        self.call, self.chosen = _bind(label)
        self.stage, self.unfit = self.chosen.stage, self.chosen.unfit

    def serve(self, job: dict[str, Any]) -> bool:
        """Carry out one job; return False if the estimator cannot run on this machine at all."""
        from .estimator_labels import missing_package
        from .house import house_failure

        if reason := _another(self.chosen, job["modality"]):
            self.tell(event="skip", job=job["job"], message=reason)
            return True
        try:
            event = self._answer(job)
        except _HouseError as error:
            self.tell(event="house", job=job["job"], message=str(error))
            return False
        except MemoryError as error:
            self.tell(event="memory", job=job["job"], message=_describe(error))
        except BaseException as error:  # any exception of an estimator, SystemExit included, is a result
            if told := house_failure(error):
                self.tell(event="house", job=job["job"], message=told)
                return False
            absent = "" if self.warm else missing_package(error, _home(self.label))
            if absent:  # reported before the first estimate, for all captures: an estimator cannot choose which to skip
                self.tell(event="refused", message=f"skip: needs the package {absent}")
                return False
            self.tell(event="error", job=job["job"], message=_describe(error))
        else:
            if event:
                self.tell(job=job["job"], **event)
        return True

    def _answer(self, job: dict[str, Any]) -> dict[str, Any]:
        """The event that ends a job, with its times; none for a job that is only a warm-up."""
        from .protocol import open_capture

        with _ours("the capture cannot be read"):
            capture = open_capture(Path(job["input"]), job["condition"])
        # Decided by the declared rig, before the call: an estimator cannot skip captures because of their data.
        if reason := self.unfit(capture):
            return {"event": "skip", "message": reason}
        if not self.warm:
            self.call(capture)
            self.warm = True
        self.tell(event="warm", job=job["job"])
        if job["only_warm"]:
            return {}
        result, figures = _measure(self.call, capture) if job["timed"] else (self.call(capture), {})
        with _ours("the answer cannot be written"):
            wrong = _save(result, Path(job["output"]), self.stage, job["sizes"])
        return ({"event": "invalid", "message": wrong} if wrong else {"event": "done"}) | figures


def main(arguments: list[str]) -> int:
    """Serve jobs until the pipe closes."""
    label, jobs_fd, events_fd = arguments[0], int(arguments[1]), int(arguments[2])
    _die_with_parent()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for fd in (jobs_fd, events_fd):
        os.set_inheritable(fd, False)  # processes that an estimator starts must not keep the pipes open

    def tell(**event: Any) -> None:
        os.write(events_fd, (json.dumps(event) + "\n").encode())

    jobs = os.fdopen(jobs_fd, encoding="utf-8")
    rules = json.loads(jobs.readline() or "{}")
    if rules:  # before anything is imported: the jail holds for threads that are started later only
        from .jail import seal

        seal(read=rules["read"], write=rules["write"])

    from .estimator_labels import missing_package

    try:
        server = _Server(label, tell)
    except BaseException as error:
        absent = missing_package(error, _home(label))
        tell(event="refused", message=f"skip: needs the package {absent}" if absent else _describe(error))
        return 0
    tell(event="started", stage=server.stage.word)
    with jobs:
        for line in jobs:
            if not server.serve(json.loads(line)):
                break
    return 0


if __name__ == "__main__":
    code = main(sys.argv[1:])
    # Every event is sent. Shutting down an interpreter with compiled code takes longer than many estimators.
    os._exit(code)
