"""The command `bound`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..console import print_table, score_records
from .build import Arguments, View, command

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["BOUND"]

_NUMBERS = ("bound_median", "bound_rms", "prior", "scale", "window")


def _json(table: pd.DataFrame, given: Arguments) -> dict[str, Any]:
    return {"rows": score_records(table.to_dict(orient="records"))}


def _text(table: pd.DataFrame, given: Arguments) -> None:
    columns = [str(name) for name in table.columns]
    rows = [[f"{row[n]:.4g}" if n in _NUMBERS else str(row[n]) for n in columns] for row in table.to_dict("records")]
    print_table(columns, rows, right=("capture", "elements", "informed", *_NUMBERS))


BOUND = command(
    "bound",
    "bound:bound",
    View(_text, _json),
    examples="Examples:\n  beambench bound step.zarr\n  beambench bound step.zarr --json",
)
