"""`beambench compare`: two score tables, paired."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["compare"]


def compare(a: str | Path, b: str | Path) -> pd.DataFrame:
    """Compare two score tables, A and B, paired by scene, seed and estimator.

    Ratios are B/A with a 95 % interval; a ratio below 1 is an improvement. The first table is over the scenes without stress
    and holds for other scenes of the kind; the second is cell by cell over seeds. Times from different kinds of
    machines are not compared.

    Main arguments:
        a: Folder of a run, or its scores.csv or scores.parquet.
        b: The same of the run to compare with it.

    Returns:
        One row per scene, stress, condition and estimator that both tables have: `error_ratio` and `cpu_ratio` with `_lo` and
        `_hi` (geometric means over pairs of B/A of rmse_full and cpu_s; 95 % t interval over seeds), `coverage_change` and
        `failure_change` (mean of B - A), `pairs` and `status`. Attributes of the table: `over_scenes` (records of the same
        ratio over scenes with a bootstrap interval, p and p_holm), `unpaired` (rows of A and of B without a partner), and
        `machines_differ`.

    Raises:
        InputError: No score table, no row in common, or tables whose columns mean different things.
    """
    from ..benchmarks.report.compare import compare_tables

    return compare_tables(a, b)
