"""The response R(u) = ∫ p(t) g(t + u) dt of a pulse p and a gate g: a *correlation*, in closed form for every pair.

An echo that arrives u after the gate's opening edge is recorded with weight R(u); in slice k, u = 2 n_g r/c − t_k.
A convolution would mirror the pulse, which is wrong for an asymmetric one.

Public face of three files: `forms` (the closed forms), `table` (tables of R and their NumPy lookup) and `hermite` (the
compiled lookup, imported on first use because importing Numba takes half a second).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .forms import correlation, correlation_kinks, correlation_slope, correlation_support
from .table import Table, lookup, tabulate

if TYPE_CHECKING:
    from .hermite import hermite_slope, hermite_value

__all__ = [
    "Table", "correlation", "correlation_kinks", "correlation_slope", "correlation_support", "hermite_slope",
    "hermite_value", "lookup", "tabulate",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in ("hermite_slope", "hermite_value"):
        from . import hermite

        return getattr(hermite, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
