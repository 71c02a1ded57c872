"""inputs.csv: what the estimators of a run read, one row per capture and condition, known by a hash of its contents.

Two runs whose rows have equal `sha256` gave their estimators equal numbers: their errors can be compared in pairs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ..folders.files import write_text
from ..suites.suite import Cell
from .tables import read_numbers, to_csv

__all__ = ["INPUT_COLUMNS", "input_rows", "read_inputs", "write_inputs"]

INPUT_COLUMNS = ("scene", "stress", "level", "stress2", "level2", "seed", "condition", "sha256")


def input_rows(cell: Cell, hashes: Mapping[str, str]) -> list[dict[str, Any]]:
    """The rows of a cell, from the hash of its capture under each condition."""
    axes = {
        "scene": cell.scene_name, "stress": cell.stress, "level": cell.level, "stress2": cell.stress2,
        "level2": cell.level2, "seed": cell.seed,
    }  # fmt: skip
    return [{**axes, "condition": condition, "sha256": value} for condition, value in hashes.items()]


def write_inputs(folder: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write inputs.csv of a run, its rows sorted by key, completely or not at all."""
    ordered = sorted(rows, key=lambda row: tuple(str(row[name]) for name in INPUT_COLUMNS))
    write_text(folder / "inputs.csv", to_csv([dict(row) for row in ordered], INPUT_COLUMNS))


def read_inputs(folder: Path) -> dict[tuple[str, ...], str]:
    """{(scene, stress, level, stress2, level2, seed, condition), all as text: sha256}; empty without the file.

    Raises:
        InputError: the file is not such a table.
    """
    rows = read_numbers(folder / "inputs.csv", (), "The table of inputs", texts=INPUT_COLUMNS)
    return {tuple(str(row[name]) for name in INPUT_COLUMNS[:-1]): str(row["sha256"]) for row in rows}
