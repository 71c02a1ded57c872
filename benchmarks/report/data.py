"""Scores as the report, the comparison and the terminal show them: seeds pooled into cells."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ...captures.layouts import LAYOUTS, layout_of
from ...estimators.labels import label_of
from ...scenes.errors import InputError, reason
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
        raise InputError("The file run.json cannot be read.", where=str(path), value=reason(error)) from error
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


#: Columns that a cell pools, takes over, or tells the median of.
_NUMBERS = ("n", "coverage", "failure_rate", "bias", "rmse", "rmse_full", "p95", "bound", "z_rms", "cover95", "efficiency",
            "efficiency_lo", "efficiency_hi", "cpu_s", "wall_s", "throughput", "peak_bytes")  # fmt: skip
_TEXTS = ("scene", "stress", "level", "stress2", "level2", "condition", "modality", "stage", "quantity", "unit", "estimator",
          "params", "bound_kind", "status")  # fmt: skip
_MEDIANS = ("cpu_s", "cpu_per_element_s", "throughput")


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
    code: npt.NDArray[np.int64] = np.asarray(table.groupby(keys, sort=False).ngroup(), np.int64)
    groups = _Groups(table, code)
    return [_cell(groups, k) for k in range(groups.count)]


class _Groups:
    """The rows of a table in groups, and what is pooled of each: arrays with one value per group."""

    def __init__(self, table: pd.DataFrame, code: npt.NDArray[np.int64]) -> None:
        import pandas as pd

        order = np.argsort(code, kind="stable")
        order = order[np.searchsorted(code[order], 0) :]  # rows without a key are in no group
        self.table, self.code = table.iloc[order], code[order]
        self.first = np.flatnonzero(np.diff(self.code, prepend=-1))
        self.count, self.size = len(self.first), np.diff(self.first, append=len(self.code))
        of = {name: self.table[name].to_numpy(float) for name in _NUMBERS}
        weight = np.where(of["n"] > 0, of["n"], np.nan)
        valid = weight * of["coverage"]
        read = of["throughput"] * of["wall_s"]
        with np.errstate(divide="ignore", invalid="ignore"):
            of["cpu_per_element_s"] = of["cpu_s"] / np.where(read > 0, read, of["n"])
        self.n, self.valid = self._sum(of["n"]), self._sum(valid)
        self.mean = {name: self._mean(of[name], weight) for name in ("coverage", "failure_rate")}
        self.mean |= {name: self._mean(of[name], valid) for name in ("bias", "p95", "cover95")}
        self.rms = {name: np.sqrt(self._mean(of[name] ** 2, valid)) for name in ("rmse", "bound", "z_rms")}
        self.rms["rmse_full"] = np.sqrt(self._mean(of["rmse_full"] ** 2, weight))
        # 1/efficiency is a mean square, so seeds pool as harmonic means.
        with np.errstate(divide="ignore"):
            inverse = 1.0 / of["efficiency"]
        self.all_efficient = self._sum(np.isnan(of["efficiency"]).astype(float)) == 0
        self.harmonic = self.size / np.where(self.all_efficient, self._sum(inverse), np.nan)
        pooled = pd.DataFrame({name: of[name] for name in (*_MEDIANS, "peak_bytes")}).groupby(self.code)
        medians = pooled[list(_MEDIANS)].median()
        self.median = {name: medians[name].to_numpy() for name in _MEDIANS}
        self.peak = pooled["peak_bytes"].max().to_numpy()
        self.of = of
        self.texts = {name: self.table[name].to_numpy() for name in (*_TEXTS, "seed")}

    def _sum(self, values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        summed = np.bincount(self.code, np.where(np.isnan(values), 0.0, values), minlength=self.count)
        return summed.astype(np.float64)

    def _mean(self, values: npt.NDArray[np.float64], weight: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        known = ~np.isnan(values) & (weight > 0)
        total = self._sum(np.where(known, weight, 0.0))
        return self._sum(np.where(known, values * weight, 0.0)) / np.where(total > 0, total, np.nan)

    def rows(self, k: int) -> slice:
        """The rows of a group."""
        return slice(int(self.first[k]), int(self.first[k] + self.size[k]))


def _cell(groups: _Groups, k: int) -> Cell:
    rows = groups.rows(k)
    own = {name: column[rows] for name, column in groups.texts.items()}
    first = {name: column[0] for name, column in own.items()}
    statuses = list(map(str, own["status"]))
    bad = [status for status in statuses if status != "ok"]
    mean, rms, median = (
        {name: float(v[k]) for name, v in part.items()} for part in (groups.mean, groups.rms, groups.median)
    )
    efficient = bool(groups.all_efficient[k]) and not bias_is_real(mean["bias"], rms["rmse"], float(groups.valid[k]))
    single = groups.size[k] == 1
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
        seeds=int(groups.size[k]),
        n=float(groups.n[k]),
        bound_kind=weakest_kind(own["bound_kind"]),
        efficiency=float(groups.harmonic[k]) if efficient else math.nan,
        # The interval is only known for one seed.
        efficiency_lo=float(groups.of["efficiency_lo"][rows][0]) if single else math.nan,
        efficiency_hi=float(groups.of["efficiency_hi"][rows][0]) if single else math.nan,
        peak_bytes=float(groups.peak[k]),
        status=bad[0] if bad else "ok",
        statuses=tuple(dict.fromkeys(statuses)),
        per_seed=tuple(zip(
            own["seed"].astype(int).tolist(), *(groups.of[name][rows].tolist() for name in ("n", "rmse_full", "cpu_s")),
            strict=True,
        )),
        coverage=mean["coverage"], failure_rate=mean["failure_rate"], bias=mean["bias"], rmse=rms["rmse"],
        rmse_full=rms["rmse_full"], p95=mean["p95"], bound=rms["bound"], z_rms=rms["z_rms"], cover95=mean["cover95"],
        cpu_s=median["cpu_s"], cpu_per_element_s=median["cpu_per_element_s"], throughput=median["throughput"],
    )  # fmt: skip


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

    The key names the quantity, where two stages or modalities give one of that name with its modality, and with its stage unless it
    begins with the stage's name.
    """
    groups: dict[tuple[str, str, str], list[Cell]] = {}
    for cell in cells:
        groups.setdefault((cell.quantity, cell.stage, cell.modality), []).append(cell)
    names = [key[0] for key in groups]
    return {
        quantity
        if names.count(quantity) == 1
        else _words(modality, "" if quantity.startswith(stage) else stage, quantity): group
        for (quantity, stage, modality), group in groups.items()
    }


def _words(*parts: str) -> str:
    return " ".join(part for part in parts if part)


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
