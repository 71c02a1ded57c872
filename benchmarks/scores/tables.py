"""The score tables on disk: scores.csv, scores.parquet, accuracy.csv, summary.csv, ranking.csv, pairs.csv, profiles.csv.

Numbers are written with nine significant digits, NaN as an empty field, rows sorted by their key: the accuracy columns
of two runs with equal seeds are the same bytes.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...scenes.errors import InputError, reason
from ..folders.files import write_atomic, write_text
from ..statistics.tables import Tiles, inference_tables
from .score import ACCURACY, COLUMNS, KEY
from .summary import SUMMARY_COLUMNS, summarise

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["COLUMNS", "read_numbers", "read_scores", "sort_rows", "to_csv", "write_tables"]

_INTEGERS = ("seed", "n")
_TEXTS = (
    "suite", "scene", "stress", "stress2", "condition", "stage", "estimator", "params", "modality", "quantity", "unit",
    "bound_kind", "status",
)  # fmt: skip
#: Columns of levels, which are read as text, because their digits identify a cell.
_READ_AS_TEXT = (*_TEXTS, "level", "level2")


def _field(value: Any) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.9g}"
    return str(value)


def to_csv(rows: Iterable[dict[str, Any]], columns: Sequence[str]) -> str:
    """CSV text of the given columns (RFC 4180, with line feeds)."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_field(row[name]) for name in columns] for row in rows)
    return buffer.getvalue()


def _sort_key(row: dict[str, Any]) -> tuple[Any, ...]:
    """Key columns and quantity; NaN comes first, so that unchanged scenes precede stressed ones."""
    return tuple(
        (0, -math.inf) if isinstance(value, float) and math.isnan(value) else (1, value)
        for value in (row[name] for name in (*KEY, "quantity"))
    )


def sort_rows(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows, sorted by key."""
    return sorted(rows, key=_sort_key)


def write_tables(
    folder: Path, rows: Iterable[dict[str, Any]], tiles: Tiles | None = None, *, jail: bool | None = None
) -> None:
    """Write all tables of a run into `folder`, each completely or not at all.

    Other arguments:
        tiles: errors by tile, for the ranking. jail: whether the estimators were kept from the truth (`runner.jail.jailed`); None
            where that is not known, as for estimates from a file.
    """
    ordered = sort_rows(rows)
    write_text(folder / "scores.csv", to_csv(ordered, COLUMNS))
    write_text(folder / "accuracy.csv", to_csv(ordered, ACCURACY))
    write_text(folder / "summary.csv", to_csv(summarise(ordered), SUMMARY_COLUMNS))
    for name, (columns, found) in inference_tables(ordered, tiles, jail=jail).items():
        write_text(folder / name, to_csv(found, columns))
    write_atomic(folder / "scores.parquet", lambda path: _write_parquet(path, ordered))


def _write_parquet(path: Path, rows: list[dict[str, Any]]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    def kind(name: str) -> Any:
        return pa.string() if name in _TEXTS else pa.int64() if name in _INTEGERS else pa.float64()

    arrays = [pa.array([row[name] for row in rows], type=kind(name)) for name in COLUMNS]
    pq.write_table(pa.Table.from_arrays(arrays, names=list(COLUMNS)), path)


def read_scores(path: str | Path) -> pd.DataFrame:
    """Read a score table from the folder of a run, or from scores.csv or scores.parquet. All code reads them with this function.

    Texts and levels are text ("" if empty), all other columns floats (NaN if empty), `seed` and `n` whole ones; unknown columns
    are kept.

    Raises:
        InputError: there is no table, it cannot be read, or a column is missing or holds other values than (whole) numbers.
    """
    import pandas as pd

    path = Path(path)
    if path.is_dir():
        found = [path / name for name in ("scores.csv", "scores.parquet") if (path / name).is_file()]
        if not found:
            raise InputError(
                "The folder contains no score table.", where=str(path), allowed="a folder with scores.csv or scores.parquet",
                next_step="beambench run quickstart",
            )  # fmt: skip
        path = found[0]
    if not path.exists():
        raise InputError(
            "There is no such run.", where=str(path), allowed="the folder of a run, or its scores.csv or scores.parquet",
            next_step="check the path; runs without --out lie in beambench-runs/",
        )  # fmt: skip
    numbers = [name for name in COLUMNS if name not in _READ_AS_TEXT]
    try:
        if path.suffix == ".parquet":
            table = pd.read_parquet(path)
        else:
            # By default pandas would read a scene named "NA" as a missing value.
            blanks = {name: ["", "nan", "NaN"] for name in numbers}
            table = pd.read_csv(path, dtype=dict.fromkeys(_READ_AS_TEXT, str), keep_default_na=False, na_values=blanks)
    except (OSError, ValueError, UnicodeDecodeError) as error:
        raise InputError("The score table cannot be read.", where=str(path), value=reason(error)) from error
    missing = [name for name in COLUMNS if name not in table.columns]
    if missing:
        raise InputError(
            "The table is not a score table: columns are missing.",
            where=str(path),
            value=missing,
            allowed="scores.csv or scores.parquet as `beambench run` writes it",
        )
    for name in _READ_AS_TEXT:
        table[name] = table[name].astype(object).fillna("").astype(str)
    for name in numbers:
        try:
            table[name] = pd.to_numeric(table[name]).astype(float)
        except (ValueError, TypeError) as error:
            raise InputError(
                "A column of numbers contains other values.", where=f"{path}: {name}", value=reason(error)
            ) from error
    for name in _INTEGERS:
        if (wrong := ~table[name].map(_is_whole)).any():
            raise InputError(
                "A column of whole numbers contains other values.",
                where=f"{path}: {name}", value=float(table[name][wrong].iloc[0]), allowed="whole numbers, 0 or more, below 2^63",
            )  # fmt: skip
    return table


def _is_whole(value: float) -> bool:
    return 0 <= value < 2**63 and value == int(value)


def read_numbers(
    path: Path, numbers: Sequence[str], what: str, *, texts: Sequence[str] = (), whole: Sequence[str] = ()
) -> list[dict[str, Any]]:
    """The rows of a CSV file, with the columns `numbers` as floats (NaN if empty); no rows if the file does not exist.

    Main arguments:
        path: the file. numbers: columns of numbers. what: name of the table in errors.
    Other arguments:
        texts: other columns that must be there. whole: those of `numbers` that are whole, and given in every row.

    Raises:
        InputError: the file is not such a table; the message begins with `what`.
    """
    if not path.is_file():
        return []
    try:
        with open(path, newline="", encoding="utf-8") as file:
            rows: list[dict[str, Any]] = [dict(row) for row in csv.DictReader(file)]
        for row in rows:
            for name in numbers:
                row[name] = float(row[name]) if row[name] else math.nan
            if wrong := [name for name in texts if not isinstance(row[name], str)]:
                raise ValueError(f"a row ends before {wrong[0]}")
            if wrong := [name for name in whole if not _is_whole(row[name])]:
                raise ValueError(f"{wrong[0]} is {row[wrong[0]]}, and no whole number")
    except (OSError, ValueError, KeyError, TypeError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{what} cannot be read.", where=str(path), value=reason(error)) from error
    return rows
