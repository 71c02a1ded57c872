"""Two score tables compared: read, checked to mean the same, and paired row by row."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...estimators.labels import label_of
from ...scenes.errors import InputError
from ..scores.tables import read_scores
from .data import read_run

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["compare_tables"]


def compare_tables(a: str | Path, b: str | Path) -> pd.DataFrame:
    """Changes from table A to table B, one row per scene, stress, condition and estimator that both have.

    See `statistics.changes` for the columns. The attribute `unpaired` counts the rows of A and of B without a partner,
    `over_scenes` holds the records of `changes_over_scenes`, and `machines_differ` lists the differences between the
    machines of two runs: then `cpu_ratio` is NaN, since it would measure the machines.

    Main arguments:
        a, b: Folders of runs, or their scores.csv or scores.parquet.

    Raises:
        InputError: No score table, no row in common, a row given twice, or tables whose columns mean different things.
    """
    import pandas as pd

    from ..statistics.changes import KEY, changes_by_cell, changes_over_scenes

    first, second = read_scores(a), read_scores(b)
    for name, table in ((a, first), (b, second)):
        if table.duplicated(KEY).any():
            raise InputError("A score table has the same row twice.", where=str(name))
    both = first.merge(second, on=KEY, how="outer", suffixes=("_a", "_b"), indicator=True)
    paired = both[both["_merge"] == "both"]
    if not len(paired):
        raise InputError(
            "The two tables have no row in common.",
            where=f"{a}, {b}",
            allowed="tables of one suite: equal scenes, seeds, conditions and estimators",
        )
    runs = [read_run(folder if folder.is_dir() else folder.parent) for folder in map(Path, (a, b))]
    _check_versions(runs, f"{a}, {b}")
    differ = _machines_differ(*runs)
    result = pd.DataFrame([_labelled(row) for row in changes_by_cell(paired, times=not differ)])
    result.attrs["unpaired"] = (int((both["_merge"] == "left_only").sum()), int((both["_merge"] == "right_only").sum()))
    result.attrs["machines_differ"] = differ
    result.attrs["over_scenes"] = [_labelled(row) for row in changes_over_scenes(paired)]
    return result


def _labelled(row: dict[str, Any]) -> dict[str, Any]:
    """The record with the estimator's label in place of its name and parameters."""
    label = label_of(row["estimator"], row["params"])
    return {name: label if name == "estimator" else value for name, value in row.items() if name != "params"}


def _check_versions(runs: list[dict[str, Any]], where: str) -> None:
    """Refuse runs whose tables follow different versions of the contract; a table without a run record is accepted."""
    found = [run.get("tables_version", 1) for run in runs if run]
    if len(set(found)) > 1:
        raise InputError(
            "The tables follow different versions of the contract, between which columns changed their meaning.",
            where=where,
            value=", ".join(f"tables_version {version}" for version in found),
            allowed="equal versions",
            next_step="run the older suite again with this version of beambench",
        )


def _machines_differ(a: dict[str, Any], b: dict[str, Any]) -> list[str]:
    """Differences between the machines of two runs; none if one of them does not name its machine."""
    first, second = a.get("machine"), b.get("machine")
    if not isinstance(first, dict) or not isinstance(second, dict):
        return []
    return [
        f"{name} {first[name]} and {second[name]}"
        for name in ("device_class", "processor", "threads_per_estimator")
        if name in first and name in second and first[name] != second[name]
    ]
