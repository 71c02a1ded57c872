"""Ranking of estimators by their error over all elements, from rows of a score table.

The figure is `rmse_full`: refused elements count with the error of a guess within the window, so that refusing difficult
elements gives no advantage. A crash counts as refusing everything. All estimators are ranked on the same cells; ranks are
intervals, from Holm-corrected paired differences.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...estimators.labels import label_of
from ...scenes.errors import InputError
from ..statistics.skips import not_applicable
from .bootstrap import MIN_SCENES, studentised
from .pairs import Pair, pairwise
from .profiles import Profile, performance_profiles
from .rates import clustered_interval
from .tile_ranks import compare_by_tiles

__all__ = ["Comparison", "Ranked", "ScoreMatrix", "compare_estimators", "partial_readers", "score_matrix"]

Float = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ScoreMatrix:
    """Arrays (estimator, scene) of one condition and quantity: rmse over seeds and levels, number of refused elements."""

    names: list[str]
    scenes: list[str]
    rmse_full: Float
    refused: Float
    n: Float


@dataclass(frozen=True)
class Ranked:
    """Rank of one estimator: geometric mean of `rmse_full` with its interval, rank interval, coverage with interval.

    `rank_low` − 1 others are significantly better at the family-wise level; all but `rank_high` are significantly worse.
    """

    name: str
    rmse_full: float
    low: float
    high: float
    rank_low: int
    rank_high: int
    coverage: float
    coverage_low: float
    coverage_high: float


@dataclass(frozen=True)
class Comparison:
    """Comparison of the estimators in a score table: ranks (best first), all pairs, and profiles.

    basis: what ranks and intervals rest on: "scenes", then they hold for other scenes of the kind; "tiles", then they hold for
    these scenes only; "" where nothing is decided.
    """

    ranked: list[Ranked]
    pairs: list[Pair]
    profiles: list[Profile]
    basis: str = "scenes"


def _label(row: dict[str, Any]) -> str:
    return label_of(str(row["estimator"]), str(row["params"]))


def partial_readers(scenes: Mapping[str, set[str]]) -> set[str]:
    """The names whose scenes are a part only of all that are read, from {name: scenes}."""
    every = set().union(*scenes.values()) if scenes else set()
    return {name for name, own in scenes.items() if own != every}


def score_matrix(
    rows: Iterable[dict[str, Any]],
    *,
    modality: str,
    stage: str,
    quantity: str,
    condition: str = "matched",
    stressed: bool = False,
) -> ScoreMatrix:
    """Gather rows of scores.csv into one figure per estimator and scene: √mean(rmse_full²), weighted by elements.

    Main arguments:
        rows: rows of a score table, with typed values.
    Other arguments:
        modality, stage, quantity, condition: of the rows to use; rows that differ in them are not compared. stressed:
        include stressed rows, pooled into their scene.

    Raises:
        InputError: an estimator lacks a cell that another has, or has one twice, so that they cannot be paired.
    """
    cells: dict[str, dict[tuple[Any, ...], dict[str, Any]]] = {}
    skipped: set[str] = set()
    wanted_row = {"modality": modality, "stage": stage, "quantity": quantity, "condition": condition}
    for row in rows:
        levels = (float(row["level"]), float(row["level2"]))
        plain = all(math.isnan(level) for level in levels)
        taken = all(row[name] == value for name, value in wanted_row.items())
        if taken and not_applicable(str(row.get("status", "ok"))):
            skipped.add(_label(row))
        if not taken or not (plain or stressed) or int(row["n"]) < 1:
            continue
        key = (row["scene"], row["stress"], repr(levels[0]), row["stress2"], repr(levels[1]), row["seed"])
        mine = cells.setdefault(_label(row), {})
        if key in mine:
            raise InputError("An estimator has the same cell twice.", where=_label(row), value=str(key))
        mine[key] = row
    # An estimator that applies to a part of the scenes only, or to which the suite gives no more, cannot be compared on the
    # others: it is not ranked.
    for name in skipped | partial_readers({name: {str(key[0]) for key in mine} for name, mine in cells.items()}):
        cells.pop(name, None)
    if not cells:
        raise InputError("There is no row to rank by.", where="scores", value=", ".join(wanted_row.values()))
    names = sorted(cells)
    wanted = set().union(*cells.values())
    for name in names:
        if missing := wanted - cells[name].keys():
            raise InputError(
                "An estimator lacks a cell that another has.", where=name, value=str(sorted(map(str, missing))[0]),
                next_step="rank estimators of one run, or run the missing cells with --resume",
            )  # fmt: skip
    scenes = sorted({str(key[0]) for key in wanted})
    square, refused, n = (np.zeros((len(names), len(scenes))) for _ in range(3))
    for i, name in enumerate(names):
        for key, row in cells[name].items():
            j, count = scenes.index(str(key[0])), float(row["n"])
            square[i, j] += count * float(row["rmse_full"]) ** 2
            refused[i, j] += count * (1.0 - float(row["coverage"]))
            n[i, j] += count
    return ScoreMatrix(names, scenes, np.sqrt(square / n), refused, n)


def compare_estimators(
    matrix: ScoreMatrix, *, tiles: list[tuple[Float, Float]] | None = None, alpha: float = 0.05
) -> Comparison:
    """Rank, compare in pairs and profile.

    Main arguments:
        matrix: see `score_matrix`.
    Other arguments:
        tiles: errors by tile in each scene of the matrix, (sums (estimator, tile), counts). With fewer scenes than an interval
        needs, ranks rest on them; without them they are 1 to the number of estimators.
        alpha: family-wise error rate.

    A figure of exactly zero (a noise-free scene) is replaced by the root of the smallest positive number, so that its
    logarithm exists; estimators that are equal there remain equal.
    """
    figures = np.maximum(matrix.rmse_full, 1e-150)
    pairs = pairwise(matrix.names, figures, alpha=alpha)
    found = studentised(np.log(figures))
    low_of, high_of = np.exp(found.low), np.exp(found.high)
    basis = "scenes" if len(matrix.scenes) >= MIN_SCENES else ""
    if not basis and tiles is not None and (by_tile := compare_by_tiles(matrix.names, tiles, alpha=alpha)) is not None:
        pairs, low_of, high_of, basis = by_tile.pairs, by_tile.low, by_tile.high, "tiles"
    beaten = dict.fromkeys(matrix.names, 0)
    beats = dict.fromkeys(matrix.names, 0)
    for pair in pairs:
        if pair.winner:
            beats[pair.winner] += 1
            beaten[pair.a if pair.winner == pair.b else pair.b] += 1
    ranked = []
    for i, name in enumerate(matrix.names):
        share, low, high = clustered_interval(matrix.n[i] - matrix.refused[i], matrix.n[i])
        ranked.append(
            Ranked(
                name, float(np.exp(found.mean[i])), float(low_of[i]), float(high_of[i]),
                1 + beaten[name], len(matrix.names) - beats[name], share, low, high,
            )
        )  # fmt: skip
    ranked.sort(key=lambda r: (r.rmse_full, r.name))
    return Comparison(ranked, pairs, performance_profiles(matrix.names, figures), basis)
