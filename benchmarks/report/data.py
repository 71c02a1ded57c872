"""Scores as the report, the comparison and the terminal show them: seeds pooled into cells."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...captures.layouts import LAYOUTS, layout_of
from ...estimators.labels import label_of
from ...scenes.errors import InputError
from ...scenes.json_keys import read_json
from ..folders.exchange import refuse_unfinished
from ..statistics.pooled import bias_is_real, weakest_kind
from .cell import Cell

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "Cell",
    "axis_text",
    "base_cells",
    "by_quantity",
    "cells_of",
    "level_text",
    "read_run",
    "seeds_of",
    "shown_as",
    "unit_scale",
]


def read_run(folder: Path) -> dict[str, Any]:
    """Read run.json of a run's folder; without the file the record is empty: a score table alone can be reported."""
    refuse_unfinished(folder)
    path = folder / "run.json"
    if not path.exists():
        return {}
    try:
        record = read_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError("The file run.json cannot be read.", where=str(path), value=str(error)) from error
    if not isinstance(record, dict):
        raise InputError("The file run.json does not hold a JSON object.", where=str(path), value=type(record).__name__)
    for name, kind, word in (
        ("failures", list, "a list"),
        ("machine", dict, "an object"),
        ("versions", dict, "an object"),
        ("tables_version", int, "a whole number"),
    ):
        if record.get(name) is not None and not isinstance(record[name], kind):
            raise InputError(
                "A value in run.json has the wrong type.", where=f"{path}: {name}", value=record[name], allowed=word
            )
    return record


def seeds_of(table: pd.DataFrame) -> list[int]:
    """The seeds of a score table, sorted."""
    return sorted(int(seed) for seed in table["seed"].dropna().unique())


def cells_of(table: pd.DataFrame) -> list[Cell]:
    """Pool the seeds of each cell.

    Squares are averaged (weights: elements) for errors and bounds, means for rates; what is of the answered elements is
    weighted by these. `bound_kind` is the weakest of the seeds'. CPU time is the median over seeds, and per element it
    counts every element the estimator read: throughput × wall time.
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
        # 1/efficiency is a mean square, so seeds pool as harmonic means; the interval is only known for one seed.
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
    """The axis of a stress, "" where none was applied."""
    return "" if name.lower() in {"", "none", "nan"} else name


def level_text(level: str) -> str:
    """A level in few digits."""
    try:
        return f"{float(level):g}"
    except ValueError:
        return level


def base_cells(cells: list[Cell]) -> list[Cell]:
    """The cells of unmixed elements without stress; where every cell is stressed, all of unmixed elements."""
    plain = [cell for cell in cells if not cell.mixed]
    return [cell for cell in plain if not cell.stressed] or plain


def by_quantity(cells: list[Cell]) -> dict[str, list[Cell]]:
    """Cells by what they measure: errors and times per element of different quantities cannot be compared.

    The key names the quantity, with its stage where two stages give one of that name.
    """
    groups: dict[tuple[str, str, str], list[Cell]] = {}
    for cell in cells:
        groups.setdefault((cell.quantity, cell.stage, cell.modality), []).append(cell)
    names = [key[0] for key in groups]
    return {
        key[0] if names.count(key[0]) == 1 else " ".join(part for part in reversed(key) if part): group
        for key, group in groups.items()
    }


def unit_scale(cell: Cell) -> tuple[float, str]:
    """Factor and unit in which people read a cell's quantity; as the table has it where the quantity is unknown here."""
    return shown_as(cell.modality, cell.quantity, cell.unit)


def shown_as(modality: str, quantity: str, unit: str) -> tuple[float, str]:
    """Factor and unit in which people read a quantity of a modality; `unit` where this version does not know it."""
    if modality in LAYOUTS:
        for known in layout_of(modality).quantities:
            if known.name == quantity.removesuffix("-mixed") and unit in ("", known.unit):
                return known.display
    return 1.0, unit
