"""The table of a run for a terminal: errors of every estimator, scene by scene."""

from __future__ import annotations

import math
from typing import NamedTuple

import pandas as pd

from .cell import Cell
from .data import base_cells, by_quantity, cells_of, unit_scale
from .numbers import number, rate

__all__ = ["TerminalTable", "terminal_tables"]

#: Scenes that stand side by side; of more, one column tells the error over the bound.
_MOST_SCENES = 6


class TerminalTable(NamedTuple):
    """`title`, `heads` and `rows` of texts; the first column is the estimator's label."""

    title: str
    heads: tuple[str, ...]
    rows: list[tuple[str, ...]]


def terminal_tables(scores: pd.DataFrame) -> list[TerminalTable]:
    """One table of each quantity: the error (rms) of unstressed cells, of the first condition that the run has.

    In brackets stands the share of elements that were answered where it is below 99.95 %. Rows are in the order of the errors
    over the bound; the bound is the first.
    """
    tables = []
    for name, cells in by_quantity(base_cells(cells_of(scores))).items():
        conditions = list(dict.fromkeys(cell.condition for cell in cells))
        first = next((one for one in ("matched", "declared") if one in conditions), conditions[0] if conditions else "")
        own = [cell for cell in cells if cell.condition in ((first, "declared") if first == "matched" else (first,))]
        if own:
            tables.append(_table(f"{name}, {first}", own))
    return tables


def _table(title: str, cells: list[Cell]) -> TerminalTable:
    scenes = list(dict.fromkeys(cell.scene for cell in cells))
    labels: dict[str, dict[str, Cell]] = {}
    for cell in cells:
        labels.setdefault(cell.label, {})[cell.scene] = cell
    ordered = sorted(labels, key=lambda label: _standing(labels[label]))
    if len(scenes) > _MOST_SCENES:
        pooled: list[tuple[str, ...]] = [(label, *_pooled(labels[label], len(scenes))) for label in ordered]
        return TerminalTable(title, ("estimator", "error / bound (median)", "worst", "scenes"), pooled)
    factor, unit = unit_scale(cells[0])
    bounds = {cell.scene: cell.bound for cell in cells if cell.ok and cell.bound > 0}
    rows: list[tuple[str, ...]] = [("(bound)", *(number(bounds[s] * factor) if s in bounds else "–" for s in scenes))]
    rows += [(label, *(_figure(labels[label].get(scene), factor) for scene in scenes)) for label in ordered]
    return TerminalTable(title, ("estimator", *(f"{scene}, {unit}" for scene in scenes)), rows)


def _figure(cell: Cell | None, factor: float) -> str:
    if cell is None:
        return "–"
    if not cell.ok:
        return cell.status.partition(":")[0]
    share = f" ({rate(cell.coverage)})" if cell.coverage < 0.9995 else ""
    return number(cell.rmse_full * factor) + share


def _ratios(cells: dict[str, Cell]) -> list[float]:
    return sorted(cell.rmse_full / cell.bound for cell in cells.values() if cell.ok and cell.bound > 0)


def _standing(cells: dict[str, Cell]) -> tuple[bool, float]:
    """Estimators with a result first, by the mean of the logarithm of error over bound, or of the error."""
    good = [cell for cell in cells.values() if cell.ok and cell.rmse_full > 0]
    each = [math.log(cell.rmse_full / (cell.bound if cell.bound > 0 else 1.0)) for cell in good]
    return (not each, sum(each) / len(each) if each else 0.0)


def _pooled(cells: dict[str, Cell], count: int) -> tuple[str, str, str]:
    ratios = _ratios(cells)
    good = sum(cell.ok for cell in cells.values())
    if not ratios:
        return "–", "–", f"{good} of {count}"
    return number(ratios[len(ratios) // 2]), number(ratios[-1]), f"{good} of {count}"
