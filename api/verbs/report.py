"""`beambench report`: the page of a run."""

from __future__ import annotations

from pathlib import Path

__all__ = ["report"]


def report(folder: str | Path) -> Path:
    """Write report.html into the folder of a run; beside it its chart, and its results as CSV, Markdown and LaTeX.

    Main arguments:
        folder: Folder of a run, with scores.csv or scores.parquet; run.json, pictures/, captures/ and fidelity/ are used if
            they exist.

    Returns:
        The path of the page.

    Raises:
        InputError: The folder holds no score table, or one of its files cannot be read.
    """
    from ..benchmarks.report.page import write_report

    return write_report(folder)
