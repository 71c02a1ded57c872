"""The runner: every failure of an estimator stays in its child process and becomes a status, and the run continues."""

from __future__ import annotations

import json
import math
import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.benchmarks.runner.house import machine_failure
from beambench.benchmarks.runner.protocol import (
    THREAD_VARIABLES,
    file_sums,
    read_results,
    write_capture,
    write_meta,
)
from beambench.benchmarks.runner.sealed import block, unpack
from beambench.benchmarks.runner.session import Job, Outcome, run_jobs
from beambench.benchmarks.suites.spec import Limits
from beambench.captures.layouts import stage_of
from beambench.scenes.errors import InputError

ROWS, COLS, SLICES = 6, 5, 8

PLANTED = """
import os, signal, sys, time, gc
import numpy as np, xarray as xr
from beambench.estimators import estimator

def good(capture, value=2.0):
    shape = capture["counts"].shape[1:]
    dims = ("row", "col")
    return xr.Dataset({"range": (dims, np.full(shape, value)), "sigma": (dims, np.full(shape, 0.1)),
                       "valid": (dims, np.ones(shape, bool))})

def planted(function):
    return estimator("gated", cites="planted")(function)

@planted
def fine(capture, *, value: float = 2.0):
    return good(capture, value)

@planted
def segfault(capture):
    os.kill(os.getpid(), signal.SIGSEGV)

@planted
def leave(capture):
    os._exit(3)

@planted
def hang(capture):
    time.sleep(1000)

@planted
def hog(capture):
    held = []
    while True:
        held.append(np.ones(4_000_000))
        time.sleep(0.005)

@planted
def hog_in_grandchild(capture):
    import subprocess
    subprocess.run([sys.executable, "-c",
                    "import time\\nx=[]\\nwhile True:\\n x.append(bytearray(32_000_000)); time.sleep(.02)"],
                   start_new_session=True)

@planted
def raises(capture):
    raise RuntimeError("planted: no light\\nsecond line")

@planted
def full_disk(capture):
    import errno
    raise OSError(errno.ENOSPC, "No space left on device", "/tmp/x")

@planted
def broken_cache(capture):
    import numba.core.caching as caching
    place = compile("def load(): raise EOFError('Ran out of input')", caching.__file__, "exec")
    names = {}
    exec(place, names)
    try:
        names["load"]()
    except EOFError as error:
        raise RuntimeError("no kernel") from error

@planted
def quits(capture):
    sys.exit(5)

@planted
def wrong_shape(capture):
    return good(capture).isel(row=slice(0, 3))

@planted
def transposed(capture):
    return good(capture).transpose("col", "row")

@planted
def no_dataset(capture):
    return np.zeros(3)

@planted
def nan_valid(capture):
    result = good(capture)
    result["range"][0, 0] = np.nan
    return result

@planted
def absurd(capture):
    result = good(capture)
    result["range"][0, 0] = 1e155
    return result

@planted
def tiny_sigma(capture):
    result = good(capture)
    result["sigma"][0, 0] = 1e-200
    return result

@planted
def bad_sigma(capture):
    result = good(capture)
    result["sigma"][1, 1] = np.inf
    return result

@planted
def objects(capture):
    result = good(capture)
    result["range"] = (("row", "col"), np.full(capture["counts"].shape[1:], "x", dtype=object))
    return result

@planted
def floods(capture):
    for _ in range(4096):
        print("x" * 4096)
    return good(capture)

@planted
def writes_input(capture):
    values = capture["counts"].values
    try:
        values.flags.writeable = True
    except ValueError:
        pass
    values[0, 0, 0] = 7
    return good(capture)

@planted
def closes_pipes(capture):
    os.closerange(3, 64)
    time.sleep(1000)

@planted
def seeks_truth(capture):
    found = [name for name in capture.variables if "truth" in name] + [k for k in capture.attrs if "truth" in k]
    seen = [o for o in gc.get_objects() if isinstance(o, xr.Dataset) and any("truth" in str(n) for n in o.variables)]
    text = " ".join(os.environ.values()) + " ".join(sys.argv) + os.getcwd()
    result = good(capture, 1.0 + len(found) + len(seen) + ("SECRET-STORE" in text))
    return result

@planted
def threads(capture):
    import numba
    return good(capture, float(numba.get_num_threads() + int(os.environ["OMP_NUM_THREADS"]) - 1))
"""


@pytest.fixture
def plugins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A third-party package with the planted estimators, installed by its entry points."""
    site = tmp_path / "site"
    (site / "planted-1.0.dist-info").mkdir(parents=True)
    (site / "planted_estimators.py").write_text(PLANTED)
    names = [line[4:].split("(")[0] for line in PLANTED.splitlines() if line.startswith("def ")]
    points = "\n".join(
        f"x-{n.replace('_', '-')} = planted_estimators:{n}" for n in names if n not in ("good", "planted")
    )
    (site / "planted-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: planted\nVersion: 1.0\n")
    (site / "planted-1.0.dist-info" / "entry_points.txt").write_text(f"[beambench.estimators]\n{points}\n")
    monkeypatch.syspath_prepend(str(site))
    return site


def hidden_capture(seed: int = 0) -> xr.Dataset:
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, 1000, (SLICES, ROWS, COLS)).astype(np.uint16)
    coords = {
        "delay": ("slice", np.arange(SLICES) * 1e-9, {"units": "s", "long_name": "delay"}),
        "laser_on": ("slice", np.ones(SLICES, bool)),
    }
    data = {"counts": (("slice", "row", "col"), counts, {"units": "DN", "long_name": "counts"})}
    return xr.Dataset(data, coords, {"schema_version": 1, "modality": "gated", "rig": json.dumps({"schema": 1})})


def spool(folder: Path, count: int = 2) -> list[Job]:
    jobs = []
    for index in range(count):
        place = folder / f"in-{index}"
        capture = hidden_capture(index)
        write_capture(place, capture)
        write_meta(place, capture, "matched")
        jobs.append(Job(index, place, "matched", "gated", {"row": ROWS, "col": COLS}))
    return jobs


LIMITS = Limits(time_s=1.0, warmup_s=20.0, memory_bytes=700 * 2**20, output_bytes=2**20)


def run(label: str, folder: Path, limits: Limits = LIMITS, count: int = 2) -> list[Outcome]:
    outcomes: list[Outcome] = []
    run_jobs(label, spool(folder, count), limits, folder / "scratch", outcomes.append)
    assert [outcome.job.index for outcome in outcomes] == list(range(count))
    return outcomes


def test_a_good_estimator_gives_arrays_times_and_memory(plugins: Path, tmp_path: Path) -> None:
    for outcome in run("x-fine[value=3.5]", tmp_path):
        assert outcome.status == "ok"
        assert np.all(outcome.arrays["range"] == 3.5)
        assert outcome.arrays["valid"].all()
        assert 0 < outcome.wall_s < 1
        assert 0 <= outcome.cpu_s < 1
        assert outcome.peak_bytes >= 0


@pytest.mark.parametrize(
    ("name", "status"),
    [
        ("segfault", "crash:SIGSEGV"),
        ("leave", "crash:exit 3"),
        ("raises", "error: RuntimeError: planted: no light second line"),
        ("quits", "error: SystemExit: 5"),
        ("wrong-shape", "invalid: range has shape (3, 5), not (6, 5)"),
        ("transposed", "invalid: range has dims ('col', 'row'), not ('row', 'col')"),
        ("no-dataset", "invalid: returned ndarray, not a Dataset"),
        ("nan-valid", "invalid: range is not finite at 1 elements marked valid"),
        ("absurd", "invalid: range is beyond 1e+30 at 1 elements marked valid"),
        ("tiny-sigma", "invalid: sigma is not finite and positive at 1 elements marked valid"),
        ("bad-sigma", "invalid: sigma is not finite and positive at 1 elements marked valid"),
        ("objects", "invalid: range is of type object"),
        ("floods", "flood: printed over 1048576 bytes"),
        ("closes-pipes", "crash: closed its pipes"),
        ("fine[nonsense=1]", "error: InputError: Estimator x-fine was given an unknown parameter"),
        ("unheard-of", "error: InputError: There is no such estimator"),
    ],
)
def test_each_misdeed_is_a_status(plugins: Path, tmp_path: Path, name: str, status: str) -> None:
    # Two captures where the child has to be started again, one elsewhere: each start costs a second.
    for outcome in run(f"x-{name}", tmp_path, count=2 if name in ("segfault", "raises", "floods") else 1):
        assert outcome.status.startswith(status)
        assert not outcome.arrays


@pytest.mark.parametrize(
    ("name", "told"), [("x-full-disk", "No space left"), ("x-broken-cache", "cache of compiled kernels")]
)
def test_a_failure_of_the_machine_ends_the_run_and_is_no_status(
    plugins: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, told: str
) -> None:
    """It was "error: …" before, which counts as 100 % failed pixels of the estimator. The runner finds it so too."""
    monkeypatch.setattr("beambench.benchmarks.runner.attempt.machine_failure", lambda folder: "no space")
    outcomes: list[Outcome] = []
    with pytest.raises(InputError, match=told) as caught:
        run_jobs(name, spool(tmp_path), LIMITS, tmp_path / "scratch", outcomes.append)
    assert not outcomes
    assert "not the estimator" in caught.value.what and name in str(caught.value.where)


@pytest.mark.parametrize(("name", "told"), [("x-full-disk", "OSError: [Errno 28]"), ("x-broken-cache", "cache of")])
def test_a_plugins_word_that_the_machine_failed_is_its_own_error(
    plugins: Path, tmp_path: Path, name: str, told: str
) -> None:
    """One that only says so ended everybody's run."""
    outcomes = run(name, tmp_path)
    assert len(outcomes) == 2 and all(outcome.status.startswith(f"error: {told}") for outcome in outcomes)


def test_the_runner_finds_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    assert machine_failure(tmp_path / "new") == ""
    (tmp_path / "file").write_text("")
    assert machine_failure(tmp_path / "file").startswith("FileExistsError")
    if os.path.exists("/dev/full"):
        assert machine_failure(Path("/proc"))


def test_a_spool_that_cannot_be_read_is_a_failure_of_the_machine(plugins: Path, tmp_path: Path) -> None:
    jobs = spool(tmp_path)
    (jobs[1].folder / "counts.npy").unlink()
    outcomes: list[Outcome] = []
    with pytest.raises(InputError, match="cannot be read"):
        run_jobs("x-fine", jobs, LIMITS, tmp_path / "scratch", outcomes.append)
    assert [outcome.status for outcome in outcomes] == ["ok"]


@pytest.mark.parametrize("stage", ["[]", "{}", "7", "null", '"no-such-stage"'])
def test_a_stage_that_is_no_word_is_a_crash(plugins: Path, tmp_path: Path, stage: str) -> None:
    """A list ended everybody's run: it was looked up among the stages. Written as the plug-in is imported."""
    source = plugins / "planted_estimators.py"
    event = json.dumps('{"event": "started", "stage": ' + stage + "}\n")
    source.write_text(f"import os, sys\nos.write(int(sys.argv[3]), {event}.encode())\n" + PLANTED)
    assert [outcome.status for outcome in run("x-fine", tmp_path, count=1)] == ["crash: broken events"]


def test_a_hang_is_killed_with_its_group_and_the_rest_goes_on(plugins: Path, tmp_path: Path) -> None:
    start = time.monotonic()
    outcomes = run("x-hang", tmp_path, Limits(time_s=0.3, warmup_s=2.5, memory_bytes=2**30))
    assert [outcome.status for outcome in outcomes] == ["timeout: warm-up over 2.5 s"] * 2
    assert time.monotonic() - start < 12


@pytest.mark.parametrize("name", ["x-hog", "x-hog-in-grandchild"])
def test_memory_is_limited_with_descendants(plugins: Path, tmp_path: Path, name: str) -> None:
    import psutil

    (outcome,) = run(name, tmp_path, Limits(time_s=20.0, warmup_s=20.0, memory_bytes=500 * 2**20), count=1)
    assert outcome.status == "memory: over 500 MiB resident"
    left = [p for p in psutil.Process().children(recursive=True) if p.status() != psutil.STATUS_ZOMBIE]
    assert not left


def test_an_input_is_read_only_and_the_next_capture_is_served(plugins: Path, tmp_path: Path) -> None:
    before = [file_sums(job.folder) for job in spool(tmp_path / "same")]
    outcomes: list[Outcome] = []
    jobs = spool(tmp_path)
    run_jobs("x-writes-input", jobs, LIMITS, tmp_path / "scratch", outcomes.append)
    assert all(
        outcome.status.startswith("error: ValueError: assignment destination is read-only") for outcome in outcomes
    )
    assert [file_sums(job.folder) for job in jobs] == before


def test_a_child_holds_no_truth(plugins: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (outcome,) = run("x-seeks-truth", tmp_path, count=1)
    assert outcome.status == "ok"
    assert np.all(outcome.arrays["range"] == 1.0)


def test_threads_are_pinned_before_import(plugins: Path, tmp_path: Path) -> None:
    assert {"OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"} <= set(THREAD_VARIABLES)
    (outcome,) = run("x-threads", tmp_path, count=1)
    assert np.all(outcome.arrays["range"] == 1.0)


def test_a_capture_with_truth_is_refused_by_the_protocol(tmp_path: Path) -> None:
    capture = hidden_capture()
    capture["truth_range"] = (("row", "col"), np.ones((ROWS, COLS)))
    with pytest.raises(ValueError, match="truth_range"):
        write_capture(tmp_path / "x", capture)
    assert not (tmp_path / "x").exists()
    with pytest.raises(ValueError, match="truth_scene"):
        write_capture(tmp_path / "x", hidden_capture().assign_attrs(truth_scene="{}"))


def test_captures_survive_the_protocol_bit_for_bit(tmp_path: Path) -> None:
    capture = hidden_capture(3)
    write_capture(tmp_path / "x", capture)
    write_meta(tmp_path / "x", capture, "matched")
    handle = block(tmp_path / "x", "matched")
    again = unpack(handle)
    os.close(handle)
    xr.testing.assert_identical(capture, again)
    assert not again["counts"].values.flags.writeable
    with pytest.raises(ValueError, match="WRITEABLE"):
        again["counts"].values.flags.writeable = True


def test_results_are_never_unpickled(tmp_path: Path) -> None:
    class Bomb:
        def __reduce__(self) -> Any:
            return os.kill, (os.getpid(), signal.SIGKILL)

    for name in ("range", "sigma", "valid"):
        np.save(tmp_path / f"{name}.npy", np.array([[Bomb()]], dtype=object), allow_pickle=True)
    arrays, wrong = read_results(tmp_path, stage_of("gated"), {"row": 1, "col": 1})
    assert not arrays
    assert wrong.startswith("range is not an array")
    assert list(stage_of("gated").dims()) == ["range", "sigma", "valid"]


def test_float32_results_are_taken(tmp_path: Path) -> None:
    for name, kind in (("range", np.float32), ("sigma", np.float32), ("valid", bool)):
        np.save(tmp_path / f"{name}.npy", np.ones((2, 2), kind))
    arrays, wrong = read_results(tmp_path, stage_of("gated"), {"row": 2, "col": 2})
    assert not wrong
    assert arrays["range"].dtype == np.float64
    assert math.isclose(arrays["range"][0, 0], 1.0)
