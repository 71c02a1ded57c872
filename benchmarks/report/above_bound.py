"""Results that are better than their bound, or without any error: told wherever a run is told, because then something is wrong."""

from __future__ import annotations

from pathlib import Path

from ..scores.tables import read_scores
from ..statistics.suspects import EXACT
from .cell import Cell
from .data import cells_of

__all__ = ["LEAST_ELEMENTS", "MOST_EFFICIENT", "above_bound", "bound_warnings"]

#: An efficiency above this, over at least so many elements, is told. The mean square of 100 independent errors scatters by 14 %.
MOST_EFFICIENT, LEAST_ELEMENTS = 1.2, 100


def above_bound(cells: list[Cell]) -> list[str]:
    """A sentence for every cell, seeds pooled, that is suspect (`statistics.suspects`; it is not ranked), or whose efficiency
    bound²/(mean square error) is above 1.2 over 100 elements."""
    return [
        sentence
        for cell in cells
        if (sentence := _suspect(cell) if cell.suspect else _efficient(cell) if _is_above(cell) else "")
    ]


def _is_above(cell: Cell) -> bool:
    return cell.efficiency > MOST_EFFICIENT and cell.n >= LEAST_ELEMENTS


def _efficient(cell: Cell) -> str:
    return (
        f"{cell.label} has an efficiency of {cell.efficiency:.3g} in {cell.place} over {cell.n:.0f} {cell.noun}s, "
        f"better than its bound (kind {cell.bound_kind}) allows: {_why(cell.bound_kind)}"
    )


def _suspect(cell: Cell) -> str:
    if cell.suspect == EXACT:
        told = "no error at all"
        why = "no estimate of noisy data is exact: the answers know the truth."
    else:
        told, why = f"an efficiency of {(cell.bound / cell.rmse) ** 2:.3g}", _why(cell.bound_kind)
    return (
        f"{cell.label} has {told} in {cell.place} over {cell.n:.0f} {cell.noun}s, better than its bound "
        f"(kind {cell.bound_kind}) allows, and is not ranked: {why}"
    )


def _why(kind: str) -> str:
    if kind == "exact":
        return "the bound is wrong, or the answers know the truth or are drawn toward it."
    if kind == "quasi":
        return "the bound leaves out some of what the capture holds, or the answers are drawn toward the truth."
    return "this bound holds on average over ranges of the window, not for each."


def bound_warnings(folder: Path) -> list[str]:
    """A warning for every result of a folder of tables that is better than its bound."""
    return [f"BoundWarning: {sentence}" for sentence in above_bound(cells_of(read_scores(folder)))]
