"""A process that times calls of one version of the code. Started by `sides` as a file, so that any version can be on its path:

    python -P worker.py [CPU]

With CPU, a number, it runs on that core only. Commands arrive as lines of JSON on standard input, and each is answered by one
line on the standard output that the process was started with; what the timed code prints goes nowhere. It uses these names of
the version that it times, and no others: `estimators.registry.get_estimator`, `estimators.labels.parse_label`,
`scenes.load.load_scene`, `generator.generate.generate`.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

__all__ = ["main"]

Call = Callable[[], Any]


def _capture(folder: Path, condition: str) -> Any:
    """The capture that the runner would give to an estimator, its arrays mapped read-only."""
    import numpy as np
    import xarray as xr

    meta = json.loads((folder / f"meta-{condition}.json").read_text(encoding="utf-8"))
    data: dict[str, Any] = {}
    coords: dict[str, Any] = {}
    for name, entry in meta["variables"].items():
        array = np.load(folder / f"{name}.npy", mmap_mode="r", allow_pickle=False).view(np.ndarray)
        (coords if entry["coordinate"] else data)[name] = (entry["dims"], array, entry["attrs"])
    return xr.Dataset(data, coords=coords, attrs=meta["attrs"])


def _home(function: Any) -> str:
    """The file that holds a function."""
    inner = getattr(function, "__wrapped__", function)
    return getattr(sys.modules.get(getattr(inner, "__module__", "")), "__file__", "") or ""


def _estimate(asked: dict[str, Any]) -> tuple[Call, list[str]]:
    """The call of an estimator on a capture, and the files that hold it, one for each link of a chain."""
    name, params = import_module("beambench.estimators.labels").parse_label(asked["label"])
    get = import_module("beambench.estimators.registry").get_estimator
    call = partial(get(name).function, _capture(Path(asked["folder"]), asked["condition"]), **params)
    return call, [_home(get(link).function) for link in name.split("+")]


def _render(asked: dict[str, Any]) -> tuple[Call, list[str]]:
    """The call that generates a capture of a scene, and the file of the generator."""
    module = import_module("beambench.generator.generate")
    scene = import_module("beambench.scenes.load").load_scene(asked["scene"])
    call = partial(module.generate, scene, seed=asked["seed"], fidelity=asked["fidelity"], rtol=asked["rtol"])
    return call, [str(module.__file__)]


def _timed(call: Call, count: int) -> list[float]:
    """CPU time of each of `count` calls, s. The collector of cyclic garbage does not run inside."""
    gc.collect()
    gc.disable()
    spent = []
    try:
        for _ in range(count):
            begun = time.process_time()
            call()
            spent.append(time.process_time() - begun)
        return spent
    finally:
        gc.enable()


def _repeated(call: Call, times: int) -> Call:
    """`times` calls as one."""

    def all_of_them() -> None:
        for _ in range(times):
            call()

    return call if times == 1 else all_of_them


def _answer(asked: dict[str, Any], calls: dict[int, Call]) -> dict[str, Any]:
    number = int(asked["id"])
    if asked["do"] == "open":
        call, homes = (_render if asked["kind"] == "render" else _estimate)(asked)
        call()  # compiles, and fills caches
        calls[number] = _repeated(call, int(asked.get("repeat", 1)))
        gc.collect()
        gc.freeze()  # what stays is not looked at again: a collection before each turn is then short
        return {"homes": homes, "cpu_s": _timed(calls[number], 1)}
    return {"cpu_s": _timed(calls[number], int(asked["count"]))}


def main() -> int:
    """Answer commands until the pipe closes."""
    if len(sys.argv) > 1 and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {int(sys.argv[1])})
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    calls: dict[int, Call] = {}
    for line in sys.stdin:
        try:
            told = _answer(json.loads(line), calls)
        except BaseException as error:  # whatever the timed code raises is an answer
            told = {"error": f"{type(error).__name__}: {error}"[:500]}
        answers.write(json.dumps(told) + "\n")
        answers.flush()
    return 0


if __name__ == "__main__":
    code = main()
    os._exit(code)
