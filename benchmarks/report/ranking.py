"""The ranking on the page: ranking.csv of a run, with ranks as intervals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..scores.tables import read_numbers
from .data import shown_as
from .text import number, plural, rate, span

__all__ = ["ranking_section", "read_ranking"]

_GROUP = ("modality", "stage", "quantity", "condition")
_NUMBERS = (
    "scenes", "rank_lo", "rank_hi", "rmse_full", "rmse_full_lo", "rmse_full_hi", "coverage", "coverage_lo",
    "coverage_hi", "profile_best", "profile_area",
)  # fmt: skip


def read_ranking(folder: Path) -> list[dict[str, Any]]:
    """The rows of ranking.csv; empty where the folder has no such file.

    Raises:
        InputError: the file is not such a table.
    """
    return read_numbers(folder / "ranking.csv", _NUMBERS, "The ranking")


def ranking_section(folder: Path) -> list[dict[str, Any]]:
    """One table per modality, quantity and condition: title, note, column heads and rows of text."""
    groups: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for row in read_ranking(folder):
        if not row["quantity"].endswith("-mixed"):
            groups.setdefault(tuple(row[name] for name in _GROUP), []).append(row)
    sections = []
    for key, rows in groups.items():
        scenes = int(rows[0]["scenes"])
        note = f"Over {plural(scenes, 'scene')} without stress."
        if scenes < 6:
            note += " Ranks and intervals need at least six scenes; with fewer, all ranks remain open."
        factor, unit = shown_as(rows[0]["modality"], rows[0]["quantity"], rows[0].get("unit", ""))
        head = ("rank", "estimator", f"RMSE over scenes, {unit}", "coverage", "best on", "area of profile")
        sections.append({
            "title": f"{key[0]}, {key[3]}", "note": note, "head": head, "rows": [_row(row, factor) for row in rows],
        })  # fmt: skip
    return sections


def _row(row: dict[str, Any], factor: float) -> list[str]:
    low, high = int(row["rank_lo"]), int(row["rank_hi"])
    return [
        str(low) if low == high else f"{low} to {high}",
        row["estimator"],
        number(row["rmse_full"] * factor) + span(row["rmse_full_lo"] * factor, row["rmse_full_hi"] * factor),
        rate(row["coverage"]),
        f"{rate(row['profile_best'])} of scenes",
        number(row["profile_area"]),
    ]
