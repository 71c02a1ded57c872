"""Times are the parent's: what a child does to its clocks, its caches or its helpers makes it no faster."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from beambench.benchmarks.runner.attempt import STALE
from beambench.benchmarks.runner.namespaces import supervised, works
from beambench.benchmarks.runner.session import Outcome, Session, run_sessions
from beambench.benchmarks.runner.tree import cpu_s, descendants

from .test_benchmarks_runner import LIMITS, spool

#: CPU time that every planted estimator spends on an answer, s.
WORK_S = 0.12

PLANTED = f"""
import hashlib, os, subprocess, sys, time
import numpy as np, xarray as xr
from beambench.estimators import estimator

START = time.process_time
def burn(seconds={WORK_S}):
    end = START() + seconds
    while START() < end:
        pass

def good(capture):
    counts = capture["counts"].values
    value = 2.0 + 1e-3 * counts.astype(float).mean(axis=0) + 1e-6 * np.arange(counts[0].size).reshape(counts[0].shape)
    dims = ("row", "col")
    return xr.Dataset({{"range": (dims, value), "sigma": (dims, np.full(value.shape, 0.1)),
                       "valid": (dims, np.ones(value.shape, bool))}})

def planted(function):
    return estimator("gated", cites="planted")(function)

@planted
def plain(capture):
    burn()
    return good(capture)

@planted
def clocks(capture):
    time.process_time = time.perf_counter = time.monotonic = time.time = lambda: 0.0
    time.clock_gettime = lambda which: 0.0
    burn()
    return good(capture)

KEPT = {{}}
@planted
def by_input(capture):
    key = hashlib.sha256(capture["counts"].values.tobytes()).hexdigest()
    if key not in KEPT:
        burn()
        KEPT[key] = good(capture)
    return KEPT[key]

@planted
def by_rig(capture):
    if "rig" not in KEPT:
        burn()
        KEPT["rig"] = good(capture)
    return KEPT["rig"]

BURN = "import time\\nwhile time.process_time() < {WORK_S}: pass\\n"

def until(path):
    while not os.path.exists(path):
        time.sleep(0.002)
    os.unlink(path)

@planted
def helper(capture):
    # Nobody waits for the helper, so that its time is not that of an ended child.
    subprocess.Popen([sys.executable, "-S", "-c", BURN + "open('tmp/done', 'w')"], start_new_session=True)
    until("tmp/done")
    return good(capture)

@planted
def detached(capture):
    code = "import os\\nif os.fork(): os._exit(0)\\nos.setsid()\\n" + BURN + "open('tmp/done', 'w')"
    subprocess.Popen([sys.executable, "-S", "-c", code], start_new_session=True)
    until("tmp/done")
    return good(capture)

@planted
def after(capture):
    # Says that it is done, and works then.
    import json
    from beambench.benchmarks.runner import child
    save = child._save
    def late(*arguments):
        burn()
        return save(*arguments)
    for module in (child, sys.modules["__main__"]):
        module._save = late
    return good(capture)

@planted
def threads(capture):
    import threading
    one = threading.Thread(target=lambda: burn())
    one.start()
    one.join()
    return good(capture)
"""
NAMES = ("plain", "clocks", "by_input", "by_rig", "helper", "detached", "after", "threads")


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Outcome]]:
    """What became of each planted estimator on one capture."""
    folder = tmp_path_factory.mktemp("clock")
    site = folder / "site"
    (site / "clock-1.0.dist-info").mkdir(parents=True)
    (site / "planted_clock.py").write_text(PLANTED)
    points = "\n".join(f"k-{name.replace('_', '-')} = planted_clock:{name}" for name in NAMES)
    (site / "clock-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: clock\nVersion: 1.0\n")
    (site / "clock-1.0.dist-info" / "entry_points.txt").write_text(f"[beambench.estimators]\n{points}\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(site))
        jobs = spool(folder, 1)
        found: dict[str, Outcome] = {}
        limits = LIMITS.model_copy(update={"time_s": 60.0})
        run_sessions(
            [Session(f"k-{n.replace('_', '-')}", jobs, limits, folder / f"scratch-{n}") for n in NAMES],
            lambda number, outcome: found.update({NAMES[number]: outcome}),
        )
        yield found


@pytest.mark.parametrize("name", [name for name in NAMES if name != "by_rig"])
def test_what_is_spent_is_counted(outcomes: dict[str, Outcome], name: str) -> None:
    """The parent's figure holds the work of every call, less a tick of 10 ms and what saving may take."""
    outcome = outcomes[name]
    assert outcome.status == "ok"
    assert min(outcome.cpu_calls) >= WORK_S - 0.03
    if name != "after":  # its time on the wall passes for a busy disk
        assert min(outcome.wall_calls) >= WORK_S - 0.03


def test_the_answer_to_another_capture_is_refused(outcomes: dict[str, Outcome]) -> None:
    assert outcomes["by_rig"].status == f"invalid: {STALE}"


def test_a_process_knows_its_descendants_and_their_time() -> None:
    import os
    import subprocess
    import sys
    import time

    code = "import time\nwhile time.process_time() < .2: pass\ntime.sleep(60)"
    before = cpu_s(os.getpid())
    child = subprocess.Popen([sys.executable, "-S", "-c", code])
    try:
        until = time.monotonic() + 30
        while cpu_s(child.pid) < 0.19 and time.monotonic() < until:
            time.sleep(0.02)
        assert child.pid in descendants(os.getpid())
        assert cpu_s(os.getpid()) - before >= 0.19
    finally:
        child.kill()
        child.wait()


def test_the_trial_of_namespaces_is_a_plain_answer() -> None:
    assert works() in (True, False)
    assert callable(supervised)
