"""The verdicts of the report: from tiles and calls if the run has them, otherwise from the seeds of the table."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from beambench.benchmarks.report.charts import speed_accuracy_spec
from beambench.benchmarks.report.data import cells_of
from beambench.benchmarks.report.front import mark_front
from beambench.benchmarks.report.page import write_report
from beambench.benchmarks.report.ranking import ranking_section
from beambench.scenes.errors import InputError

from . import _api_fixtures as made_up

#: cpu per element, rmse: b is dominated by a, c is on the front, d is within a hair of c.
POINTS = {"a": (1e-9, 4e-3), "b": (2e-9, 6e-3), "c": (8e-9, 1e-3), "d": (8.01e-9, 1.01e-3)}


def _rows(seeds: int = 1) -> list[dict[str, Any]]:
    return [
        made_up.score_row(
            estimator=name,
            seed=seed,
            n=65536,
            cpu_s=cpu * 65536,
            wall_s=cpu * 65536,
            throughput=1 / cpu,
            rmse_full=rmse,
        )
        for name, (cpu, rmse) in POINTS.items()
        for seed in range(seeds)
    ]


def _costs() -> list[dict[str, Any]]:
    return [
        {
            "scene": "flat-wall", "condition": "matched", "stress": "none", "level": "", "stress2": "none", "level2": "",
            "estimator": name, "params": "", "calls": 5.0, "cpu_log_sd": 0.05,
        }
        for name in POINTS
    ]  # fmt: skip


def _tiles() -> dict[tuple[str, str, int, str], tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(1)
    hard = rng.chisquare(20, 64) / 20
    counts = np.full(64, 1024.0)
    found = {}
    for name, (_, rmse) in POINTS.items():
        sums = rmse**2 * 1024 * hard * np.exp(0.1 * rng.normal(size=64))
        found["flat-wall", "matched", 0, name] = (sums, counts)
    return found


def test_tiles_and_calls_decide() -> None:
    cells = cells_of(pd.DataFrame(_rows()))
    mark_front(cells, _costs(), _tiles())
    assert {c.label: c.verdict for c in cells} == {
        "a": "front", "b": "dominated", "c": "undecided", "d": "undecided",
    }  # fmt: skip
    for cell in cells:
        assert cell.cpu_lo < cell.cpu_per_element_s < cell.cpu_hi and cell.cpu_hi / cell.cpu_lo < 1.3
        assert cell.error_lo < cell.rmse_full * 1.2 and cell.error_hi > cell.rmse_full * 0.8
    assert {c.label for c in cells if c.front} == {"a", "c"}
    drawn = str(speed_accuracy_spec(cells, page=True))
    assert all(word in drawn for word in ("cpu_lo", "error_hi", "undecided"))


def test_one_seed_alone_decides_nothing_and_seeds_do() -> None:
    cells = cells_of(pd.DataFrame(_rows()))
    mark_front(cells)
    assert {c.verdict for c in cells} == {"undecided"} and all(math.isnan(c.cpu_lo) for c in cells)
    rows = _rows(seeds=8)
    rng = np.random.default_rng(2)
    for row in rows:
        row["cpu_s"] *= math.exp(0.02 * rng.normal())
        row["rmse_full"] *= math.exp(0.005 * rng.normal())
    cells = cells_of(pd.DataFrame(rows))
    mark_front(cells)
    assert {c.label: c.verdict for c in cells}["b"] == "dominated"
    assert {c.label: c.verdict for c in cells}["a"] == "front"


def test_the_page_ranks_with_intervals(tmp_path: Path) -> None:
    folder = made_up.make_run(tmp_path, pictures=False)
    group = "gated,range,range,matched"
    head = (
        "modality,stage,quantity,condition,estimator,scenes,rank_lo,rank_hi,rmse_full,rmse_full_lo,rmse_full_hi,"
        "coverage,coverage_lo,coverage_hi,profile_best,profile_area"
    )
    lines = [f"{group},peak,8,1,1,1e-3,.9e-3,1.1e-3,1,.9,1,.75,.9", f"{group},slow,8,2,3,2e-3,,,.5,,,.25,.1"]
    (folder / "ranking.csv").write_text("\n".join([head, *lines, ""]))
    (section,) = ranking_section(folder)
    assert section["rows"][0][:3] == ["1", "peak", "1.00 [0.900, 1.10]"] and section["rows"][1][0] == "2 to 3"
    page = write_report(folder).read_text(encoding="utf-8")
    assert 'id="ranking"' in page and "1.00 [0.900, 1.10]" in page and "2 to 3" in page
    assert 'class="key undecided"' in page
    (folder / "ranking.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="ranking"):
        write_report(folder)


def test_tiles_of_the_main_quantity_say_nothing_of_another_one() -> None:
    """A chain gives coefficients and a phase, whose errors differ a hundredfold; tiles hold those of the coefficients."""
    rows = []
    for name, rmse in (("zernike", 1e-2), ("phase", 1.0)):
        rows += [
            made_up.score_row(
                modality="wavefront", stage="reconstruction", quantity=name, unit="rad", estimator=estimator, seed=seed,
                rmse=worse * rmse, rmse_full=worse * rmse, cpu_s=1e-3 * worse, bound=rmse / 2,
            )
            for estimator, worse in (("zernike-map", 1.0), ("zernike-ls", 2.0))
            for seed in (0, 1)
        ]  # fmt: skip
    tiles = {
        ("flat-wall", "matched", seed, estimator): (worse**2 * 1e-4 * np.full(64, 1000.0), np.full(64, 1000.0))
        for estimator, worse in (("zernike-map", 1.0), ("zernike-ls", 2.0))
        for seed in (0, 1)
    }
    cells = cells_of(pd.DataFrame(rows))
    mark_front(cells, (), tiles)
    for cell in cells:
        if not math.isnan(cell.error_lo):
            assert cell.error_lo <= cell.rmse_full * 1.001 and cell.error_hi >= cell.rmse_full * 0.999, cell.quantity
    assert not math.isnan(next(c.error_lo for c in cells if c.quantity == "zernike"))
