"""`beambench compare`: two score tables, paired."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["compare"]

_PAIR = [
    "scene",
    "stress",
    "level",
    "stress2",
    "level2",
    "seed",
    "condition",
    "stage",
    "quantity",
    "estimator",
    "params",
]
_CELL = [name for name in _PAIR if name != "seed"]


def compare(a: str | Path, b: str | Path) -> pd.DataFrame:
    """Changes from table A to table B, one row per scene, stress, condition and estimator that both hold.

    Rows are paired by their whole key, seed included. `error_ratio` and `cpu_ratio` are geometric means over the pairs
    of B/A (rmse_full, cpu_s); `_lo` and `_hi` the 95 % t interval over seeds, NaN with one. `coverage_change` and
    `failure_change` are mean differences B − A. The attribute `unpaired` counts the rows of A and of B without partner;
    `over_scenes` holds one record per estimator, quantity and condition: the same ratio over scenes as written, with a
    studentised bootstrap interval (six scenes or more) and p, Holm-corrected for all its records; `machines_differ`
    names what differs between the machines of two runs: then `cpu_ratio` is NaN, since it would tell of the machines.

    Main arguments:
        a, b: folders of runs, or their scores.csv or scores.parquet.

    Raises:
        InputError: no score table, no row in common, or runs whose tables mean different things by "failed".
    """
    import pandas as pd

    from ..benchmarks.report.data import label_of, read_run, read_scores
    from ..scenes.errors import InputError

    first, second = read_scores(a), read_scores(b)
    for name, table in ((a, first), (b, second)):
        if table.duplicated(_PAIR).any():
            raise InputError("A score table holds one row twice.", where=str(name))
    both = first.merge(second, on=_PAIR, how="outer", suffixes=("_a", "_b"), indicator=True)
    paired = both[both["_merge"] == "both"]
    if not len(paired):
        raise InputError(
            "The two tables have no row in common.",
            where=f"{a}, {b}",
            allowed="tables of one suite: equal scenes, seeds, conditions and estimators",
        )
    runs = [read_run(folder if folder.is_dir() else folder.parent) for folder in map(Path, (a, b))]
    _check_versions(runs, f"{a}, {b}")
    differ = _machines_differ(*runs)
    rows = []
    for _, group in paired.groupby(_CELL, sort=False):
        first_row = group.iloc[0]
        error = _ratio(group["rmse_full_a"], group["rmse_full_b"])
        cpu = (math.nan,) * 3 if differ else _ratio(group["cpu_s_a"], group["cpu_s_b"])
        changed = group[group["status_a"] != group["status_b"]]
        stress = " ".join(
            filter(None, (first_row[n] for n in ("stress", "level", "stress2", "level2") if first_row[n] != "none"))
        )
        rows.append(
            {
                "scene": first_row["scene"],
                "quantity": first_row["quantity"],
                "stress": stress,
                "condition": first_row["condition"],
                "estimator": label_of(first_row["estimator"], first_row["params"]),
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
    result = pd.DataFrame(rows)
    result.attrs["unpaired"] = (int((both["_merge"] == "left_only").sum()), int((both["_merge"] == "right_only").sum()))
    result.attrs["machines_differ"] = differ
    result.attrs["over_scenes"] = _over_scenes(paired, label_of)
    return result


def _check_versions(runs: list[dict[str, Any]], where: str) -> None:
    """Runs that say how they were made must have been made by one contract; a bare table says nothing."""
    from ..scenes.errors import InputError

    found = [run.get("tables_version", 1) for run in runs if run]
    if len(set(found)) > 1:
        raise InputError(
            "The tables were made by different contracts: what the columns mean has changed between them.",
            where=where,
            value=", ".join(f"tables_version {version}" for version in found),
            allowed="equal versions",
            next_step="run the older suite again with this version of beambench",
        )


def _machines_differ(a: dict[str, Any], b: dict[str, Any]) -> list[str]:
    """What differs between the machines that two runs name; nothing where one of them names none."""
    first, second = a.get("machine"), b.get("machine")
    if not isinstance(first, dict) or not isinstance(second, dict):
        return []
    return [
        f"{name} {first[name]} and {second[name]}"
        for name in ("device_class", "processor", "threads_per_estimator")
        if name in first and name in second and first[name] != second[name]
    ]


def _over_scenes(paired: pd.DataFrame, label_of: Callable[[str, str], str]) -> list[dict[str, Any]]:
    """Scenes are what was sampled: seeds are averaged within them, and the interval is over scenes."""
    import numpy as np

    from ..benchmarks.statistics.bootstrap import studentised
    from ..benchmarks.statistics.pairs import holm

    rows: list[dict[str, Any]] = []
    known = (paired["rmse_full_a"] > 0) & (paired["rmse_full_b"] > 0)
    base = ("", "none", "nan")  # how tables write that no axis was changed
    plain = paired[known & paired["level"].str.lower().isin(base) & paired["level2"].str.lower().isin(base)]
    plain = plain.assign(log=np.log(plain["rmse_full_b"].astype(float)) - np.log(plain["rmse_full_a"].astype(float)))
    for _, group in plain.groupby(["estimator", "params", "quantity", "condition", "stage"], sort=False):
        found = studentised(group.groupby("scene")["log"].mean().to_numpy(dtype=float))
        first = group.iloc[0]
        rows.append(
            {
                "estimator": label_of(first["estimator"], first["params"]),
                "quantity": first["quantity"],
                "condition": first["condition"],
                "scenes": int(group["scene"].nunique()),
                "error_ratio": float(np.exp(found.mean)),
                "error_lo": float(np.exp(found.low)),
                "error_hi": float(np.exp(found.high)),
                "p": float(found.p),
            }
        )
    for row, p in zip(rows, holm([row["p"] for row in rows]), strict=True):
        row["p_holm"] = float(p)
    return rows


def _ratio(a: pd.Series[float], b: pd.Series[float]) -> tuple[float, float, float]:
    """Geometric mean of b/a, and its 95 % t interval over the pairs."""
    import numpy as np

    known = (a > 0) & (b > 0)
    logs = np.log(b[known].to_numpy(dtype=float) / a[known].to_numpy(dtype=float))
    if not logs.size:
        # Zero against zero is no change: an estimator without noise on an exact scene.
        return (1.0, math.nan, math.nan) if len(a) and bool(((a == 0) & (b == 0)).all()) else (math.nan,) * 3
    mean = float(logs.mean())
    if logs.size < 2:
        return math.exp(mean), math.nan, math.nan
    from scipy.stats import t

    half = float(t.ppf(0.975, logs.size - 1)) * float(logs.std(ddof=1)) / math.sqrt(logs.size)
    return math.exp(mean), math.exp(mean - half), math.exp(mean + half)
