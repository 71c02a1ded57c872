"""One estimator in its own process: gets captures, calls the estimator, writes the estimates. Started by `runner`.

    python -P -m beambench.benchmarks.runner.child LABEL JOBS_FD EVENTS_FD RUNNER_PID

or forked from a process that has imported the same (`prepared`). Orders arrive as lines of JSON on a socket, a capture as a
handle with its order, and events are sent on a pipe; standard output belongs to the estimator. Neither the truth nor the
location of any capture is sent to this process, and no time is measured here: the runner reads the clocks when this process
says "ready" and "called", and this process waits for it at both.

    order                      events
    job, handle of a warm-up   started (once), warm or why not, idle
    call, handle               ready
    go                         called
    keep                       done or invalid
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import json
import os
import resource
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from .namespaces import supervised

__all__ = ["bind", "die_with", "main"]


def die_with(runner: int) -> None:
    """Make Linux end this process when the runner, its parent, ends for any reason; the runner may be the first of a container."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, int(signal.SIGKILL), 0, 0, 0)  # PR_SET_PDEATHSIG = 1
        if os.getppid() != runner:
            os._exit(1)


def _rest(*, keep: bool) -> None:
    """Return freed memory to the system, so that the peak of a call is its own.

    keep: whether what is left (modules, compiled code) is not searched again: to search it takes longer than many calls.
    """
    gc.collect()
    if keep:
        gc.freeze()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:  # glibc only: with other allocators freed pages stay in the baseline
        trim(0)


def _touch(capture: Any) -> None:
    """Read every page of the input, so that no call includes the time in which the pages are mapped."""
    for variable in capture.variables.values():
        if variable.values.size and variable.dtype.kind in "fiub":
            variable.values.max()


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


def bind(label: str) -> tuple[Callable[[Any], Any], Any]:
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
    from ...estimators.labels import links_of, split_label
    from ...estimators.points import plugin_points

    names = links_of(split_label(label)[0])
    found = [point.value for point in plugin_points() if point.name in names]
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


class _Orders:
    """Lines of JSON from a socket, and the handle that came with each."""

    def __init__(self, link: socket.socket) -> None:
        self.link, self.text, self.handles = link, b"", list[int]()

    def next(self) -> tuple[dict[str, Any], int]:
        """The next order, {} at the end, and its handle, -1 if it has none."""
        while b"\n" not in self.text:
            data, handles, _, _ = socket.recv_fds(self.link, 1 << 16, 4)
            self.handles += handles
            if not data:
                return {}, -1
            self.text += data
        line, _, self.text = self.text.partition(b"\n")
        order = json.loads(line)
        return order, self.handles.pop(0) if order.get("handle") else -1


def _capture(handle: int) -> Any:
    from .sealed import unpack

    try:
        return unpack(handle)
    finally:
        os.close(handle)


class _Server:
    """An estimator that carries out orders, and reports each result."""

    def __init__(self, label: str, tell: Callable[..., None], orders: _Orders) -> None:
        self.label, self.tell, self.orders, self.warm = label, tell, orders, False
        self.rested = False
        self.call, self.chosen = bind(label)
        self.stage, self.unfit = self.chosen.stage, self.chosen.unfit

    def serve(self) -> bool:
        """Carry out one order; return False at the end, or if the estimator cannot run on this machine at all."""
        from .estimator_labels import missing_package
        from .house import house_failure

        order, handle = self.orders.next()
        if not order:
            return False
        try:
            self._begin(order, handle) if "job" in order else self._answer(order, handle)
        except _HouseError as error:
            self.tell(event="house", message=str(error))
            return False
        except MemoryError as error:
            self.tell(event="memory", message=_describe(error))
        except BaseException as error:  # any exception of an estimator, SystemExit included, is a result
            if told := house_failure(error):
                self.tell(event="house", message=told)
                return False
            absent = "" if self.warm else missing_package(error, _home(self.label))
            if absent:  # reported before the first estimate, for all captures: an estimator cannot choose which to skip
                self.tell(event="refused", message=f"skip: needs the package {absent}")
                return False
            self.tell(event="error", message=_describe(error))
        return True

    def _begin(self, order: dict[str, Any], handle: int) -> None:
        """Decide whether a capture can be read, and warm up with other data of its kind."""
        from ...optics.jit import compiling

        if reason := _another(self.chosen, order["modality"]):
            os.close(handle)
            self.tell(event="skip", message=reason)
            return
        with _ours("the capture cannot be read"):
            capture = _capture(handle)
        # Decided by the declared rig, before the call: an estimator cannot skip captures because of their data.
        if reason := self.unfit(capture):
            self.tell(event="skip", message=reason)
            return
        if not self.warm:
            # What an estimator thinks of data that are drawn from a few elements is no result: the first call tells.
            with contextlib.suppress(Exception), compiling():
                self.call(capture)
                self.warm = True
        self.tell(event="warm", warm=self.warm)
        del capture
        _rest(keep=self.warm and not self.rested)
        self.rested = self.rested or self.warm
        self.tell(event="idle")

    def _answer(self, order: dict[str, Any], handle: int) -> None:
        """Get a capture, call the estimator when told to, and write its answer when told to."""
        with _ours("the capture cannot be read"):
            capture = _capture(handle)
            _touch(capture)
        self.tell(event="ready")
        self.orders.next()
        result = self.call(capture)
        self.tell(event="called")
        self.warm = True
        self.orders.next()
        with _ours("the answer cannot be written"):
            wrong = _save(result, Path(order["output"]), self.stage, order["sizes"])
        self.tell(**({"event": "invalid", "message": wrong} if wrong else {"event": "done"}))


def main(arguments: list[str]) -> int:
    """Carry out orders until the socket closes."""
    label, jobs_fd, events_fd = arguments[0], int(arguments[1]), int(arguments[2])
    die_with(int(arguments[3]))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for fd in (jobs_fd, events_fd):
        os.set_inheritable(fd, False)  # processes that an estimator starts must not keep the pipes open

    def tell(**event: Any) -> None:
        os.write(events_fd, (json.dumps(event) + "\n").encode())

    orders = _Orders(socket.socket(fileno=jobs_fd))
    rules, _ = orders.next()
    # Before anything is imported: both hold only for what is started later.
    supervised(own=bool(rules.get("own")), close=(jobs_fd, events_fd, 1, 2))
    if rules.get("read"):
        from .jail import seal

        seal(read=rules["read"], write=rules["write"])

    from .estimator_labels import missing_package

    try:
        server = _Server(label, tell, orders)
    except BaseException as error:
        absent = missing_package(error, _home(label))
        tell(event="refused", message=f"skip: needs the package {absent}" if absent else _describe(error))
        return 0
    tell(event="started", stage=server.stage.word)
    while server.serve():
        pass
    return 0


if __name__ == "__main__":
    code = main(sys.argv[1:])
    # Every event is sent. Shutting down an interpreter with compiled code takes longer than many estimators.
    os._exit(code)
