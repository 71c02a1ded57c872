"""`beambench report`."""

from __future__ import annotations

from pathlib import Path

__all__ = ["report"]


def report(folder: str | Path) -> Path:
    """Write report.html and the chart's PNG and SVG into the folder of a run, and return the page's path.

    Raises:
        InputError: the folder holds no score table, or a file of it cannot be read.
    """
    from ..benchmarks.report.page import write_report

    return write_report(folder)
