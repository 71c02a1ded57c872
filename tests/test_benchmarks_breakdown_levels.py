"""Breakdown levels from the fixed levels of a run, per scene."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from beambench.benchmarks.scores.score import COLUMNS
from beambench.benchmarks.search.breakdown_levels import LEVEL_COLUMNS, breaking_level, level_rows, main, markdown


@pytest.mark.parametrize(
    ("levels", "rates", "target", "expected"),
    [
        ([0.0, 1.0, 2.0], [0.0, 0.2, 1.0], 0.5, 1.375),  # linear between 1 and 2
        ([1.0, 0.1, 0.01], [0.0, 0.25, 0.75], 0.5, 10**-1.5),  # falling and logarithmic
        ([1.0, 2.0], [0.6, 0.9], 0.5, 1.0),  # fails at once
        ([1.0, 2.0, 3.0], [0.0, 0.6, 0.1], 0.5, 1.0 + 0.5 / 0.6),  # the first passage counts
        ([1.0, 2.0], [0.0, 0.4], 0.5, math.nan),
    ],
)
def test_first_passage(levels: list[float], rates: list[float], target: float, expected: float) -> None:
    assert breaking_level(levels, rates, target) == pytest.approx(expected, nan_ok=True)


def _scores() -> pd.DataFrame:
    rows: list[dict[str, Any]] = []
    for scene, edge in (("air", 0.1), ("water", 1.0)):
        for level in (10.0, 1.0, 0.1, 0.01):
            for seed, n in ((1, 100), (2, 300)):
                row: dict[str, Any] = dict.fromkeys(COLUMNS, "")
                row |= {
                    "suite": "mine", "scene": scene, "stress": "photons", "level": level, "seed": seed, "n": n,
                    "condition": "matched", "estimator": "peak", "params": "", "stage": "range", "quantity": "range",
                    "failure_rate": float(level < edge), "stress2": "none", "status": "ok", "modality": "gated",
                }  # fmt: skip
                rows += [row, {**row, "quantity": "range-mixed", "failure_rate": 1.0}]
    rows.append({**rows[0], "stress": "none", "level": math.nan, "failure_rate": 1.0})
    return pd.DataFrame(rows, columns=list(COLUMNS))


def test_rows_keep_scenes_apart_and_leave_mixed_elements_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scores = _scores()
    rows = level_rows(scores, {("mine", "photons"): (10.0, 1.0, 0.1, 0.01)})
    assert [tuple(row) for row in rows] == [LEVEL_COLUMNS] * 2
    by_scene = {row["scene"]: row for row in rows}
    # From 0 at .1 to 1 at .01 the rate is .5 half-way, on a logarithmic axis.
    assert by_scene["air"]["level50"] == pytest.approx(10**-1.5)
    assert by_scene["water"]["level50"] == pytest.approx(10**-0.5)
    assert by_scene["water"]["rate_last"] == 1 and by_scene["water"]["worst_rate"] == 1
    table = markdown(rows)
    assert "| `peak` |" in table and "air, matched" in table
    never = level_rows(scores[scores["level"] != 0.01], {("mine", "photons"): (10.0, 1.0, 0.1)})
    assert math.isnan(next(row for row in never if row["scene"] == "air")["level50"])
    assert "– / – (0%)" in markdown(never)
    scores.to_csv(tmp_path / "scores.csv", index=False)
    # Levels of a suite that does not ship are taken as rising: .01 fails at once.
    assert main([str(tmp_path)]) == 0 and "0.01 / 0.01" in capsys.readouterr().out
    assert main([]) == 2
