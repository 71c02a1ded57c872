"""The ranking on the page: ranking.csv of a run, with ranks as intervals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...estimators.labels import label_of
from ..scores.resolution import gives_up, pooled_response, read_resolution
from ..scores.tables import read_numbers
from .data import shown_as
from .numbers import number, rate, span
from .text import plural

__all__ = ["ranking_section", "read_pairs", "read_ranking"]

_GROUP = ("modality", "stage", "quantity", "condition")
_NUMBERS = (
    "scenes", "rank_lo", "rank_hi", "rmse_full", "rmse_full_lo", "rmse_full_hi", "coverage", "coverage_lo",
    "coverage_hi", "profile_best", "profile_area",
)  # fmt: skip

_WHOLE = ("scenes", "rank_lo", "rank_hi")
#: What the ranks on these scenes rest on, by `here`.
_BLOCKS = {
    "captures": "with new noise, poses and calibrations: errors are compared capture by capture, and captures drawn anew (block "
    "bootstrap).",
    "tiles": "with new noise: errors are compared tile by tile (8 × 8 tiles of an image, 64 of a record), and the tiles drawn anew "
    "(block bootstrap).",
}
_PAIR_NUMBERS = ("scenes", "ratio", "ratio_lo", "ratio_hi", "p", "p_holm")


def read_ranking(folder: Path) -> list[dict[str, Any]]:
    """The rows of ranking.csv; empty where the folder has no such file.

    Raises:
        InputError: the file is not such a table.
    """
    return read_numbers(folder / "ranking.csv", _NUMBERS, "The ranking", texts=(*_GROUP, "estimator"), whole=_WHOLE)


def read_pairs(folder: Path) -> list[dict[str, Any]]:
    """The rows of pairs.csv; empty where the folder has no such file.

    Raises:
        InputError: the file is not such a table.
    """
    return read_numbers(folder / "pairs.csv", _PAIR_NUMBERS, "The table of pairs", texts=(*_GROUP, "a", "b", "winner"))


def ranking_section(folder: Path) -> list[dict[str, Any]]:
    """One table per modality, quantity and condition: title, note, column heads and rows of text; the share of detail that each
    estimator keeps in the scenes without stress stands beside its error."""
    groups: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for row in read_ranking(folder):
        if not row["quantity"].endswith("-mixed"):
            groups.setdefault(tuple(row[name] for name in _GROUP), []).append(row)
    kept: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for row in read_resolution(folder):
        if row["stress"] == "none":
            label = label_of(row["estimator"], row["params"])
            kept.setdefault((row["stage"], row["quantity"], row["condition"], label), []).append(row)
    sections = []
    for key, rows in groups.items():
        scenes = int(rows[0]["scenes"])
        note = f"Over {plural(scenes, 'scene')} without stress. " + _basis(rows[0], rows)
        factor, unit = shown_as(rows[0]["modality"], rows[0]["quantity"], rows[0].get("unit", ""))
        head = [
            "rank",
            "estimator",
            f"RMSE over scenes, {unit}",
            "coverage",
            "best on",
            "area of profile",
            "detail kept",
        ]
        shown = [[*_row(row, factor), _kept(kept.get((*key[1:], row["estimator"]), []))] for row in rows]
        if _both(rows[0]) and len(rows) > 1:
            head.insert(1, "on these scenes")
            for cells, row in zip(shown, rows, strict=True):
                cells.insert(1, _ranks(float(row["here_lo"]), float(row["here_hi"])))
        sections.append({
            "title": f"{key[0]}, {key[2]}, {key[3]}", "note": note, "head": head, "rows": shown,
        })  # fmt: skip
    return sections


def _kept(rows: list[dict[str, Any]]) -> str:
    """The share of detail that an estimator keeps, with its 95 % interval; "" where the scenes have too little."""
    share, error = found = pooled_response(rows)
    if not rows:
        return ""
    return f"{share:.2f} ± {1.96 * error:.2f}" + (" (gives up resolution)" if gives_up(found) else "")


def _basis(first: dict[str, Any], rows: list[dict[str, Any]]) -> str:
    """What the ranks and the intervals of a group rest on, and what they hold for."""
    if len(rows) == 1:
        return "There is one estimator, so nothing to rank."
    if first["scenes"] >= 6:
        note = "Ranks and intervals are over scenes: they hold for other scenes of the kind."
        return note + (f" Ranks on these scenes hold for these, {_BLOCKS[first['here']]}" if _both(first) else "")
    if first.get("basis") not in _BLOCKS:
        return "Ranks and intervals need six scenes, or fifteen captures of each, or errors by tile: all ranks remain open."
    note = f"That is too few to speak of other scenes. Ranks and intervals hold for these scenes, {_BLOCKS[first['basis']]}"
    if any(row["rmse_full_lo"] != row["rmse_full_lo"] for row in rows):
        note += " An estimator without an interval has most of its error in a few of them; its rank remains open."
    return note


def _both(first: dict[str, Any]) -> bool:
    """Whether ranks are over scenes, and others on these scenes beside them."""
    return bool(first["scenes"] >= 6 and first.get("here") in _BLOCKS)


def _ranks(low: float, high: float) -> str:
    return f"{low:.0f}" if low == high else f"{low:.0f} to {high:.0f}"


def _row(row: dict[str, Any], factor: float) -> list[str]:
    return [
        _ranks(row["rank_lo"], row["rank_hi"]),
        row["estimator"],
        number(row["rmse_full"] * factor) + span(row["rmse_full_lo"] * factor, row["rmse_full_hi"] * factor),
        rate(row["coverage"]),
        f"{rate(row['profile_best'])} of scenes",
        number(row["profile_area"]),
    ]
