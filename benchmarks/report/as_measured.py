"""An estimate in a few words, as soon as it is scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .data import shown_as
from .numbers import number

__all__ = ["as_measured"]


def as_measured(label: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """The words "peak: object1, matched, 21.0 mm rms", or what became of it. Elements that are not answered count with the error
    of the prior.

    Main arguments:
        label: of the estimator. rows: of scores.csv, of one capture and condition; the first quantity is told.
    """
    row = next((one for one in rows if not str(one["quantity"]).endswith("-mixed")), None)
    if row is None:
        return label
    said = f"{label}: {row['scene']}, {row['condition']}"
    if row["status"] != "ok":
        return f"{said}, {str(row['status']).partition(':')[0]}"
    factor, unit = shown_as(str(row["modality"]), str(row["quantity"]), str(row["unit"]))
    error = float(row["rmse_full"]) * factor
    return f"{said}, {number(error)} {unit} rms" if error == error else said
