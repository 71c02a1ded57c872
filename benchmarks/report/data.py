"""Scores as read by the report, the comparison and the terminal summary."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...captures.layouts import LAYOUTS, layout_of
from ...scenes.errors import InputError
from ..statistics.pooled import bias_is_real, weakest_kind
from .cell import Cell

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "COLUMNS",
    "Cell",
    "axis_text",
    "base_cells",
    "cells_of",
    "label_of",
    "level_text",
    "read_run",
    "read_scores",
    "seeds_of",
    "shown_as",
    "unit_scale",
]

_TEXT = (
    "suite",
    "scene",
    "stress",
    "level",
    "stress2",
    "level2",
    "condition",
    "stage",
    "estimator",
    "params",
    "modality",
    "quantity",
    "unit",
    "bound_kind",
    "status",
)
_NUMBER = (
    "seed",
    "n",
    "coverage",
    "failure_rate",
    "failure_at",
    "bias",
    "rmse",
    "rmse_full",
    "mae",
    "p95",
    "bound",
    "efficiency",
    "efficiency_lo",
    "efficiency_hi",
    "z_rms",
    "cover95",
    "cpu_s",
    "wall_s",
    "throughput",
    "peak_bytes",
)

#: The columns of scores.csv that are used; others are ignored.
COLUMNS = (*_TEXT, *_NUMBER)


def read_scores(path: str | Path) -> pd.DataFrame:
    """Read a score table: the folder of a run, or its scores.csv or scores.parquet.

    Raises:
        InputError: no such file, not a table, or a required column is missing.
    """
    import pandas as pd

    path = Path(path)
    if path.is_dir():
        found = [path / name for name in ("scores.csv", "scores.parquet") if (path / name).is_file()]
        if not found:
            raise InputError(
                "The folder contains no score table.",
                where=str(path),
                allowed="a folder with scores.csv or scores.parquet",
                next_step="beambench run quickstart",
            )
        path = found[0]
    try:
        if path.suffix == ".parquet":
            table = pd.read_parquet(path)
        else:
            # Text stays text: by default a scene named "NA" would be read as a missing value.
            blanks = {name: ["", "nan", "NaN"] for name in _NUMBER}
            table = pd.read_csv(path, dtype=dict.fromkeys(_TEXT, str), keep_default_na=False, na_values=blanks)
    except (OSError, ValueError, UnicodeDecodeError) as error:
        raise InputError("The score table cannot be read.", where=str(path), value=str(error)) from error
    missing = [name for name in COLUMNS if name not in table.columns]
    if missing:
        raise InputError(
            "The table is not a score table: columns are missing.",
            where=str(path),
            value=missing,
            allowed="scores.csv or scores.parquet as `beambench run` writes it",
        )
    for name in _TEXT:
        table[name] = table[name].astype(object).fillna("").astype(str)
    for name in _NUMBER:
        try:
            table[name] = pd.to_numeric(table[name]).astype(float)
        except (ValueError, TypeError) as error:
            raise InputError(
                "A column of numbers contains other values.", where=f"{path}: {name}", value=str(error)
            ) from error
    return table


def read_run(folder: Path) -> dict[str, Any]:
    """Read run.json of a run; without the file the record is empty, so that a score table alone can be reported."""
    path = folder / "run.json"
    if not path.exists():
        return {}
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError("run.json cannot be read.", where=str(path), value=str(error)) from error
    if not isinstance(record, dict):
        raise InputError("run.json must be an object.", where=str(path), value=type(record).__name__)
    for name, kind, word in (
        ("failures", list, "a list"),
        ("machine", dict, "an object"),
        ("versions", dict, "an object"),
    ):
        if record.get(name) is not None and not isinstance(record[name], kind):
            raise InputError(
                "A value in run.json has the wrong type.", where=f"{path}: {name}", value=record[name], allowed=word
            )
    return record


def label_of(estimator: str, params: str) -> str:
    """`name[key=value,...]`, from the two columns of the table."""
    return f"{estimator}[{params}]" if params and "[" not in estimator else estimator


def seeds_of(table: pd.DataFrame) -> list[int]:
    """The seeds of a score table, sorted."""
    return sorted(int(seed) for seed in table["seed"].dropna().unique())


def cells_of(table: pd.DataFrame) -> list[Cell]:
    """Pool the seeds of each cell.

    Errors and bounds are averaged as squares (weights: elements), rates as means; statistics of answered elements are
    weighted by their number. `bound_kind` is the weakest over the seeds. CPU time is the median over seeds; per element it
    is divided by all elements that the estimator read (throughput × wall time).
    """
    keys = [
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
    return [_pool(group) for _, group in table.groupby(keys, sort=False)]


def _pool(group: pd.DataFrame) -> Cell:
    first = group.iloc[0]
    weight = group["n"].where(group["n"] > 0)
    valid = weight * group["coverage"]
    bias, rmse = _mean(group["bias"], valid), math.sqrt(_mean(group["rmse"] ** 2, valid))
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
        coverage=_mean(group["coverage"], weight),
        failure_rate=_mean(group["failure_rate"], weight),
        bias=bias,
        rmse=rmse,
        rmse_full=math.sqrt(_mean(group["rmse_full"] ** 2, weight)),
        p95=_mean(group["p95"], valid),
        bound=math.sqrt(_mean(group["bound"] ** 2, valid)),
        bound_kind=weakest_kind(group["bound_kind"]),
        # 1/efficiency is a mean square, so seeds are pooled by a harmonic mean; the interval is known for one seed only.
        efficiency=float(1 / (1 / efficiency).mean()) if efficient else math.nan,
        efficiency_lo=float(first["efficiency_lo"]) if len(group) == 1 else math.nan,
        efficiency_hi=float(first["efficiency_hi"]) if len(group) == 1 else math.nan,
        z_rms=math.sqrt(_mean(group["z_rms"] ** 2, valid)),
        cover95=_mean(group["cover95"], valid),
        cpu_s=float(group["cpu_s"].median()),
        cpu_per_element_s=float((group["cpu_s"] / elements).median()),
        throughput=float(group["throughput"].median()),
        peak_bytes=float(group["peak_bytes"].max()),
        status=bad[0] if bad else "ok",
        statuses=tuple(dict.fromkeys(map(str, group["status"]))),
        per_seed=tuple(zip(group["seed"].astype(int), group["n"], group["rmse_full"], group["cpu_s"], strict=True)),
    )


def _mean(values: pd.Series[float], weight: pd.Series[float]) -> float:
    known = values.notna() & weight.notna() & (weight > 0)
    total = float(weight[known].sum())
    return float((values[known] * weight[known]).sum()) / total if total > 0 else math.nan


def axis_text(name: str) -> str:
    """The axis of a stress, "" without stress."""
    return "" if name.lower() in {"", "none", "nan"} else name


def level_text(level: str) -> str:
    """A level with few digits."""
    try:
        return f"{float(level):g}"
    except ValueError:
        return level


def base_cells(cells: list[Cell]) -> list[Cell]:
    """The cells of unmixed elements without stress; if every cell is stressed, all cells of unmixed elements."""
    plain = [cell for cell in cells if not cell.mixed]
    return [cell for cell in plain if not cell.stressed] or plain


def unit_scale(cell: Cell) -> tuple[float, str]:
    """Factor and unit in which the quantity of a cell is displayed; unchanged for a quantity unknown to this version."""
    return shown_as(cell.modality, cell.quantity, cell.unit)


def shown_as(modality: str, quantity: str, unit: str) -> tuple[float, str]:
    """Factor and unit in which a quantity of a modality is displayed; 1 and `unit` if unknown to this version."""
    if modality in LAYOUTS:
        for known in layout_of(modality).quantities:
            if known.name == quantity.removesuffix("-mixed") and unit in ("", known.unit):
                return known.display
    return 1.0, unit
