"""Data sets made by workers: the same bytes for any number of them, for any interruption, and as `generate` makes each capture."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

import beambench
from beambench.benchmarks.datasets import crew
from beambench.benchmarks.datasets.jobs import Jobs, identity_of, shard_length
from beambench.benchmarks.datasets.large import Force, make_dataset
from beambench.benchmarks.datasets.outline import check_parts, pilot, staff
from beambench.benchmarks.folders.progress import silent
from beambench.captures import finalize, open_captures, repair, verify
from beambench.captures.padding import padded_as
from beambench.generator.generate import generate
from beambench.scenes.datasets.load import load_dataset
from beambench.scenes.errors import InputError
from beambench.scenes.machine import usable_cores

from ._data_sets import ALL_KINDS, tiny

#: A worker that kills itself, or fails, before a capture; `once`: only where a file does not say that it has.
_PLANTED = """
import os, pathlib
from beambench.benchmarks.datasets import worker
make = worker.Maker.capture
def capture(self, index):
    mark = pathlib.Path({mark!r})
    if index == {at} and not (mark.exists() and {once}):
        mark.touch()
        {what}
    return make(self, index)
worker.Maker.capture = capture
worker.main()
"""


def made(
    out: Path, workers: int | None = 1, resume: bool = False, source: dict[str, Any] | None = None, **given: Any
) -> Any:
    draws = load_dataset(source or tiny())
    return make_dataset(draws, out, Force(workers, **given), resume=resume, overwrite=False, tell=silent)


def tree(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("set") / "tiny"
    made(out)
    return out


def test_each_capture_is_that_of_generate(store: Path) -> None:
    assert verify(store) == []
    draws, captures = load_dataset(tiny()), open_captures(store)
    assert len(captures) == 40
    for index in (0, 17, 39):
        _, scene = draws.possible(index)
        assert captures[index].identical(generate(scene, seed=3, capture_key=index, fidelity="direct", rtol=1e-2))


def test_a_killed_run_is_resumed_to_the_same_bytes(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGKILL in the middle, then two workers instead of one: every file is that of the undisturbed run."""
    monkeypatch.setattr("beambench.benchmarks.datasets.outline.usable_cores", lambda: 2)
    file, out = tmp_path / "tiny.json", tmp_path / "out"
    file.write_text(json.dumps(tiny()))
    words = [sys.executable, "-m", "beambench", "generate", str(file), "-o", str(out), "--workers", "1"]
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        until = time.monotonic() + 300
        receipts = tmp_path / "out.partial" / "receipts"
        while not list(receipts.glob("*.z")) and time.monotonic() < until and process.poll() is None:
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert process.returncode == -signal.SIGKILL
    assert list(receipts.glob("*.z"))
    assert not out.exists()
    again = made(out, workers=2, resume=True)
    assert again.kept > 0
    assert tree(out) == tree(store)
    assert not (tmp_path / "out.partial").exists()
    assert made(out, resume=True).kept == 40


def test_a_worker_that_dies_is_replaced(store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    what = "os.kill(os.getpid(), 9)"
    monkeypatch.setattr(crew, "_COMMAND", _PLANTED.format(mark=str(tmp_path / "mark"), at=13, once=True, what=what))
    result = made(tmp_path / "out")
    assert len(result.events) == 1
    assert "ended by signal 9" in result.events[0]
    assert tree(tmp_path / "out") == tree(store)


@pytest.mark.parametrize(
    "what", ["os.kill(os.getpid(), 9)", pytest.param("raise RuntimeError('planted')", marks=pytest.mark.slow)]
)
def test_a_job_that_ends_three_workers_is_set_aside(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str, request: pytest.FixtureRequest
) -> None:
    """It is named, the rest goes on, `finalize` keeps the rest, and a later --resume makes what is missing."""
    if "raise" in what:
        request.getfixturevalue("long_run")
    command = _PLANTED.format(mark=str(tmp_path / "mark"), at=13, once=False, what=what)
    with monkeypatch.context() as planted:
        planted.setattr(crew, "_COMMAND", command)
        with pytest.raises(InputError, match="could not be made") as caught:
            made(tmp_path / "out")
    assert "shard 1 (captures 10 … 19)" in str(caught.value)
    assert "it ended 3 workers" in str(caught.value)
    assert len(list((tmp_path / "out.partial" / "receipts").glob("*.z"))) == 3
    if "kill" in what:
        assert made(tmp_path / "out", resume=True).kept == 30
        assert tree(tmp_path / "out") == tree(store)
    else:
        assert finalize(tmp_path / "out").kept == 30
        assert made(tmp_path / "out", resume=True).made == 10
        assert open_captures(tmp_path / "out").content == open_captures(store).content


def test_a_damaged_capture_is_made_again(store: Path, tmp_path: Path) -> None:
    import shutil

    from beambench.benchmarks.datasets.generate import maker_of

    work = tmp_path / "work"
    shutil.copytree(store, work)
    path = next((work / "gated" / "counts").glob("c.2.*"))
    content = bytearray(path.read_bytes())
    content[100] ^= 4
    path.write_bytes(content)
    done = repair(work, make=maker_of(work))
    assert done.remade
    assert done.dropped == ()
    assert tree(work) == tree(store)


def test_a_store_grows(store: Path, tmp_path: Path) -> None:
    import shutil

    work = tmp_path / "work"
    shutil.copytree(store, work)
    result = made(work, resume=True, source=tiny(captures=45))
    assert (result.kept, result.made, result.count) == (40, 5, 45)
    assert verify(work) == []
    captures, before = open_captures(work), open_captures(store)
    assert all(captures[index].identical(before[index]) for index in (0, 39))
    _, scene = load_dataset(tiny()).possible(44)
    assert captures[44].identical(generate(scene, seed=3, capture_key=44, fidelity="direct", rtol=1e-2))
    with pytest.raises(InputError, match="not of this data set"):
        made(work, resume=True, source=tiny(seed=4))
    with pytest.raises(InputError, match="output exists"):
        made(work)
    with pytest.raises(InputError, match="would be lost"):
        made(work, resume=True)
    assert len(open_captures(work)) == 45


def test_every_modality(tmp_path: Path) -> None:
    """A group for each; captures are those of `generate` at the same arguments, but for the length of a line's truth."""
    result = made(tmp_path / "out", source=ALL_KINDS)
    assert result.count == 10
    assert verify(tmp_path / "out") == []
    draws = load_dataset(ALL_KINDS)
    names = sorted(path.name for path in (tmp_path / "out").iterdir() if (path / "zarr.json").is_file())
    assert names == sorted({scene["rig"]["kind"] for scene in draws.scenes.values()})
    for name in names:
        captures = open_captures(tmp_path / "out" / name)
        index = captures.number(0)
        drawn, scene = draws.possible(index)
        rung = draws.fidelity(drawn.base)
        alone = generate(scene, seed=7, capture_key=index, fidelity=rung, rtol=0.1)
        assert captures[0].identical(padded_as(captures[0], alone, name)), name
    assert beambench.data_status(tmp_path / "out")["count"] == 10


def test_an_impossible_scene_is_named_and_the_rest_kept(tmp_path: Path) -> None:
    scene = {"scene": "sphere", "overrides": {"rig.camera.rows": 4, "rig.camera.cols": 4, "rig.delays.count": 4}}
    radius = {"kind": "choice", "values": [0.3, 90.0], "weights": [19, 1], "paths": ["target.0.shape.radius_m"]}
    source = tiny(scenes=[scene], parameters={"r": radius}, captures=30)
    source.pop("split")
    with pytest.raises(InputError, match="could not be made") as caught:
        made(tmp_path / "out", source=source)
    assert "is impossible" in str(caught.value)
    assert "r = 90.0" in str(caught.value)


def test_an_impossible_scene_of_the_pilot_is_told_as_the_input_s_own_error() -> None:
    source = tiny(parameters={"a": {"kind": "expression", "text": "1 / 0", "paths": ["rig.ambient_e_per_s"]}})
    source.pop("split", None)
    with pytest.raises(InputError, match="An expression has no value") as caught:
        pilot(load_dataset(source))
    error = caught.value
    assert error.where == "parameters.a.text"
    assert "pilot" not in str(error) and "doctor" not in str(error)


def test_the_plan_and_the_verbs(store: Path, tmp_path: Path) -> None:
    told = beambench.generate(tiny(captures=1000), plan=True, out=tmp_path / "out", workers=1).outline
    assert told is not None
    assert not (tmp_path / "out").exists()
    assert sum(told["parts"].values()) == told["captures"] == 1000
    sizes = sum(path.stat().st_size for path in store.rglob("c.*")) / 40
    assert 0.8 * sizes < told["groups"][0]["bytes_per_capture"]
    assert told["files"] <= 2 * told["captures"]
    for given in ({"seeds": [1]}, {"workers": 10**6}):
        with pytest.raises(InputError):
            beambench.generate(tiny(), out=tmp_path / "out", plan=True, **given)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="Only a data set"):
        beambench.generate("step", workers=2, plan=True)
    with pytest.raises(InputError, match="no capture"):
        check_parts(load_dataset(tiny(parameters={})))


def test_estimates_are_scored_by_capture(store: Path, tmp_path: Path) -> None:
    folder = beambench.estimate(store, ["peak"], out=tmp_path / "estimates")
    table = beambench.score(store, folder, out=tmp_path / "scores")
    assert set(table["seed"]) == set(range(40))
    assert (table["status"] == "ok").all()


def test_workers_share_the_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    assert 1 <= usable_cores() <= len(os.sched_getaffinity(0))
    monkeypatch.setattr("beambench.benchmarks.datasets.outline.usable_cores", lambda: 8)
    for workers in (None, 1, 3, 8):
        count, threads = staff(workers, 100)
        assert 1 <= count * threads <= 8
    assert staff(None, 2) == (2, 4)


def test_jobs_depend_on_the_data_set_alone() -> None:
    """Every capture is in one shard, only the last one is shorter, and a data set that grows keeps its identity."""
    draws = load_dataset(tiny(ALL_KINDS, captures=50, repeats=3))
    jobs = Jobs(draws, dict.fromkeys(Jobs(draws, {}).names, 4))
    rows = [row for job in jobs for row in job.rows]
    assert sorted(rows) == list(range(50))
    assert len(jobs) == len(list(jobs))
    assert all(len(job.rows) == 4 or job.last for job in jobs)
    assert identity_of(draws) == identity_of(load_dataset(tiny(ALL_KINDS, captures=60, repeats=3)))
    assert identity_of(draws) != identity_of(load_dataset(tiny(ALL_KINDS, captures=50, repeats=3, rtol=0.2)))
    assert shard_length(10**6, 18, 10**4) == 67
    assert shard_length(10**9, 18, 10**4) == 10
    assert shard_length(100, 18, 10**6) == 256
