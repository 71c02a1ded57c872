"""Ranking of estimators by their error over all elements, from rows of a score table.

The figure is `rmse_full`: refused elements count with the error of a guess within the window, so that refusing difficult
elements gives no advantage. A crash counts as refusing everything. All estimators are ranked on the same cells; ranks are
intervals, from paired differences corrected for the number of pairs: for other scenes of the kind (`pairs`), and for these
(`here`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ...estimators.labels import label_of
from ...scenes.errors import InputError
from ..statistics.skips import not_applicable
from .bootstrap import MIN_SCENES, studentised
from .here import compare_here
from .pairs import Pair, pairwise
from .profiles import Profile, performance_profiles
from .rates import clustered_interval

__all__ = ["Comparison", "Ranked", "ScoreMatrix", "compare_estimators", "partial_readers", "score_matrix"]

Float = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ScoreMatrix:
    """Arrays (estimator, scene) of one condition and quantity: rmse over seeds and levels, number of refused elements.

    captures: per scene (sums of squared errors (estimator, capture), counts (capture)); empty where estimators differ in counts.
    """

    names: list[str]
    scenes: list[str]
    rmse_full: Float
    refused: Float
    n: Float
    captures: list[tuple[Float, Float]] = field(default_factory=list)


@dataclass(frozen=True)
class Ranked:
    """Rank of one estimator: geometric mean of `rmse_full` with its interval, rank interval, coverage with interval.

    `rank_low` − 1 others are significantly better at the family-wise level; all but `rank_high` are significantly worse.
    `here_low`, `here_high`: the same on these scenes, with new captures of them.
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
    here_low: int
    here_high: int


@dataclass(frozen=True)
class Comparison:
    """Comparison of the estimators in a score table: ranks (best first), all pairs, and profiles.

    basis: what ranks and intervals rest on: "scenes", then they hold for other scenes of the kind; "captures" or "tiles", then they
    hold for these scenes only; "" where nothing is decided.
    here: the pairs on these scenes, in the order of `pairs`; here_basis: "captures", "tiles", or "" where there are too few.
    """

    ranked: list[Ranked]
    pairs: list[Pair]
    profiles: list[Profile]
    basis: str = "scenes"
    here: list[Pair] = field(default_factory=list)
    here_basis: str = ""


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
    by_scene = [_of_scene(cells, names, scene) for scene in scenes]
    square, n, refused = (np.stack([one[k].sum(axis=1) for one in by_scene], axis=1) for k in range(3))
    alike = all(np.all(count == count[0]) for _, count, _ in by_scene)
    captures = [(sums, count[0]) for sums, count, _ in by_scene] if alike else []
    return ScoreMatrix(names, scenes, np.sqrt(square / n), refused, n, captures)


def _of_scene(
    cells: Mapping[str, Mapping[tuple[Any, ...], dict[str, Any]]], names: Sequence[str], scene: str
) -> npt.NDArray[np.float64]:
    """Sums of squared errors, counts and refused elements, (3, estimator, seed), pooled over levels."""
    keys = [key for key in cells[names[0]] if str(key[0]) == scene]
    seeds = {seed: at for at, seed in enumerate(sorted({key[-1] for key in keys}))}
    found = np.zeros((3, len(names), len(seeds)))
    for i, name in enumerate(names):
        for key in sorted(keys, key=repr):
            row = cells[name][key]
            count = float(row["n"])
            told = (count * float(row["rmse_full"]) ** 2, count, count * (1.0 - float(row["coverage"])))
            found[:, i, seeds[key[-1]]] += told
    return found


def compare_estimators(
    matrix: ScoreMatrix, *, tiles: list[tuple[Float, Float]] | None = None, alpha: float = 0.05
) -> Comparison:
    """Rank, compare in pairs and profile.

    Main arguments:
        matrix: see `score_matrix`.
    Other arguments:
        tiles: errors by tile in each scene of the matrix, (sums (estimator, tile), counts): what is decided on these scenes rests
        on them where there are too few captures of a scene. With fewer scenes than an interval over scenes needs, all rests on what
        is decided here; without that, ranks are 1 to the number of estimators.
        alpha: family-wise error rate.

    A figure of exactly zero (a noise-free scene) is replaced by the root of the smallest positive number, so that its
    logarithm exists; estimators that are equal there remain equal.
    """
    figures = np.maximum(matrix.rmse_full, 1e-150)
    pairs = pairwise(matrix.names, figures, alpha=alpha)
    found = studentised(np.log(figures))
    low_of, high_of = np.exp(found.low), np.exp(found.high)
    basis = "scenes" if len(matrix.scenes) >= MIN_SCENES else ""
    here, here_basis = None, ""
    for source, blocks in (("captures", matrix.captures), ("tiles", tiles)):
        if here is None and blocks and (here := compare_here(matrix.names, blocks, alpha=alpha)) is not None:
            here_basis = source
    if not basis and here is not None:
        pairs, low_of, high_of, basis = here.pairs, here.low, here.high, here_basis
    return Comparison(
        _ranked(matrix, pairs, here.pairs if here else [], (np.exp(found.mean), low_of, high_of)),
        pairs, performance_profiles(matrix.names, figures), basis, here.pairs if here else [], here_basis,
    )  # fmt: skip


def _ranked(
    matrix: ScoreMatrix, pairs: Sequence[Pair], here: Sequence[Pair], figures: tuple[Float, Float, Float]
) -> list[Ranked]:
    """Ranks of all estimators, the best first, from figures (mean, low, high)."""
    low, high = _ranks(matrix.names, pairs)
    here_low, here_high = _ranks(matrix.names, here)
    ranked = []
    for i, name in enumerate(matrix.names):
        share, least, most = clustered_interval(matrix.n[i] - matrix.refused[i], matrix.n[i])
        mean, below, above = (float(figure[i]) for figure in figures)
        ranked.append(
            Ranked(name, mean, below, above, low[name], high[name], share, least, most, here_low[name], here_high[name])
        )
    return sorted(ranked, key=lambda r: (r.rmse_full, r.name))


def _ranks(names: Sequence[str], pairs: Sequence[Pair]) -> tuple[dict[str, int], dict[str, int]]:
    """The least and the largest rank of each name."""
    beaten, beats = dict.fromkeys(names, 0), dict.fromkeys(names, 0)
    for pair in pairs:
        if pair.winner:
            beats[pair.winner] += 1
            beaten[pair.a if pair.winner == pair.b else pair.b] += 1
    return {name: 1 + beaten[name] for name in names}, {name: len(names) - beats[name] for name in names}
