"""The figures of a run that a gate compares, and the baseline: the same figures in one small JSON file.

A baseline holds, per cell (scene, stress, level, seed, condition), the hash of what the estimators read, and per estimator and
quantity the figures of `Row`; errors by tile where an estimator has few cells (`_FEW`, `_SOME`), and who wrote it, when and why.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...estimators.labels import label_of
from ...scenes.errors import InputError, other_version, reason
from ..folders.files import write_text
from ..report.data import read_run
from ..scores.error_tiles import read_tiles
from ..scores.inputs import read_inputs
from ..scores.tables import read_scores
from ..statistics.skips import not_applicable
from .refusals import no_json

__all__ = ["CellKey", "Figures", "Row", "RowKey", "folded", "read_baseline", "read_figures", "write_baseline"]

#: (scene, stress, level, stress2, level2, seed, condition), as text.
CellKey = tuple[str, ...]
#: (label, stage, quantity).
Subject = tuple[str, str, str]
RowKey = tuple[Subject, CellKey]

_FORMAT, _VERSION = "beambench-baseline", 1
_NUMBERS = ("n", "coverage", "failure_rate", "rmse_full", "z_rms", "cpu_s", "peak_bytes")
#: An estimator with at most so many cells keeps all 64 tiles of each; with at most so many, 16; with more, none.
_FEW, _SOME = 4, 40
_HEAD = ("suite", "suite_version", "split", "tables_version", "commit", "machine", "versions", "written")


@dataclass(frozen=True)
class Row:
    """The figures of one estimator and quantity in one cell; NaN where unknown. Names as in scores.csv."""

    n: float
    coverage: float
    failure_rate: float
    rmse_full: float
    z_rms: float
    cpu_s: float
    peak_bytes: float
    status: str


@dataclass(frozen=True)
class Figures:
    """The figures of a run or a baseline.

    head: suite, versions, machine, who, when and why. inputs: hash of each cell ("" if unknown). rows: the figures.
    tiles: sums of squared errors of the main quantity, by (label, cell).
    """

    head: dict[str, Any]
    inputs: dict[CellKey, str]
    rows: dict[RowKey, Row]
    tiles: dict[tuple[str, CellKey], npt.NDArray[np.float64]] = field(default_factory=dict)
    where: str = ""

    def of_label(self, label: str, name: str) -> Figures:
        """Only the rows and tiles of one estimator, under another name."""
        rows = {((name, *s[1:]), cell): row for (s, cell), row in self.rows.items() if s[0] == label}
        if not rows:
            known = ", ".join(sorted({subject[0] for subject, _ in self.rows}))
            raise InputError("There is no such estimator.", where=self.where, value=label, allowed=known)
        tiles = {(name, cell): sums for (mine, cell), sums in self.tiles.items() if mine == label}
        return Figures(self.head, self.inputs, rows, tiles, self.where)


def folded(sums: npt.ArrayLike, size: int) -> npt.NDArray[np.float64]:
    """64 sums by tile as `size` sums of neighbours: 64, or 16 of 2 × 2 tiles each."""
    tiles = np.asarray(sums, np.float64)
    return tiles.reshape(4, 2, 4, 2).sum(axis=(1, 3)).ravel() if (tiles.size, size) == (64, 16) else tiles


def read_figures(folder: Path) -> Figures:
    """The figures of a run's folder.

    Raises:
        InputError: no score table, or one of the files is damaged.
    """
    table = read_scores(folder)
    run = read_run(folder)
    inputs = read_inputs(folder)
    rows: dict[RowKey, Row] = {}
    for row in table.to_dict(orient="records"):
        if not_applicable(str(row["status"])):
            continue
        cell = (
            row["scene"], row["stress"], _level(row["level"]), row["stress2"], _level(row["level2"]), str(int(row["seed"])),
            row["condition"],
        )  # fmt: skip
        subject = (label_of(row["estimator"], row["params"]), row["stage"], row["quantity"])
        key = (subject, cell)
        if key in rows:
            raise InputError("The score table has the same row twice.", where=str(folder), value=str(key))
        rows[key] = _row([float(row[name]) for name in _NUMBERS], str(row["status"]))
    tiles = {}
    plain = {(cell[0], cell[6], cell[5]): cell for _, cell in rows if cell[1] == cell[3] == "none"}
    for (scene, condition, seed, label), (sums, _) in read_tiles(folder).items():
        if (cell_key := plain.get((scene, condition, str(seed)))) is not None:
            tiles[label, cell_key] = sums
    head = {
        "suite": run.get("suite", str(table["suite"].iloc[0]) if len(table) else ""),
        "suite_version": run.get("version", 0), "split": run.get("split", ""),
        "tables_version": run.get("tables_version", 0), "machine": run.get("machine", {}),
        "versions": run.get("versions", {}), "commit": "", "written": {},
    }  # fmt: skip
    known = {cell for _, cell in rows}
    return Figures(head, {cell: inputs.get(cell, "") for cell in known}, rows, tiles, str(folder))


def _row(numbers: Sequence[float], status: str) -> Row:
    """A row from its figures in the order of `_NUMBERS`."""
    n, coverage, failure_rate, rmse_full, z_rms, cpu_s, peak_bytes = numbers
    return Row(n, coverage, failure_rate, rmse_full, z_rms, cpu_s, peak_bytes, status)


def _level(text: Any) -> str:
    return "" if str(text).lower() in ("", "nan") else str(text)


def write_baseline(path: Path, figures: Figures, written: Mapping[str, str], commit: str) -> None:
    """Write a baseline, completely or not at all: one line per cell and per row, so that a change is a readable diff."""
    cells = sorted(figures.inputs)
    number = {cell: k for k, cell in enumerate(cells)}
    count = Counter(label for label, _ in figures.tiles)
    head = figures.head | {"commit": commit, "written": dict(written)}
    rows = [
        [number[cell], *subject, *(_short(getattr(row, name)) for name in _NUMBERS), row.status]
        for (subject, cell), row in sorted(figures.rows.items())
    ]
    tiles = [
        [number[cell], label, [_short(x) for x in folded(sums, 64 if count[label] <= _FEW else 16)]]
        for (label, cell), sums in sorted(figures.tiles.items())
        if count[label] <= _SOME
    ]
    parts = [f'"format": "{_FORMAT}"', f'"version": {_VERSION}']
    parts += [f"{json.dumps(name)}: {json.dumps(head[name], sort_keys=True)}" for name in _HEAD]
    parts += [
        _lines("cells", [[*cell, figures.inputs[cell]] for cell in cells]),
        _lines("rows", rows),
        _lines("tiles", tiles),
    ]
    write_text(path, "{\n" + ",\n".join(parts) + "\n}\n")


def _short(value: float) -> float | None:
    """Nine significant digits, as in scores.csv; nothing for NaN, which JSON does not have."""
    return None if math.isnan(value) else float(f"{value:.9g}")


def _lines(name: str, rows: list[Any]) -> str:
    return f'"{name}": [\n' + ",\n".join(json.dumps(row, separators=(",", ":")) for row in rows) + "\n]"


def read_baseline(path: Path) -> Figures:
    """The figures of a baseline file, or of the folder of a run.

    Raises:
        InputError: there is no such file, or it is no baseline of this version.
    """
    if path.is_dir():
        return read_figures(path)
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(
            "There is no baseline.", where=str(path), allowed="a file written by gate --update, or the folder of a run",
            next_step=f"beambench gate RUN --baseline {path} --update --why 'first baseline'",
        ) from error  # fmt: skip
    except ValueError as error:
        raise no_json(path, error) from error
    except OSError as error:
        raise InputError(
            "The baseline cannot be read.", where=str(path), value=reason(error),
            next_step="check its permissions, or give another --baseline",
        ) from error  # fmt: skip
    if not isinstance(data, dict) or data.get("format") != _FORMAT:
        raise InputError(
            "The file is not a baseline.", where=str(path), allowed="a file written by beambench gate --update",
            next_step=f"beambench gate RUN --baseline {path} --update --why 'first baseline'",
        )  # fmt: skip
    if data.get("version") != _VERSION:
        raise other_version(
            "The baseline is of another version of its format.", where=str(path), found=data.get("version"), known=_VERSION,
            older=f"write it anew: beambench gate RUN --baseline {path} --update --why 'new version of baselines'",
        )  # fmt: skip
    try:
        cells = [tuple(map(str, cell)) for cell in data["cells"]]
        inputs = {cell[:-1]: cell[-1] for cell in cells}
        rows = {
            ((str(row[1]), str(row[2]), str(row[3])), cells[row[0]][:-1]): _row(
                [math.nan if value is None else float(value) for value in row[4:-1]], str(row[-1])
            )
            for row in data["rows"]
        }
        tiles = {(str(label), cells[k][:-1]): np.array(sums, np.float64) for k, label, sums in data["tiles"]}
        head = {name: data[name] for name in _HEAD}
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(
            "The baseline is damaged.", where=str(path), value=f"{type(error).__name__}: {error}",
            next_step="restore the file from version control",
        ) from error  # fmt: skip
    return Figures(head, inputs, rows, tiles, str(path))
