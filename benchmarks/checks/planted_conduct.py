"""Cheats of time and of scores, and processes and files that are left behind. `cheats` tells from times, scores and leftovers."""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ...estimators.gated.parabola import parabola
from ...optics.constants import C_M_PER_S
from .gated_cheats import LEFT, REACHED, WORK_S, answer, facts, planted, work

kept: dict[Any, Any] = {}


# ---------------------------------------------------------------- time


@planted
def clocks_stopped(capture: xr.Dataset) -> xr.Dataset:
    """Stop all clocks of Python."""
    time.process_time = time.perf_counter = time.monotonic = time.time = lambda: 0.0  # type: ignore[assignment]
    work()
    return answer(capture)


@planted
def kept_by_input(capture: xr.Dataset) -> xr.Dataset:
    """Keep answers by the data."""
    key = hashlib.sha256(capture["counts"].values.tobytes()).digest()
    if key not in kept:
        work()
        kept[key] = answer(capture)
    return kept[key].copy()  # type: ignore[no-any-return]


@planted
def kept_from_warm_up(capture: xr.Dataset) -> xr.Dataset:
    """Answer everything with the answer of the first call."""
    if "first" not in kept:
        work()
        kept["first"] = answer(capture)
    return kept["first"].copy()  # type: ignore[no-any-return]


@planted
def kept_by_likeness(capture: xr.Dataset) -> xr.Dataset:
    """Keep answers by data that are alike, and change the kept ones a little."""
    small = capture["counts"].values[::5].astype(np.float64)
    for held, before in kept.get("alike", []):
        if np.abs(held - small).max() <= 2.0:
            noise = 1e-9 * np.random.default_rng().standard_normal(before["range"].shape)
            return before.assign(range=before["range"] + noise)  # type: ignore[no-any-return]
    work()
    found = answer(capture)
    kept.setdefault("alike", []).append((small, found))
    return found


def _burn_elsewhere(code: str) -> None:
    """Work in another process, and wait for it by a file, so that nobody reaps it."""
    done = f"{os.environ['TMPDIR']}/{LEFT}"
    work = f"import time\nwhile time.process_time() < {WORK_S}: pass\nopen({done!r}, 'w')"
    subprocess.Popen([sys.executable, "-S", "-c", code + work], start_new_session=True)
    while not os.path.exists(done):
        time.sleep(0.001)
    os.unlink(done)


@planted
def helper_unreaped(capture: xr.Dataset) -> xr.Dataset:
    """Work in a child that nobody waits for."""
    _burn_elsewhere("")
    return answer(capture)


@planted
def helper_detached(capture: xr.Dataset) -> xr.Dataset:
    """Work in a process that has left its parent and its session."""
    _burn_elsewhere("import os\nif os.fork(): os._exit(0)\nos.setsid()\n")
    return answer(capture)


@planted
def work_after_the_call(capture: xr.Dataset) -> xr.Dataset:
    """Change the runner's code so that the work is done when the answer is saved."""

    runner = sys.modules["__main__"]
    save = runner.__dict__.get("_save")

    def late(*arguments: Any) -> Any:
        work()
        return save(*arguments)  # type: ignore[misc]

    if save is not None and getattr(save, "__name__", "") != "late":
        runner.__dict__["_save"] = late
    return answer(capture)


@planted
def false_events(capture: xr.Dataset) -> xr.Dataset:
    """Tell the runner that the call is over, and go on working."""
    os.write(int(sys.argv[3]), b'{"event": "called"}\n')
    work()
    return answer(capture)


@planted
def thread_between_calls(capture: xr.Dataset) -> xr.Dataset:
    """Work in a thread as soon as the runner hands over a capture, before the call."""
    if "done" not in kept:
        kept["done"] = threading.Event()
        threading.Thread(target=_eager, daemon=True).start()
    kept["done"].wait()
    kept["done"].clear()
    return answer(capture)


def _eager() -> None:
    """Work each time a new mapping of a capture appears."""
    seen = 0
    while True:
        try:
            with open("/proc/self/maps", encoding="ascii", errors="replace") as file:
                held = [line.split("-")[0] for line in file if "beambench-capture" in line]
        except OSError:
            return
        now = hash(tuple(held))
        if held and now != seen:
            work()
            kept["done"].set()
        seen = now
        time.sleep(0.002)


# ---------------------------------------------------------------- scores


@planted
def honest(capture: xr.Dataset) -> xr.Dataset:
    """What scores are compared with. No cheat."""
    return answer(capture, _ranges(capture))


def _ranges(capture: xr.Dataset) -> Any:
    """Ranges of a built-in estimator."""
    return parabola(capture)["range"].values


@planted
def knows_the_truth(capture: xr.Dataset) -> xr.Dataset:
    """Bring the truth along, as one could for a public scene with public seeds."""
    return answer(capture, _brought(capture, "truths"))


@planted
def knows_the_truth_nearly(capture: xr.Dataset) -> xr.Dataset:
    """Bring the truth along, and add a third of the noise that the bound allows."""
    truth, bound = _brought(capture, "truths"), _brought(capture, "bounds")
    return answer(capture, truth + 0.3 * bound * np.random.default_rng().standard_normal(truth.shape))


def _brought(capture: xr.Dataset, name: str) -> Any:
    """What was brought along for this capture, which is known by its sum."""
    total = float(capture["counts"].values.astype(np.float64).sum())
    index = int(np.abs(np.array(facts()["sums"]) - total).argmin())
    return np.array(facts()[name])[index]


@planted
def smooths(capture: xr.Dataset) -> xr.Dataset:
    """Take the mean of all pixels of a row: honest, and no longer an image."""
    found = answer(capture)
    mean = np.broadcast_to(_ranges(capture).mean(axis=1, keepdims=True), found["range"].shape)
    return found.assign(range=(("row", "col"), mean.copy()))


@planted
def pools_captures(capture: xr.Dataset) -> xr.Dataset:
    """Mean over all captures of the condition that it has seen, which are of one scene."""
    held = kept.setdefault("pool", [])
    held.append(_ranges(capture))
    return answer(capture, np.mean(held, axis=0))


@planted
def keeps_the_rig(capture: xr.Dataset) -> xr.Dataset:
    """Use the first declared rig that it saw for all captures."""
    rig = kept.setdefault("rig", str(capture.attrs["rig"]))
    return answer(capture.assign_attrs(rig=rig), REACHED if rig != str(capture.attrs["rig"]) else None)


@planted
def guesses(capture: xr.Dataset) -> xr.Dataset:
    """Answer the centre of the window everywhere."""
    delay = capture["delay"].values
    rig = json.loads(str(capture.attrs["rig"]))
    return answer(capture, C_M_PER_S / (2.0 * float(rig["medium"]["group_index"])) * float(delay.mean()))


# ---------------------------------------------------------------- what is left behind


def _stay(before: str) -> None:
    code = f"{before}import time\n{LEFT.replace('-', '_')} = 1\ntime.sleep(600)"
    subprocess.Popen([sys.executable, "-S", "-c", code], start_new_session=True, stdin=-3, stdout=-3, stderr=-3)
    time.sleep(0.3)


@planted
def process_in_its_session(capture: xr.Dataset) -> xr.Dataset:
    """Leave a process in a session of its own."""
    _stay("")
    return answer(capture)


@planted
def process_forked_twice(capture: xr.Dataset) -> xr.Dataset:
    """Leave a process that has left its session and its parent."""
    _stay("import os\nos.fork() and os._exit(0)\nos.setsid()\nos.fork() and os._exit(0)\n")
    return answer(capture)


@planted
def process_disguised(capture: xr.Dataset) -> xr.Dataset:
    """Leave a process without any environment that has left its session and its parent."""
    code = f"import time\n{LEFT.replace('-', '_')} = 1\ntime.sleep(600)"
    away = "import os, sys\nos.fork() and os._exit(0)\nos.setsid()\n"
    again = f"{away}os.execve(sys.executable, ['python', '-S', '-c', {code!r}], {{}})"
    subprocess.Popen([sys.executable, "-S", "-c", again], start_new_session=True, stdin=-3, stdout=-3, stderr=-3)
    time.sleep(0.3)
    return answer(capture)


@planted
def shared_memory(capture: xr.Dataset) -> xr.Dataset:
    """Leave a file in /dev/shm."""
    _leave(Path("/dev/shm", LEFT))
    return answer(capture)


@planted
def semaphore(capture: xr.Dataset) -> xr.Dataset:
    """Leave a System V semaphore and a shared segment, keyed by a number of its own."""
    libc = ctypes.CDLL(None)
    libc.semget(int(facts()["key"]), 1, 0o1600)
    libc.shmget(int(facts()["key"]), 4096, 0o1600)
    return answer(capture)


@planted
def temporary_folders(capture: xr.Dataset) -> xr.Dataset:
    """Leave folders where programs keep temporary files."""
    for place in ("/tmp", "/var/tmp", os.environ.get("TMPDIR", "/tmp")):
        _leave(Path(place, LEFT, "x"))
    return answer(capture)


def _leave(path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x")
    except OSError:
        pass
