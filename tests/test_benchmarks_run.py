"""A complete small run: generate, store, estimate, score, write; equal seeds give equal bytes; failures do not stop it."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.folders.journal import Journal
from beambench.benchmarks.run import RunResult, run_suite
from beambench.benchmarks.runner.jail import abi
from beambench.benchmarks.scores.score import COLUMNS
from beambench.scenes.errors import InputError

SMALL: dict[str, Any] = {
    "suite": "small", "version": 1, "title": "Small", "scenes": ["flat-wall"], "seeds": {"test": [2]},
    "estimators": ["peak", "x-broken", "x-changes"], "limits": {"time_s": 10.0, "memory_bytes": 2**30},
    "stresses": [{"axis": "rig.ambient_e_per_s", "values": [1e8]}],
}  # fmt: skip
SIZE = {"rig.camera.rows": 24, "rig.camera.cols": 24}

PLANTED = """
import glob, os
import numpy as np, xarray as xr
from beambench.estimators import estimator

@estimator("gated", cites="planted")
def broken(capture):
    raise RuntimeError("planted")

@estimator("gated", cites="planted")
def changes(capture):
    for path in glob.glob("../../0*/counts.npy"):
        os.chmod(path, 0o644)
        array = np.load(path)
        array[...] = 0
        np.save(path, array)
    shape = capture["counts"].shape[1:]
    dims = ("row", "col")
    return xr.Dataset({"range": (dims, np.full(shape, 5.0)), "sigma": (dims, np.full(shape, .1)),
                       "valid": (dims, np.ones(shape, bool))})
"""


@pytest.fixture
def plugins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site = tmp_path / "site"
    (site / "runner_plants-1.0.dist-info").mkdir(parents=True)
    (site / "runner_plants.py").write_text(PLANTED)
    info = site / "runner_plants-1.0.dist-info"
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: runner_plants\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[beambench.estimators]\nx-broken = runner_plants:broken\nx-changes = runner_plants:changes\n"
    )
    monkeypatch.syspath_prepend(str(site))


def small(out: Path, **options: Any) -> RunResult:
    overrides = {**SIZE, **options.pop("overrides", {})}
    return run_suite(SMALL, out, overrides=overrides, report=False, **options)


def test_a_run_from_end_to_end(plugins: None, tmp_path: Path) -> None:
    told: list[tuple[str, int, int, str]] = []
    result = small(tmp_path / "a", progress=lambda *step: told.append(step))
    rows = list(csv.DictReader((tmp_path / "a" / "scores.csv").open()))
    assert tuple(rows[0]) == COLUMNS
    assert [(r["stress"], r["estimator"]) for r in rows] == [
        (stress, name) for stress in ("none", "rig.ambient_e_per_s") for name in ("peak", "x-broken", "x-changes")
    ]
    by = {(r["stress"], r["estimator"]): r for r in rows}
    good = by["none", "peak"]
    assert good["status"] == "ok"
    assert int(good["n"]) == 24 * 24
    assert float(good["coverage"]) > 0.9
    assert 0 < float(good["bound"]) < float(good["rmse"]) < 0.05
    assert good["bound_kind"] == "exact"
    assert float(good["throughput"]) == pytest.approx(24 * 24 / float(good["wall_s"]), rel=1e-6)
    broken = by["none", "x-broken"]
    assert broken["status"] == "error: RuntimeError: planted"
    assert (broken["coverage"], broken["failure_rate"], broken["rmse"], broken["cpu_s"]) == ("0", "1", "", "")
    # An estimator that reaches for its input's files is found out, or kept from them, and the next capture is whole again.
    assert by["none", "x-changes"]["status"].startswith(
        "error: PermissionError" if abi() else "invalid: changed its input"
    )
    assert by["rig.ambient_e_per_s", "peak"]["status"] == "ok"
    assert float(by["rig.ambient_e_per_s", "peak"]["bound"]) > float(good["bound"])
    record = json.loads((tmp_path / "a" / "run.json").read_text())
    assert record["suite"] == "small"
    assert record["machine"]["threads_per_estimator"] == 1
    assert record["versions"]["numpy"] == np.__version__
    assert {note["estimator"] for note in record["failures"]} == {"x-broken", "x-changes"}
    assert told[0][0] == "generate"
    assert ("estimate", 6, 6) in [step[:3] for step in told]
    with np.load(tmp_path / "a" / "pictures" / "flat-wall__peak.npz") as picture:
        assert picture["value"].shape == (24, 24)
        np.testing.assert_allclose(picture["error"], picture["value"] - picture["truth"], atol=1e-6)
    assert len(list((tmp_path / "a" / "captures").glob("*.zarr"))) == 2
    assert not list((tmp_path / "a").rglob("*.partial"))
    assert len(result.failures) == 4


def test_equal_seeds_give_equal_bytes_and_a_resumed_run_too(plugins: None, tmp_path: Path) -> None:
    only = {"overrides": {"estimators": ["peak", "weighted-average"]}}
    for name in ("a", "b"):
        small(tmp_path / name, **only)
    first = (tmp_path / "a" / "accuracy.csv").read_bytes()
    assert first == (tmp_path / "b" / "accuracy.csv").read_bytes()
    assert first.count(b"\n") == 5
    # Interrupted after one estimator of one capture: the rest is done, the finished part is not done again.
    journal = tmp_path / "b" / "journal.jsonl"
    lines = journal.read_text().splitlines()
    journal.write_text("\n".join(lines[:2]) + '\n{"key": ["torn"')
    (tmp_path / "b" / "scores.csv").unlink()
    (tmp_path / "b" / "run.json").unlink()
    told: list[tuple[str, int, int, str]] = []
    small(tmp_path / "b", resume=True, progress=lambda *step: told.append(step), **only)
    assert first == (tmp_path / "b" / "accuracy.csv").read_bytes()
    assert min(done for stage, done, _, _ in told if stage == "estimate") == 1
    assert len(Journal(tmp_path / "b", "x").done) == 4
    with pytest.raises(InputError, match="another suite"):
        small(tmp_path / "b", resume=True)
    with pytest.raises(InputError, match="not empty"):
        small(tmp_path / "b", **only)


def test_bad_input_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    for changes in ({"estimators": ["peek"]}, {"seeds.dev": [2]}, {"rig.camera.rows": -1}):
        with pytest.raises(InputError):
            run_suite(SMALL | {"estimators": ["peak"]}, tmp_path / "a", overrides=changes, report=False)
        assert not (tmp_path / "a").exists()


def test_another_seed_gives_another_table(tmp_path: Path) -> None:
    tables = []
    for seed in (2, 3):
        out = tmp_path / str(seed)
        data = SMALL | {"estimators": ["weighted-average"], "stresses": []}
        run_suite(data, out, overrides={**SIZE, "seeds.test": [seed]}, report=False)
        tables.append(next(csv.DictReader((out / "accuracy.csv").open())))
    assert tables[0]["rmse"] != tables[1]["rmse"]
    # 576 pixels: rmse has a relative standard error of 1/√(2·576) = 3 %; 5 of them, twice.
    assert math.isclose(float(tables[0]["rmse"]), float(tables[1]["rmse"]), rel_tol=0.2)


def test_what_an_interrupted_run_left_half_written_is_replaced(tmp_path: Path) -> None:
    data = SMALL | {"estimators": ["peak"], "stresses": []}
    out = tmp_path / "a"
    run_suite(data, out, overrides=SIZE, report=False)
    (store,) = (out / "captures").glob("*.zarr")
    store.rename(store.with_name(store.name + ".partial"))
    (out / "journal.jsonl").write_text((out / "journal.jsonl").read_text().splitlines()[0] + "\n")
    before = (out / "accuracy.csv").read_bytes()
    run_suite(data, out, overrides=SIZE, report=False, resume=True)
    assert (out / "accuracy.csv").read_bytes() == before
    assert store.exists()
    assert not list(out.rglob("*.partial"))


def test_a_full_temporary_folder_is_told_plainly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import tempfile

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with pytest.raises(InputError, match="TMPDIR"):
        run_suite(SMALL | {"estimators": ["peak"], "stresses": []}, tmp_path / "a", overrides=SIZE, report=False)


def test_an_interrupt_leaves_no_child_behind(plugins: None, tmp_path: Path) -> None:
    import psutil

    def interrupt(stage: str, done: int, total: int, text: str) -> None:
        if stage == "estimate" and done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        small(tmp_path / "a", progress=interrupt)
    mine = [p for p in psutil.Process().children(recursive=True) if "beambench.benchmarks.runner.child" in p.cmdline()]
    assert not mine
    assert len(Journal(tmp_path / "a", "x").done) == 1
