"""Changes between two paired score tables, A and B: ratios of errors and costs, and changes of rates."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from .bootstrap import studentised
from .pairs import holm

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["CELL", "KEY", "changes_by_cell", "changes_over_scenes"]

#: Columns that pair the rows of two tables, and those that name a cell, over whose seeds changes are averaged.
KEY = [
    "scene", "stress", "level", "stress2", "level2", "seed", "condition", "stage", "quantity", "estimator", "params",
]  # fmt: skip
CELL = [name for name in KEY if name != "seed"]


def changes_by_cell(paired: pd.DataFrame, *, times: bool) -> list[dict[str, Any]]:
    """One record per cell of a table of pairs, whose columns of A and B end in `_a` and `_b`.

    `error_ratio` and `cpu_ratio` are geometric means over the pairs of B/A (rmse_full, cpu_s), `_lo` and `_hi` the 95 % t
    interval over seeds, NaN with one; `coverage_change` and `failure_change` are mean differences B - A.

    Main arguments:
        paired: The rows that both tables have, with the columns `KEY`.
        times: Whether times may be compared; else `cpu_ratio` is NaN.
    """
    rows = []
    for _, group in paired.groupby(CELL, sort=False):
        first = group.iloc[0]
        error = _mean_ratio(group["rmse_full_a"], group["rmse_full_b"])
        cpu = _mean_ratio(group["cpu_s_a"], group["cpu_s_b"]) if times else (math.nan,) * 3
        changed = group[group["status_a"] != group["status_b"]]
        axes = (first[name] for name in ("stress", "level", "stress2", "level2") if first[name] != "none")
        rows.append(
            {
                "scene": first["scene"],
                "quantity": first["quantity"],
                "stress": " ".join(filter(None, axes)),
                "condition": first["condition"],
                "estimator": first["estimator"],
                "params": first["params"],
                "pairs": len(group),
                "error_ratio": error[0],
                "error_lo": error[1],
                "error_hi": error[2],
                "cpu_ratio": cpu[0],
                "cpu_lo": cpu[1],
                "cpu_hi": cpu[2],
                "coverage_change": float((group["coverage_b"] - group["coverage_a"]).mean()),
                "failure_change": float((group["failure_rate_b"] - group["failure_rate_a"]).mean()),
                "status": "" if changed.empty else f"{changed.iloc[0]['status_a']} → {changed.iloc[0]['status_b']}",
            }
        )
    return rows


def changes_over_scenes(paired: pd.DataFrame) -> list[dict[str, Any]]:
    """Ratios of errors over the scenes without stress, one record per estimator, quantity and condition.

    Scenes are the sample: the logarithms of B/A are averaged over the seeds of a scene, and the interval over scenes is a
    studentised bootstrap (six scenes or more); `p_holm` is `p` corrected by Holm for all records.
    """
    rows: list[dict[str, Any]] = []
    known = (paired["rmse_full_a"] > 0) & (paired["rmse_full_b"] > 0)
    base = ("", "none", "nan")  # the level in tables where no axis was changed
    plain = paired[known & paired["level"].str.lower().isin(base) & paired["level2"].str.lower().isin(base)]
    plain = plain.assign(log=np.log(plain["rmse_full_b"].astype(float)) - np.log(plain["rmse_full_a"].astype(float)))
    for _, group in plain.groupby(["estimator", "params", "quantity", "condition", "stage"], sort=False):
        mean = studentised(group.groupby("scene")["log"].mean().to_numpy(dtype=float))
        first = group.iloc[0]
        rows.append(
            {
                "estimator": first["estimator"],
                "params": first["params"],
                "quantity": first["quantity"],
                "condition": first["condition"],
                "scenes": int(group["scene"].nunique()),
                "error_ratio": float(np.exp(mean.mean)),
                "error_lo": float(np.exp(mean.low)),
                "error_hi": float(np.exp(mean.high)),
                "p": float(mean.p),
            }
        )
    for row, p in zip(rows, holm([row["p"] for row in rows]), strict=True):
        row["p_holm"] = float(p)
    return rows


def _mean_ratio(a: pd.Series[float], b: pd.Series[float]) -> tuple[float, float, float]:
    """Geometric mean of b/a, and its 95 % t interval over the pairs."""
    known = (a > 0) & (b > 0)
    logs = np.log(b[known].to_numpy(dtype=float) / a[known].to_numpy(dtype=float))
    if not logs.size:
        # Zero against zero is no change: an estimator without noise on an exact scene.
        return (1.0, math.nan, math.nan) if len(a) and bool(((a == 0) & (b == 0)).all()) else (math.nan,) * 3
    mean = float(logs.mean())
    if logs.size < 2:
        return math.exp(mean), math.nan, math.nan
    from scipy.special import stdtrit

    half = float(stdtrit(logs.size - 1, 0.975)) * float(logs.std(ddof=1)) / math.sqrt(logs.size)
    return math.exp(mean), math.exp(mean - half), math.exp(mean + half)
