"""Tables of a run over its scenes: ranking.csv, pairs.csv and profiles.csv.

One group of rows per modality, stage, quantity and condition, from scenes without stress; groups are not compared with
each other. The column `basis` states what ranks and intervals rest on: "scenes" with six scenes or more; with fewer "captures", of
which a scene needs fifteen, or "tiles" of the main quantity, where the run kept its errors by tile: then they hold for these
scenes only; empty where all is open. `here`, `here_lo`, `here_hi`, `p_here`, `winner_here` are always of these scenes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from itertools import zip_longest
from typing import Any

import numpy as np
import numpy.typing as npt

from ...captures.layouts import is_main_quantity
from ...estimators.labels import label_of
from ..statistics.skips import not_applicable
from .pairs import holm
from .ranking import ScoreMatrix, compare_estimators, partial_readers, score_matrix
from .suspects import suspects_of

__all__ = ["PAIR_COLUMNS", "PROFILE_COLUMNS", "RANKING_COLUMNS", "Tiles", "inference_tables"]

_GROUP = ("modality", "stage", "quantity", "condition")
RANKING_COLUMNS = (
    *_GROUP, "estimator", "scenes", "rank_lo", "rank_hi", "rmse_full", "rmse_full_lo", "rmse_full_hi", "coverage",
    "coverage_lo", "coverage_hi", "profile_best", "profile_area", "basis", "jail", "here", "here_lo", "here_hi",
)  # fmt: skip
PAIR_COLUMNS = (
    *_GROUP, "a", "b", "scenes", "ratio", "ratio_lo", "ratio_hi", "p", "p_holm", "winner", "basis", "p_adjusted",
    "here", "p_here", "winner_here",
)  # fmt: skip
PROFILE_COLUMNS = (*_GROUP, "estimator", "factor", "share")
_JAIL = {True: "yes", False: "no", None: ""}

Float = npt.NDArray[np.float64]
#: {(scene, condition, seed, label): (sums, counts)}, see `scores.error_tiles`.
Tiles = Mapping[tuple[str, str, int, str], tuple[Float, Float]]


def inference_tables(
    rows: Iterable[dict[str, Any]], tiles: Tiles | None = None, *, jail: bool | None = None
) -> dict[str, tuple[tuple[str, ...], list[dict[str, Any]]]]:
    """{file name: (columns, rows)} from rows of a score table, for `tables.to_csv`, and from its errors by tile.

    Estimators that are suspect in a scene (`suspects`: no error at all, or better than the bound by more than chance) are in
    none of the three tables. `ratio` is the geometric mean over scenes of a's `rmse_full` over b's; `winner` is empty where
    `p_adjusted`, corrected for all pairs, is above 5 %; `p_holm` is `p` corrected by Holm's bound instead, for those who know
    nothing but `p`. `profile_best` and `profile_area`: see `profiles.py`. Groups with one estimator have a ranking and no pairs.
    `jail` of a ranking: "yes" or "no", whether the estimators were kept from the truth; "" if unknown.

    Raises:
        InputError: an estimator lacks a cell that another has, or has one twice.
    """
    table = list(rows)
    ranking: list[dict[str, Any]] = []
    pairs: list[dict[str, Any]] = []
    profiles: list[dict[str, Any]] = []
    for key in sorted({tuple(str(row[name]) for name in _GROUP) for row in table if int(row["n"]) > 0}):
        group = dict(zip(_GROUP, key, strict=True))
        mine = [row for row in table if all(row[name] == group[name] for name in _GROUP)]
        # A skip marks an estimator that applies to a part of the scenes only, and is not ranked.
        plain = [row for row in mine if _as_written(row) or not_applicable(str(row.get("status", "ok")))]
        suspect = suspects_of(row for row in plain if _as_written(row))
        plain = [row for row in plain if label_of(str(row["estimator"]), str(row["params"])) not in suspect]
        if not any(_as_written(row) for row in plain) or not _read_by_one(plain):
            continue
        matrix = score_matrix(
            plain, modality=group["modality"], stage=group["stage"], quantity=group["quantity"],
            condition=group["condition"],
        )  # fmt: skip
        found = compare_estimators(matrix, tiles=_tiles_of(matrix, group, tiles or {}))
        profile = {item.name: item for item in found.profiles}
        for row in found.ranked:
            ranking.append({
                **group, "estimator": row.name, "scenes": len(matrix.scenes), "rank_lo": row.rank_low,
                "rank_hi": row.rank_high, "rmse_full": row.rmse_full, "rmse_full_lo": row.low,
                "rmse_full_hi": row.high, "coverage": row.coverage, "coverage_lo": row.coverage_low,
                "coverage_hi": row.coverage_high, "profile_best": profile[row.name].best,
                "profile_area": profile[row.name].area, "basis": found.basis, "jail": _JAIL[jail],
                "here": found.here_basis, "here_lo": row.here_low, "here_hi": row.here_high,
            })  # fmt: skip
        bounds = holm([pair.p for pair in found.pairs])
        for pair, bound, here in zip_longest(found.pairs, bounds, found.here):
            pairs.append({
                **group, "a": pair.a, "b": pair.b, "scenes": pair.scenes, "ratio": pair.ratio, "ratio_lo": pair.low,
                "ratio_hi": pair.high, "p": pair.p, "p_holm": float(bound), "winner": pair.winner,
                "basis": found.basis, "p_adjusted": pair.p_adjusted, "here": found.here_basis,
                "p_here": here.p_adjusted if here else math.nan, "winner_here": here.winner if here else "",
            })  # fmt: skip
        for item in found.profiles:
            for factor, share in zip(item.factor, item.share, strict=True):
                profiles.append({**group, "estimator": item.name, "factor": float(factor), "share": float(share)})
    return {
        "ranking.csv": (RANKING_COLUMNS, ranking),
        "pairs.csv": (PAIR_COLUMNS, pairs),
        "profiles.csv": (PROFILE_COLUMNS, profiles),
    }


def _read_by_one(rows: list[dict[str, Any]]) -> bool:
    """Whether some estimator reads all scenes of a group: otherwise nobody can be ranked."""
    scenes: dict[str, set[str]] = {}
    for row in rows:
        if _as_written(row):
            scenes.setdefault(label_of(str(row["estimator"]), str(row["params"])), set()).add(str(row["scene"]))
    return len(partial_readers(scenes)) < len(scenes)


def _as_written(row: dict[str, Any]) -> bool:
    """True without stress: both levels are NaN."""
    return bool(row["level"] != row["level"] and row["level2"] != row["level2"] and int(row["n"]) > 0)


def _tiles_of(matrix: ScoreMatrix, group: Mapping[str, str], tiles: Tiles) -> list[tuple[Float, Float]] | None:
    """Errors by tile of a group, (sums (estimator, tile of every seed), counts) per scene; None where one lacks them."""
    if not is_main_quantity(group["stage"], group["quantity"]):
        return None
    found = []
    for scene in matrix.scenes:
        seeds = sorted({key[2] for key in tiles if key[:2] == (scene, group["condition"]) and key[3] in matrix.names})
        keys = [[(scene, group["condition"], seed, name) for seed in seeds] for name in matrix.names]
        if not seeds or not all(key in tiles for row in keys for key in row):
            return None
        counts = [np.concatenate([tiles[key][1] for key in row]) for row in keys]
        if not all(np.array_equal(one, counts[0]) for one in counts):
            return None
        found.append((np.stack([np.concatenate([tiles[key][0] for key in row]) for row in keys]), counts[0]))
    return found
