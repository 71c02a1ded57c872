"""Croissant: a WebDataset, a table of its samples, and `croissant.json`, which mlcroissant validates and reads.

Source: MLCommons, Croissant format specification 1.1; M. Akhtar et al., Croissant, a metadata format for ML-ready datasets, 2024.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..layouts import layout_of
from .croissant_text import croissant_text
from .form import Format
from .place import Place
from .selection import Piece, Selection
from .webdataset import BYTES_PER_FILE, write_samples

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["CROISSANT", "CROISSANT_FILE", "SAMPLES"]

CROISSANT_FILE, SAMPLES = "croissant.json", "samples.parquet"


def _write(piece: Piece, paths: list[Path]) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []

    def each(key: str, capture: xr.Dataset, facts: dict[str, Any]) -> None:
        plain = {name: value for name, value in facts.items() if name not in ("drawn", "part")}
        drawn = {f"drawn_{name}": _cell(value) for name, value in facts.get("drawn", {}).items()}
        place = {"key": key, "split": piece.part, "group": piece.source.name, "file": piece.files[0]}
        rows.append(place | plain | drawn | _numbers(capture))

    write_samples(piece, paths, each)
    return rows


def _cell(value: Any) -> Any:
    return value if isinstance(value, int | float | str) and not isinstance(value, bool) else json.dumps(value)


def _numbers(capture: xr.Dataset) -> dict[str, float]:
    """Least, mean and greatest finite value of what was measured, and of the first quantity that is estimated from it."""
    layout = layout_of(capture.attrs["modality"])
    truths = [f"truth_{one.name}" for one in layout.quantities if f"truth_{one.name}" in capture.variables][:1]
    found: dict[str, float] = {}
    for name in (layout.data, *truths):
        if name not in capture.variables:
            continue
        values = np.asarray(capture[name].values, np.float64)
        finite = values[np.isfinite(values)]
        for word, of in (("min", np.min), ("mean", np.mean), ("max", np.max)):
            found[f"{name}_{word}"] = float(of(finite)) if finite.size else float("nan")
    return found


def _table(rows: list[dict[str, Any]]) -> bytes:
    """The samples in the order of their numbers; a column that a row lacks is null there."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = sorted(rows, key=lambda row: (row["group"], row["capture"]))
    columns: dict[str, Any] = {}
    for name in dict.fromkeys(key for row in rows for key in row):
        values = [row.get(name) for row in rows]
        known = [value for value in values if value is not None]
        if any(isinstance(value, str) for value in known):
            columns[name] = pa.array([value if value is None else str(value) for value in values], pa.string())
        else:
            whole = all(isinstance(value, int) for value in known)
            columns[name] = pa.array(values, pa.int64() if whole else pa.float64())
    file = io.BytesIO()
    pq.write_table(pa.table(columns), file, compression="zstd")
    return file.getvalue()


def _more(selection: Selection, place: Place, key: str) -> Mapping[str, bytes]:
    rows = [row for one in place.done.values() for row in one.facts]
    table = _table(rows)
    files = {name: told for one in place.done.values() for name, told in one.files.items()}
    groups = {
        source.name: {"files": sorted({row["file"] for row in rows if row["group"] == source.name}), "source": source}
        for source in selection.sources
    }  # fmt: skip
    text = croissant_text(selection, key, groups, files, SAMPLES, table)
    return {SAMPLES: table, CROISSANT_FILE: text}


def _pieces(selection: Selection, per_file: int | None, key: str) -> list[Piece]:
    # mlcroissant unpacks an archive into a folder named by its address alone, where equal names of two data sets would meet.
    return selection.packed(".tar", per_file, BYTES_PER_FILE, stem=f"-{key}")


CROISSANT = Format(_pieces, _write, more=_more)
