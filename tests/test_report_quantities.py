"""Tables and sentences of runs with several quantities: each error under its unit, each time per what it is the time of."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
import pytest

from beambench.benchmarks.report.data import cells_of
from beambench.benchmarks.report.front import mark_front
from beambench.commands.estimate import _score_text

from ._api_fixtures import score_row

LINE: dict[str, Any] = {"modality": "laser_line", "scene": "wall", "bound_kind": "none", "bound": float("nan")}


def _row(stage: str, estimator: str, quantity: str, unit: str, **changes: Any) -> dict[str, Any]:
    return score_row(**LINE | {"stage": stage, "estimator": estimator, "quantity": quantity, "unit": unit} | changes)


def _calibration() -> pd.DataFrame:
    """One estimate of 20 s: 200 coordinates, a length and two angles."""
    given = {"cpu_s": 20.0, "wall_s": 20.0}
    rows = [
        _row("calibration", "calibrate-board", name, unit, n=n, rmse_full=error, throughput=n / 20.0, **given)
        for name, unit, n, error in (
            ("focal_length", "m", 1, 5e-6),
            ("node", "m", 200, 3e-4),
            ("plane_angle", "rad", 2, 8e-5),
        )
    ]
    return pd.DataFrame(rows)


def _chain() -> pd.DataFrame:
    """A finder and a chain: columns in px, points in m."""
    rows = [
        _row("line", "line-ml", "column", "px", rmse_full=0.0031, bias=0.0002),
        _row("triangulation", "line-ml+triangulate-refractive", "point", "m", rmse_full=2.4e-5, bias=1e-6),
    ]
    return pd.DataFrame(rows)


def _printed(table: pd.DataFrame, capsys: pytest.CaptureFixture[str]) -> list[list[str]]:
    table.attrs["folder"] = "scores"
    _score_text(table, {})
    return [line.split() for line in capsys.readouterr().out.splitlines()]


def test_score_prints_each_error_beside_its_own_unit(capsys: pytest.CaptureFixture[str]) -> None:
    """Points of .024 mm stood under "px", a thousand times too small."""
    lines = _printed(_chain(), capsys)
    heads = [line for line in lines if "RMSE," in line]
    assert [head[head.index("RMSE,") + 1] for head in heads] == ["px", "mm"]
    assert "0.00310" in lines[lines.index(heads[0]) + 1] and "0.0240" in lines[lines.index(heads[1]) + 1]


def test_score_of_one_quantity_has_its_unit_in_the_heading(capsys: pytest.CaptureFixture[str]) -> None:
    head, row, *_ = _printed(_chain().iloc[1:].copy(), capsys)
    assert head[2:4] == ["RMSE,", "mm"] and "0.0240" in row and "mm" not in row


def test_the_page_names_stresses_of_its_own_modality() -> None:
    """A calibration shares no estimator with any suite of stresses; those of gated images are of no use to it."""
    from beambench.benchmarks.report.opening import _stress_suite

    assert _stress_suite(cells_of(_calibration())).startswith("stress-line")
    assert _stress_suite(cells_of(pd.DataFrame([score_row(estimator="own")]))) == "stress-attenuation-lengths"


def test_the_interval_of_an_error_is_of_its_own_quantity() -> None:
    """Tiles hold the errors of nodes: no focal length has their interval, .3 mm beside an error of .005 mm."""
    cells = cells_of(_calibration())
    sums, counts = np.linspace(0.5, 1.5, 40) * 9e-8 * 5, np.full(40, 5.0)
    mark_front(cells, tiles={("wall", "matched", 0, "calibrate-board"): (sums, counts)})
    low = {cell.quantity: cell.error_lo for cell in cells}
    assert 2e-4 < low["node"] < 3e-4 and all(math.isnan(low[name]) for name in ("focal_length", "plane_angle"))
