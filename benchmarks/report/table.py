"""The table of all scores on the page."""

from __future__ import annotations

from typing import Any

from .data import Cell, unit_scale
from .numbers import number, rate, span, timed_text

__all__ = ["score_table", "sorted_cells"]


def score_table(cells: list[Cell]) -> list[dict[str, Any]]:
    """One row per cell: scene and condition, marks, and (sort key, text) of every figure.

    Errors and bounds are in the unit of their quantity, which their text names where the table has several.
    """
    rows = []
    several = len({unit_scale(cell)[1] for cell in cells}) > 1
    several_quantities = len({cell.quantity.removesuffix("-mixed") for cell in cells}) > 1
    for cell in sorted_cells(cells):
        factor, unit = unit_scale(cell)
        stress = " ".join(filter(None, (cell.stress, cell.level, cell.stress2, cell.level2)))
        low, high = cell.efficiency_lo, cell.efficiency_hi
        efficiency = f" [{low:.2f}, {high:.2f}]" if low == low and high == high else ""
        after = f" {unit}" if several else ""
        errors = [
            (value * factor, number(value * factor) + interval + after)
            for value, interval in (
                (cell.rmse_full, span(cell.error_lo * factor, cell.error_hi * factor)),
                (cell.rmse, ""), (cell.bias, ""), (cell.p95, ""), (cell.bound, ""),
            )
        ]  # fmt: skip
        values: list[tuple[float, str]] = [
            errors[0],
            (cell.coverage, rate(cell.coverage)),
            *errors[1:],
            (cell.efficiency, f"{cell.efficiency:.3f}{efficiency}" if cell.efficiency == cell.efficiency else "–"),
            (cell.z_rms, number(cell.z_rms)),
            (cell.cover95, rate(cell.cover95)),
            (cell.failure_rate, rate(cell.failure_rate)),
            (cell.cpu_per_element_s, timed_text(cell.cpu_per_element_s, cell.cpu_lo, cell.cpu_hi)),
            (cell.throughput / 1e6, number(cell.throughput / 1e6)),
            (cell.peak_bytes / 2**20, number(cell.peak_bytes / 2**20)),
        ]
        rows.append(
            {
                "label": cell.label,
                "suspect": cell.suspect,
                "scene": cell.scene,
                "condition": cell.condition,
                "stress": stress,
                "unit": unit,
                "quantity": cell.quantity.removesuffix("-mixed") if several_quantities else "",
                "mixed": cell.mixed,
                "noun": cell.noun,
                "status": cell.status if cell.status.startswith("skip:") else cell.status.partition(":")[0],
                "ok": cell.ok,
                "fails": cell.fails,
                "verdict": cell.verdict,
                "values": [(f"{v:.9g}" if v == v else "", text) for v, text in values],
            }
        )
    return rows


def sorted_cells(cells: list[Cell]) -> list[Cell]:
    """The cells in the order of the table."""
    scenes = list(dict.fromkeys(cell.scene for cell in cells))
    return sorted(cells, key=lambda cell: _table_key(cell, scenes))


def _table_key(cell: Cell, scenes: list[str]) -> tuple[Any, ...]:
    """Scenes in the order of the run; in each, from the smallest error to the largest, cells without an error last."""
    error = cell.rmse_full if cell.rmse_full == cell.rmse_full else float("inf")
    return (scenes.index(cell.scene), cell.stress, cell.condition != "matched", cell.condition, cell.mixed, error)
