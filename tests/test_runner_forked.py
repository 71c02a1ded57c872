"""Children that are forked from a prepared process: they are children of the runner, as clean and as jailed as started ones."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

from beambench.benchmarks.laws.gated import clean_capture
from beambench.benchmarks.runner.forked import Forked, Prepared
from beambench.benchmarks.runner.jail import abi
from beambench.benchmarks.runner.namespaces import works
from beambench.benchmarks.runner.process import Child
from beambench.benchmarks.runner.protocol import write_capture, write_meta
from beambench.benchmarks.runner.session import Job, Outcome, Session, run_sessions
from beambench.benchmarks.suites.spec import Limits
from beambench.captures.hide import hide_truth
from beambench.captures.sizes import sizes_of

LABEL = "weighted-average"
LIMITS = Limits(time_s=60.0, warmup_s=200.0, memory_bytes=2**31, output_bytes=2**20)


def spool(folder: Path, count: int) -> list[Job]:
    """Captures that built-in estimators read, all alike."""
    capture, jobs = hide_truth(clean_capture()), []
    for index in range(count):
        place = folder / f"in-{index}"
        write_capture(place, capture)
        write_meta(place, capture, "matched")
        jobs.append(Job(index, place, "matched", "gated", sizes_of(capture)))
    return jobs


@pytest.fixture
def prepared() -> Iterator[Prepared]:
    with Prepared([LABEL, "peak"]) as one:
        yield one


def answers(folder: Path, prepared: Prepared | None, label: str = LABEL) -> list[Outcome]:
    found: list[Outcome] = []
    jobs = spool(folder, 2)
    run_sessions(
        [Session(label, jobs, LIMITS, folder / "scratch", prepared=prepared)], lambda _, one: found.append(one)
    )
    return found


def started(child: Child) -> None:
    """Wait until the estimator is bound."""
    until = time.monotonic() + 60.0
    while not child.waiting and time.monotonic() < until:
        child.read_events()
        time.sleep(0.01)
    assert child.waiting[0] == {"event": "started", "stage": "gated"}


def status_of(pid: int | str) -> dict[str, str]:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return {name: value for name, _, value in (line.partition(":\t") for line in lines)}


def subreaper() -> int:
    value = ctypes.c_int(-1)
    assert ctypes.CDLL(None).prctl(37, ctypes.byref(value), 0, 0, 0) == 0
    return value.value


def test_a_forked_child_answers_as_a_started_one(tmp_path: Path, prepared: Prepared) -> None:
    forked, anew = answers(tmp_path / "a", prepared), answers(tmp_path / "b", None)
    assert [one.status for one in forked] == ["ok", "ok"]
    for one, other in zip(forked, anew, strict=True):
        assert one.arrays.keys() == other.arrays.keys()
        assert all(np.array_equal(one.arrays[name], other.arrays[name], equal_nan=True) for name in one.arrays)
    assert subreaper() == 0  # orphans of others are no business of this process


def test_it_is_a_child_of_the_runner_in_a_session_folder_and_jail_of_its_own(
    tmp_path: Path, prepared: Prepared
) -> None:
    child = Child(LABEL, tmp_path / "work" / "cwd", prepared=prepared)
    try:
        started(child)
        assert isinstance(child.process, Forked)
        top, worker = psutil.Process(child.process.pid), psutil.Process(child.worker())
        assert top.ppid() == os.getpid()
        assert os.getsid(top.pid) == os.getpgid(top.pid) == top.pid
        assert Path(worker.cwd()) == tmp_path / "work" / "cwd"
        # Three standard files, the socket of orders and the pipe of events; nothing of the process that it was forked from.
        held = [os.readlink(f"/proc/{worker.pid}/fd/{fd}") for fd in os.listdir(f"/proc/{worker.pid}/fd")]
        kinds = sorted(name.split(":")[0] for name in held)
        assert kinds == ["/dev/null", "pipe", "pipe", "pipe", "socket"]
        status = status_of(worker.pid)
        if abi():
            assert status["NoNewPrivs"] == "1"
        if works():
            assert len(status["NSpid"].split()) == 1 + len(status_of("self")["NSpid"].split())
            for space in ("net", "ipc", "mnt", "user"):
                assert os.readlink(f"/proc/{worker.pid}/ns/{space}") != os.readlink(f"/proc/self/ns/{space}")
    finally:
        assert child.end(kill=False) == 0
    assert not psutil.pid_exists(child.process.pid)


def test_it_starts_with_a_fraction_of_the_work(tmp_path: Path, prepared: Prepared) -> None:
    spent = []
    for number, source in enumerate((None, prepared, prepared)):
        child = Child(LABEL, tmp_path / f"{number}" / "cwd", prepared=source)
        started(child)
        spent.append(child.cpu_s())
        child.end(kill=True)
    # Some 20 ms against 500: an import that is missing in the prepared process would be found again here.
    assert spent[2] < 0.3 * spent[0], spent


def test_the_prepared_process_holds_no_generator_and_no_scene() -> None:
    code = (
        "import json, os, sys; from beambench.benchmarks.runner.prepared import prepare; "
        "prepare(['poisson-ml', 'spot-ml', 'line-ml', 'waveform-ml', 'amcw-ml']); "
        "print(json.dumps([sorted(sys.modules), len(os.listdir('/proc/self/task'))]))"
    )
    environment = dict(os.environ) | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    told = subprocess.run(
        [sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True, env=environment
    )
    modules, threads = json.loads(told.stdout.splitlines()[-1])
    assert {"numba", "xarray", "pandas"} <= set(modules)
    assert not [name for name in modules if name.startswith(("beambench.generator", "beambench.scenes.library"))]
    assert threads == 1  # a fork of more would be refused


def test_the_exit_of_a_forked_child_is_told(tmp_path: Path, prepared: Prepared) -> None:
    for number, (sent, code) in enumerate(((signal.SIGSEGV, -11), (signal.SIGKILL, -9))):
        child = Child(LABEL, tmp_path / f"{number}" / "cwd", prepared=prepared)
        started(child)
        os.kill(child.worker(), sent)
        assert child.ended(10.0)
        assert child.end(kill=False) == code


def test_without_the_prepared_process_children_are_started(tmp_path: Path, prepared: Prepared) -> None:
    first = Child(LABEL, tmp_path / "0" / "cwd", prepared=prepared)
    assert isinstance(first.process, Forked)
    first.end(kill=True)
    assert prepared._process is not None
    prepared._process.kill()
    prepared._process.wait()
    assert [one.status for one in answers(tmp_path / "a", prepared)] == ["ok", "ok"]


def test_other_variables_are_passed_on_and_those_of_imports_start_anew(
    tmp_path: Path, prepared: Prepared, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DRJIT_CACHE_DIR", str(tmp_path))
    child = Child(LABEL, tmp_path / "0" / "cwd", prepared=prepared)
    assert isinstance(child.process, Forked)
    child.end(kill=True)
    monkeypatch.setenv("NUMBA_OPT", "1")
    child = Child(LABEL, tmp_path / "1" / "cwd", prepared=prepared)
    assert isinstance(child.process, subprocess.Popen)
    child.end(kill=True)


def test_a_plug_in_is_never_forked(tmp_path: Path, prepared: Prepared) -> None:
    """What a plug-in imports is its own, and a name that is no built-in's is a plug-in's."""
    child = Child("x-unknown", tmp_path / "cwd", prepared=prepared)
    assert isinstance(child.process, subprocess.Popen)
    child.end(kill=True)
    with Prepared(["x-unknown"]) as none:
        assert none._process is None


LONELY = """
import os, sys, time
from pathlib import Path
from beambench.benchmarks.runner.forked import Prepared
from beambench.benchmarks.runner.process import Child
prepared = Prepared(["peak"])
child = Child("peak", Path(sys.argv[1]) / "cwd", prepared=prepared)
print(prepared._process.pid, child.process.pid, child.worker(), flush=True)
time.sleep(60)
"""


def test_all_end_with_the_runner(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", LONELY, str(tmp_path)], stdout=subprocess.PIPE, text=True, cwd=tmp_path
    ) as runner:
        assert runner.stdout is not None
        pids = [int(word) for word in runner.stdout.readline().split()]
        assert len(pids) == 3
        runner.kill()
        runner.wait()
    until = time.monotonic() + 10.0
    while any(psutil.pid_exists(pid) for pid in pids) and time.monotonic() < until:
        time.sleep(0.05)
    assert not [pid for pid in pids if psutil.pid_exists(pid)]


def test_a_runner_that_is_the_first_process_of_a_container_has_children(tmp_path: Path) -> None:
    """A child that takes the process 1 for the reaper of orphans would end at once."""
    unshare = ["unshare", "--user", "--map-root-user", "--pid", "--fork", "--mount-proc"]
    if subprocess.run([*unshare, "true"], capture_output=True, check=False).returncode:
        pytest.skip("this user has no namespaces")
    code = (
        "import os, sys; from pathlib import Path; assert os.getpid() == 1;"
        "from tests.test_runner_forked import answers, Prepared, LABEL;\n"
        "with Prepared([LABEL]) as one: print([o.status for o in answers(Path(sys.argv[1]) / 'a', one)]);\n"
        "print([o.status for o in answers(Path(sys.argv[1]) / 'b', None)])"
    )
    root = Path(__file__).parents[1]
    told = subprocess.run(
        [*unshare, sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, cwd=root, check=False
    )
    assert told.stdout.splitlines() == ["['ok', 'ok']"] * 2, told.stderr[-2000:]
