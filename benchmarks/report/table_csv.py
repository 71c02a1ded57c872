"""The page's table as CSV: the same cells, as numbers in the units of scores.csv."""

from __future__ import annotations

from typing import Any

from ..scores.tables import to_csv
from .cell import Cell

__all__ = ["CSV_COLUMNS", "table_csv"]

CSV_COLUMNS = (
    "scene", "condition", "stress", "level", "stress2", "level2", "estimator", "modality", "stage", "quantity", "unit",
    "seeds", "n", "rmse_full", "rmse_full_lo", "rmse_full_hi", "coverage", "rmse", "bias", "p95", "bound", "bound_kind",
    "efficiency", "z_rms", "cover95", "failure_rate", "cpu_per_element_s", "cpu_lo", "cpu_hi", "throughput", "peak_bytes",
    "verdict", "status",
)  # fmt: skip
_RENAMED = {"estimator": "label", "rmse_full_lo": "error_lo", "rmse_full_hi": "error_hi"}


def table_csv(cells: list[Cell]) -> str:
    """CSV text, one row per cell in the order given; `verdict` is that of the speed-accuracy chart."""
    rows: list[dict[str, Any]] = [{name: getattr(c, _RENAMED.get(name, name)) for name in CSV_COLUMNS} for c in cells]
    return to_csv(rows, CSV_COLUMNS)
