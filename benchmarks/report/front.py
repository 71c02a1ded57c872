"""Verdicts of the speed-accuracy chart: intervals of error and time, and front, dominated or undecided.

Errors are compared tile by tile on the captures that estimators share (`error_tiles`), or seed by seed for a table without
tiles; times by the scatter of calls (`costs`), or over seeds. Without either, every point is undecided.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ...captures.layouts import is_main_quantity
from ...estimators.labels import label_of
from ..runner.costs import cost_interval
from ..scores.error_tiles import TileKey
from ..statistics.front import classify, interval_order, lower_left, paired_order, ratio_interval
from .cell import Cell
from .data import axis_text, level_text

__all__ = ["SUSPECT", "mark_front"]

#: Verdict of a cell that is better than its bound by more than chance.
SUSPECT = "suspect"

Float = npt.NDArray[np.float64]
_Calls = dict[tuple[str, ...], list[tuple[float, float]]]


def mark_front(
    cells: list[Cell],
    costs: Sequence[Mapping[str, Any]] = (),
    tiles: Mapping[TileKey, tuple[Float, Float]] | None = None,
) -> None:
    """Set `verdict`, `front` and the intervals of each cell, by comparison within one panel and condition.

    Main arguments:
        cells: of the report. costs: rows of costs.csv. tiles: of errors_by_tile.npz.
    """
    groups: dict[tuple[str, ...], list[Cell]] = {}
    for cell in cells:
        if cell.suspect:
            cell.verdict = SUSPECT  # it takes no part in the comparison
        elif cell.ok and cell.cpu_per_element_s > 0 and cell.rmse_full >= 0:
            groups.setdefault(
                (cell.stage, cell.quantity, cell.scene, cell.condition, *_levels(cell)), []
            ).append(cell)  # fmt: skip
    calls: _Calls = {}
    for row in costs:
        levels = [
            text
            for axis, level in (("stress", "level"), ("stress2", "level2"))
            for text in (axis_text(row[axis]), level_text(row[level]) if axis_text(row[axis]) else "")
        ]
        key = (row["scene"], row["condition"], *levels, label_of(row["estimator"], row["params"]))
        calls.setdefault(key, []).append((row["calls"], row["cpu_log_sd"]))
    for group in groups.values():
        _judge(group, calls, tiles or {})


def _levels(cell: Cell) -> tuple[str, str, str, str]:
    return (cell.stress, cell.level, cell.stress2, cell.level2)


def _judge(group: list[Cell], calls: _Calls, tiles: Mapping[TileKey, tuple[Float, Float]]) -> None:
    repeated = [calls.get((c.scene, c.condition, *_levels(c), c.label)) or [_over_seeds(c)] for c in group]
    together = [row for rows in repeated for row in rows]
    for cell, mine in zip(group, repeated, strict=True):
        cell.cpu_lo, cell.cpu_hi = cost_interval(cell.cpu_per_element_s, mine, together)
    sums, counts = _units(group, tiles)
    for cell, row in zip(group, sums, strict=True):
        cell.error_lo, cell.error_hi = ratio_interval(row, counts)
    cost = interval_order([c.cpu_lo for c in group], [c.cpu_hi for c in group])
    verdicts = classify(cost, paired_order(sums))
    best = lower_left([c.cpu_per_element_s for c in group], [c.rmse_full for c in group])
    for cell, verdict, flag in zip(group, verdicts, best, strict=True):
        cell.verdict, cell.front = verdict, flag


def _over_seeds(cell: Cell) -> tuple[float, float]:
    """(calls, standard deviation of ln time), one call per seed."""
    logs = np.log([cpu for *_, cpu in cell.per_seed if cpu > 0])
    return float(logs.size), float(logs.std(ddof=1)) if logs.size > 1 else math.nan


def _units(group: list[Cell], tiles: Mapping[TileKey, tuple[Float, Float]]) -> tuple[Float, Float]:
    """Squared errors (cell, unit) on the units (tiles or seeds) that all cells share, and elements per unit.

    Tiles hold the errors of an estimator's main quantity alone.
    """
    seeds = sorted(set.intersection(*({seed for seed, *_ in cell.per_seed} for cell in group)))
    first = group[0]
    keys = [[(c.scene, c.condition, seed, c.label) for seed in seeds] for c in group]
    main = is_main_quantity(first.stage, first.quantity) and not first.stressed and not first.mixed
    if main and seeds and all(key in tiles for row in keys for key in row):
        sums = np.array([np.concatenate([tiles[key][0] for key in row]) for row in keys])
        counts = np.concatenate([tiles[key][1] for key in keys[0]])
        return sums[:, counts > 0], counts[counts > 0]
    found = [{seed: (n, rmse) for seed, n, rmse, _ in cell.per_seed} for cell in group]
    sums = np.array([[row[seed][0] * row[seed][1] ** 2 for seed in seeds] for row in found]).reshape(len(group), -1)
    return sums, np.array([found[0][seed][0] for seed in seeds])
