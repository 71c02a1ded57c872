"""Charts are specs that Altair accepts, and cells pool as a simple loop over groups does."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import altair as alt
import numpy as np
import pandas as pd
import pytest

from beambench.benchmarks.report.cell import Cell
from beambench.benchmarks.report.charts import finished, speed_accuracy_spec
from beambench.benchmarks.report.data import axis_text, cells_of, level_text
from beambench.benchmarks.report.fidelity_chart import effects_spec, rungs_spec
from beambench.benchmarks.report.stress_chart import stress_groups, stress_spec
from beambench.benchmarks.statistics.pooled import bias_is_real, weakest_kind
from beambench.estimators.labels import label_of

KEYS = [
    "scene",
    "stress",
    "level",
    "stress2",
    "level2",
    "condition",
    "stage",
    "quantity",
    "unit",
    "estimator",
    "params",
]


def table(seed: int, rows: int = 400) -> pd.DataFrame:
    """Rows as a run writes them, with every kind of gap."""
    rng = np.random.default_rng(seed)

    def some(values: Any, share: float = 0.1) -> Any:
        return np.where(rng.random(rows) < share, np.nan, values)

    n = rng.choice([0, 1, 64, 100], rows).astype(float)
    return pd.DataFrame({
        "scene": rng.choice(["a", "b"], rows), "stress": rng.choice(["none", "photons"], rows),
        "level": rng.choice(["", "1.0", "0.1"], rows), "stress2": "none", "level2": "",
        "condition": rng.choice(["matched", "calibrated"], rows), "modality": "gated", "stage": "range",
        "quantity": "range", "unit": "m", "estimator": rng.choice(["peak", "poisson-ml"], rows),
        "params": rng.choice(["", "x=1"], rows), "seed": rng.integers(1, 9, rows), "n": n,
        "coverage": some(rng.random(rows)), "failure_rate": some(rng.random(rows)), "bias": some(rng.normal(0, 0.01, rows)),
        "rmse": some(rng.random(rows)), "rmse_full": some(rng.random(rows)), "p95": some(rng.random(rows)),
        "bound": some(rng.random(rows)), "bound_kind": rng.choice(["exact", "quasi", "none", "odd"], rows),
        "z_rms": some(rng.random(rows)), "cover95": some(rng.random(rows)), "efficiency": some(rng.random(rows), 0.02),
        "efficiency_lo": rng.random(rows), "efficiency_hi": rng.random(rows), "cpu_s": some(rng.random(rows)),
        "wall_s": some(rng.random(rows)), "throughput": some(rng.random(rows) * 1e3),
        "peak_bytes": some(rng.random(rows) * 1e6), "status": rng.choice(["ok", "error: x"], rows, p=[0.9, 0.1]),
    })  # fmt: skip


def pooled(group: pd.DataFrame) -> Cell:
    first = group.iloc[0]
    weight = group["n"].where(group["n"] > 0)
    valid = weight * group["coverage"]
    bias, rmse = mean_of(group["bias"], valid), math.sqrt(mean_of(group["rmse"] ** 2, valid))
    bad = [status for status in group["status"] if status != "ok"]
    elements = (group["throughput"] * group["wall_s"]).where(group["throughput"] * group["wall_s"] > 0, group["n"])
    efficiency = group["efficiency"].dropna()
    efficient = len(efficiency) == len(group) and not bias_is_real(bias, rmse, float(valid.sum()))
    return Cell(
        scene=first["scene"],
        stress=axis_text(first["stress"]),
        level=level_text(first["level"]) if axis_text(first["stress"]) else "",
        stress2=axis_text(first["stress2"]),
        level2=level_text(first["level2"]) if axis_text(first["stress2"]) else "",
        condition=first["condition"],
        modality=first["modality"],
        stage=first["stage"],
        quantity=first["quantity"],
        unit=first["unit"],
        label=label_of(first["estimator"], first["params"]),
        seeds=len(group),
        n=float(group["n"].sum()),
        coverage=mean_of(group["coverage"], weight),
        failure_rate=mean_of(group["failure_rate"], weight),
        bias=bias,
        rmse=rmse,
        rmse_full=math.sqrt(mean_of(group["rmse_full"] ** 2, weight)),
        p95=mean_of(group["p95"], valid),
        bound=math.sqrt(mean_of(group["bound"] ** 2, valid)),
        bound_kind=weakest_kind(group["bound_kind"]),
        # 1/efficiency is a mean square, so seeds pool as harmonic means; the interval is only known for one seed.
        efficiency=float(1 / (1 / efficiency).mean()) if efficient else math.nan,
        efficiency_lo=float(first["efficiency_lo"]) if len(group) == 1 else math.nan,
        efficiency_hi=float(first["efficiency_hi"]) if len(group) == 1 else math.nan,
        z_rms=math.sqrt(mean_of(group["z_rms"] ** 2, valid)),
        cover95=mean_of(group["cover95"], valid),
        cpu_s=float(group["cpu_s"].median()),
        cpu_per_element_s=float((group["cpu_s"] / elements).median()),
        throughput=float(group["throughput"].median()),
        peak_bytes=float(group["peak_bytes"].max()),
        status=bad[0] if bad else "ok",
        statuses=tuple(dict.fromkeys(map(str, group["status"]))),
        per_seed=tuple(zip(group["seed"].astype(int), group["n"], group["rmse_full"], group["cpu_s"], strict=True)),
    )


def mean_of(values: pd.Series[float], weight: pd.Series[float]) -> float:
    known = values.notna() & weight.notna() & (weight > 0)
    total = float(weight[known].sum())
    return float((values[known] * weight[known]).sum()) / total if total > 0 else math.nan


def alike(one: Any, other: Any) -> bool:
    if isinstance(one, tuple):
        return len(one) == len(other) and all(alike(a, b) for a, b in zip(one, other, strict=True))
    if isinstance(one, float):
        return (math.isnan(one) and math.isnan(other)) or math.isclose(one, other, rel_tol=1e-12, abs_tol=1e-300)
    return bool(one == other)


@pytest.mark.parametrize("seed", range(5))
def test_cells_are_those_of_a_loop_over_the_groups(seed: int) -> None:
    rows = table(seed)
    expected = [pooled(group) for _, group in rows.groupby(KEYS, sort=False)]
    found = cells_of(rows)
    assert len(found) == len(expected) > 40 and {len(cell.per_seed) for cell in found} >= {1, 5}
    for one, other in zip(found, expected, strict=True):
        for part in fields(Cell):
            mine, theirs = getattr(one, part.name), getattr(other, part.name)
            assert alike(mine, theirs), (part.name, mine, theirs)


def test_a_table_without_rows_has_no_cells() -> None:
    assert cells_of(table(0).iloc[:0]) == []


@pytest.mark.parametrize("page", [True, False])
def test_altair_accepts_every_chart(page: bool) -> None:
    rows = table(1)
    rows["coverage"], rows["bound"] = 1.0, 0.5
    cells = cells_of(rows)
    stress = next(iter(stress_groups(cells).values()))
    row = {"scene": "a", "rung": "direct", "cpu_s": 0.1, "rel_error": 0.01, "lo": 0.005, "hi": 0.02}
    effect = {"name": "halo", "predicted_relative_size": 0.02, "modelled": True, "basis": "b"}
    drawn = [
        speed_accuracy_spec([c for c in cells if c.scene == "a" and not c.stressed], page=page), stress_spec(stress, page=page),
        rungs_spec([row, row | {"rung": "full"}], page=page), effects_spec({"effects": [effect], "rtol": 0.01}, page=page),
    ]  # fmt: skip
    for spec in drawn:
        assert spec is not None
        chart = alt.Chart.from_dict(spec)  # raises for what the grammar does not have
        assert isinstance(chart, alt.LayerChart) and chart.to_dict()["layer"]
    with pytest.raises(Exception, match="no-such-mark"):
        alt.Chart.from_dict(finished({"layer": [{"mark": {"type": "no-such-mark"}}]}, page=page))
