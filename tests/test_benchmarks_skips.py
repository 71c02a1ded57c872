"""Skips: an estimator of another modality, one without its package, one over its limits. Each has a reason; none wins."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from beambench.benchmarks.report.page import write_report
from beambench.benchmarks.report.text import closing_lines
from beambench.benchmarks.run import run_suite
from beambench.benchmarks.runner.costs import COST_COLUMNS, cost_interval, read_costs
from beambench.benchmarks.runner.estimator_labels import missing_package
from beambench.benchmarks.scores.error_tiles import read_tiles
from beambench.benchmarks.scores.tables import read_scores
from beambench.benchmarks.statistics.skips import not_applicable, skip_reason, skips_of
from beambench.scenes.errors import InputError

PLANTED = """
import time
import numpy as np, xarray as xr
from beambench.estimators import estimator

def answer(capture):
    shape, dims = capture["counts"].shape[1:], ("row", "col")
    return xr.Dataset({"range": (dims, np.full(shape, 5.0)), "sigma": (dims, np.full(shape, .1)),
                       "valid": (dims, np.ones(shape, bool))})

@estimator("gated", cites="planted")
def lazy(capture):
    import a_package_that_nobody_has
    return answer(capture)

@estimator("gated", cites="planted")
def hangs(capture):
    time.sleep(1000)
"""
EAGER = "import another_package_that_nobody_has\n"
SUITE: dict[str, Any] = {
    "suite": "skips", "scenes": ["flat-wall"], "seeds": {"test": [1, 2, 3, 4]},
    "estimators": ["peak", "waveform-ml", "x-lazy", "x-eager", "x-hangs"],
    # Wide for a machine that others use; the one that hangs spends it once.
    "limits": {"time_s": 15.0, "warmup_s": 12.0, "memory_bytes": 2**31, "give_up_after": 1},
}  # fmt: skip
SIZE = {"rig.camera.rows": 16, "rig.camera.cols": 16}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    site = tmp_path_factory.mktemp("site")
    info = site / "skip_plants-1.0.dist-info"
    info.mkdir()
    (site / "skip_plants.py").write_text(PLANTED)
    (site / "eager_plants.py").write_text(EAGER)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: skip_plants\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[beambench.estimators]\nx-lazy = skip_plants:lazy\nx-hangs = skip_plants:hangs\nx-eager = eager_plants:never\n"
    )
    out = tmp_path_factory.mktemp("run") / "a"
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(site))
        run_suite(SUITE, out, overrides=SIZE)
    return out


def _rows(folder: Path) -> dict[str, list[dict[str, str]]]:
    found: dict[str, list[dict[str, str]]] = {}
    for row in csv.DictReader((folder / "scores.csv").open()):
        found.setdefault(row["estimator"], []).append(row)
    return found


def test_each_skip_has_its_reason(folder: Path) -> None:
    rows = _rows(folder)
    assert {row["status"] for row in rows["waveform-ml"]} == {"skip: reads waveform captures, not gated"}
    assert {row["status"] for row in rows["x-lazy"]} == {"skip: needs the package a_package_that_nobody_has"}
    assert {row["status"] for row in rows["x-eager"]} == {"skip: needs the package another_package_that_nobody_has"}
    for name in ("waveform-ml", "x-lazy", "x-eager"):
        assert {(row["n"], row["rmse_full"], row["failure_rate"]) for row in rows[name]} == {("0", "", "")}
    statuses = [row["status"].partition(":")[0] for row in rows["x-hangs"]]
    assert statuses == ["timeout", "skip", "skip", "skip"]
    # It had its chance: the captures that it was spared count as those that it lost.
    assert {(row["coverage"], row["failure_rate"]) for row in rows["x-hangs"]} == {("0", "1")}
    assert len({row["rmse_full"] for row in rows["x-hangs"]}) == 1
    record = json.loads((folder / "run.json").read_text())
    reasons = {(note["estimator"], note["rows"], note["scored"]) for note in record["skipped"]}
    assert reasons == {("waveform-ml", 4, False), ("x-lazy", 4, False), ("x-eager", 4, False), ("x-hangs", 3, True)}
    assert {note["estimator"] for note in record["failures"]} == {"x-hangs"}


def test_the_skipped_are_neither_ranked_nor_failures(folder: Path) -> None:
    ranked = [row["estimator"] for row in csv.DictReader((folder / "ranking.csv").open())]
    assert ranked == ["peak", "x-hangs"]
    lines = closing_lines(read_scores(folder))
    assert not [line for line in lines if line.startswith("fails") and "waveform-ml" in line]
    skips = [line for line in lines if line.startswith("skipped")]
    assert len(skips) == 4 and any("waveform-ml: reads waveform captures, not gated" in line for line in skips)
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "needs the package a_package_that_nobody_has" in page and 'id="skipped"' in page


def test_costs_and_tiles_hold_what_was_measured(folder: Path) -> None:
    costs = read_costs(folder)
    assert tuple(costs[0]) == COST_COLUMNS
    assert {row["estimator"] for row in costs} == {"peak", "x-hangs"}
    for row in (row for row in costs if row["estimator"] == "peak"):
        assert row["source"] == "measured" and row["device_class"] == "cpu" and row["elements"] == 256
        assert row["calls"] >= 3 and row["cpu_s_min"] <= row["cpu_s"] <= row["cpu_s_max"]
        assert row["cpu_per_element_s"] == pytest.approx(row["cpu_s"] / 256, rel=1e-8)
    tiles = read_tiles(folder)
    table = pd.read_csv(folder / "scores.csv")
    for (scene, condition, seed, label), (sums, counts) in tiles.items():
        row = table[(table["estimator"] == label) & (table["seed"] == seed)].iloc[0]
        assert (scene, condition, counts.sum()) == ("flat-wall", "matched", row["n"])
        assert math.sqrt(sums.sum() / counts.sum()) == pytest.approx(row["rmse_full"], rel=1e-8)
    assert {key[3] for key in tiles} == {"peak", "x-hangs"}


def test_a_damaged_side_file_is_told(folder: Path, tmp_path: Path) -> None:
    for name, reader in (("costs.csv", read_costs), ("errors_by_tile.npz", read_tiles)):
        (tmp_path / name).write_bytes(b"a,b\n1,2\n")
        with pytest.raises(InputError, match="cannot be read"):
            reader(tmp_path)
        (tmp_path / name).unlink()
        assert not reader(tmp_path)
    # Without them, as in runs of before, the page is written all the same.
    for name in ("scores.csv", "run.json"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    assert write_report(tmp_path).is_file()


def test_only_a_package_that_is_absent_is_a_missing_extra() -> None:
    def raised(name: str) -> ModuleNotFoundError:
        return ModuleNotFoundError(f"No module named {name!r}", name=name)

    wrapped = InputError("cannot be imported")
    wrapped.__cause__ = raised("nobody_has_this.part")
    assert missing_package(wrapped) == "nobody_has_this"
    assert missing_package(raised("mine.part"), "mine.module:function") == ""
    assert missing_package(raised("beambench.nothing")) == ""
    assert missing_package(raised("json.nothing")) == ""
    assert missing_package(ImportError("cannot import name", name="numpy")) == ""
    assert missing_package(None) == ""


def test_words_of_statuses() -> None:
    assert not_applicable("skip: reads waveform captures") and skip_reason("skip: why") == "why"
    assert not not_applicable("skip: gave up after it exceeded its limits 3 times in a row")
    assert not not_applicable("timeout: call over 1 s") and skip_reason("ok") == ""
    assert skips_of([{"status": "ok", "estimator": "a", "params": "", "scene": "s"}]) == []


def test_the_interval_of_a_median_time() -> None:
    """20 % scatter, five calls: the interval holds the truth in 95 % of 1,000 draws, within four standard errors."""
    import numpy as np

    rng = np.random.default_rng(5)
    hits = 0
    for _ in range(1000):
        calls = np.exp(0.2 * rng.normal(size=(6, 5)))
        rows = [(5.0, float(np.log(one).std(ddof=1))) for one in calls]
        low, high = cost_interval(float(np.median(calls[0])), rows[:1], rows)
        hits += low <= 1.0 <= high
    assert hits / 1000 > 0.95 - 4 * math.sqrt(0.95 * 0.05 / 1000)
    assert math.isnan(cost_interval(1.0, [(1.0, math.nan)], [(1.0, math.nan)])[0])
    # One call among others that were repeated takes their scatter.
    low, high = cost_interval(1.0, [(1.0, math.nan)], [(1.0, math.nan), (5.0, 0.1)])
    assert 0.5 < low < 1 < high < 2
