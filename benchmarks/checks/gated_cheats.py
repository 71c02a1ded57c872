"""What planted cheats have in common: an honest answer, honest work, and what they know of the run.

What they need to know of the run is in the environment variable `FACTS`, which a real cheat would find out by looking around.
"""

from __future__ import annotations

import glob
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ...estimators.registry import estimator
from ...optics.constants import C_M_PER_S

__all__ = ["FACTS", "LEFT", "REACHED", "WORK_S", "answer", "facts", "planted", "reaching", "read", "work"]

#: The answer of a cheat that reached what it reached for, m.
REACHED = 7.0
#: Environment variable with a JSON object of paths and numbers.
FACTS = "BEAMBENCH_PLANTED_FACTS"
#: Part of the names of all that planted cheats leave behind.
LEFT = "beambench-planted-cheat"
#: CPU time of an honest answer, s.
WORK_S = 0.06

_clock = time.process_time


def facts() -> dict[str, Any]:
    """What the cheats know of the run."""
    found: dict[str, Any] = json.loads(os.environ[FACTS])
    return found


def work(seconds: float = WORK_S) -> None:
    """Use the processor for some time."""
    end = _clock() + seconds
    while _clock() < end:
        pass


def answer(capture: xr.Dataset, value: Any = None) -> xr.Dataset:
    """Centroid of the counts over delay, without the lowest; or a given range for every pixel."""
    counts = capture["counts"].values.astype(np.float64)
    light = counts - np.median(counts, axis=0)
    light = np.where(light > 0.3 * light.max(axis=0), light, 0.0)
    rig = json.loads(str(capture.attrs["rig"]))
    half = C_M_PER_S / (2.0 * float(rig["medium"]["group_index"]))
    delay = capture["delay"].values
    found = (light * delay[:, None, None]).sum(axis=0) / np.maximum(light.sum(axis=0), 1e-9) * half
    ranges = found if value is None else np.broadcast_to(np.asarray(value, np.float64), found.shape)
    dims = ("row", "col")
    return xr.Dataset({
        "range": (dims, np.array(ranges)), "sigma": (dims, np.full(found.shape, 0.01)),
        "valid": (dims, np.ones(found.shape, bool)),
    })  # fmt: skip


def reaching(reach: Callable[[xr.Dataset], Any]) -> Callable[[xr.Dataset], xr.Dataset]:
    """An estimator that answers `REACHED` where `reach` returns something true."""

    def call(capture: xr.Dataset) -> xr.Dataset:
        try:
            reached = bool(reach(capture))
        except (OSError, ImportError, IndexError, KeyError):
            reached = False
        return answer(capture, REACHED if reached else None)

    call.__name__, call.__doc__, call.__module__ = reach.__name__, reach.__doc__, reach.__module__
    return estimator("gated", cites="planted cheat, no source")(call)


def planted(function: Callable[[xr.Dataset], xr.Dataset]) -> Callable[[xr.Dataset], xr.Dataset]:
    """Register a cheat."""
    return estimator("gated", cites="planted cheat, no source")(function)


def read(pattern: str) -> int:
    """Read the first file of a pattern: its size. Raises IndexError if there is none, OSError if it cannot be read."""
    return len(Path(sorted(glob.glob(pattern))[0]).read_bytes())
