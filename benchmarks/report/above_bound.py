"""Results that are better than their bound: told wherever a run is told, because then one of the two is wrong."""

from __future__ import annotations

from .cell import Cell

__all__ = ["LEAST_ELEMENTS", "MOST_EFFICIENT", "above_bound"]

#: An efficiency above this, over at least so many elements, is told. The mean square of 100 independent errors scatters by 14 %.
MOST_EFFICIENT, LEAST_ELEMENTS = 1.2, 100


def above_bound(cells: list[Cell]) -> list[str]:
    """A sentence for every cell, seeds pooled, whose efficiency bound²/(mean square error) is above 1.2 over 100 elements."""
    return [
        f"{cell.label} has an efficiency of {cell.efficiency:.3g} in {cell.place} over {cell.n:.0f} {cell.noun}s, "
        f"better than its bound (kind {cell.bound_kind}) allows: {_why(cell.bound_kind)}"
        for cell in cells
        if cell.efficiency > MOST_EFFICIENT and cell.n >= LEAST_ELEMENTS
    ]


def _why(kind: str) -> str:
    if kind == "exact":
        return "the bound is wrong, or the answers know the truth or are drawn toward it."
    if kind == "quasi":
        return "the bound leaves out some of what the capture holds, or the answers are drawn toward the truth."
    return "this bound holds on average over ranges of the window, not for each."
