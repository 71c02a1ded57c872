"""Compare captures bit by bit: how many values differ, and by how much."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Comparison", "VariableComparison", "compare_captures", "compare_stores"]

_NOT_CONTENT = ("provenance",)


@dataclass(frozen=True)
class VariableComparison:
    """Comparison of one variable of two captures.

    Main arguments:
        name: name of the variable.
        size: number of values compared.
        differing: number of values whose bits differ; NaN equals NaN of the same bits, 0 differs from −0.
        max_abs: largest absolute difference of finite values, in the unit of the variable; NaN without finite values.
        note: reason why the values cannot be compared (the variable is missing in one capture, or its dimensions, shape
            or dtype differ); then `differing` equals `size`.
    """

    name: str
    size: int
    differing: int
    max_abs: float
    note: str = ""

    def __str__(self) -> str:
        if self.note:
            return f"{self.name}: {self.note}"
        if not self.differing:
            return f"{self.name}: equal bits ({self.size} values)"
        share = self.differing / self.size
        return (
            f"{self.name}: {self.differing} of {self.size} values differ ({share:.2g}), by {self.max_abs:.3g} at most"
        )


@dataclass(frozen=True)
class Comparison:
    """Comparison of two captures: their variables, and the names of the attributes that differ."""

    variables: tuple[VariableComparison, ...]
    attributes: tuple[str, ...]

    @property
    def differing(self) -> int:
        """Number of values that differ in all variables."""
        return sum(variable.differing for variable in self.variables)

    @property
    def equal(self) -> bool:
        """Whether every variable has equal bits, and every attribute except `provenance` is equal."""
        comparable = all(not variable.note for variable in self.variables)
        return comparable and not self.differing and set(self.attributes) <= set(_NOT_CONTENT)

    def __str__(self) -> str:
        if self.equal:
            lines = [f"equal bits in {len(self.variables)} variables"]
        else:
            lines = [str(variable) for variable in self.variables if variable.differing or variable.note]
        if self.attributes:
            lines.append(f"attributes that differ: {', '.join(self.attributes)}")
        return "\n".join(lines)


def compare_captures(a: xr.Dataset, b: xr.Dataset) -> Comparison:
    """Compare two captures bit by bit. A variable that one of them lacks is reported in `note` and raises no error."""
    names = [str(name) for name in a.variables] + [str(name) for name in b.variables if name not in a.variables]
    variables = tuple(_variable(name, a.variables.get(name), b.variables.get(name)) for name in names)
    attributes = sorted({*a.attrs, *b.attrs}, key=str)
    different = tuple(str(name) for name in attributes if not _same(a.attrs.get(name), b.attrs.get(name)))
    return Comparison(variables, different)


def compare_stores(a: str | os.PathLike[str], b: str | os.PathLike[str]) -> list[Comparison]:
    """Compare two stores capture by capture, one pair in memory at a time.

    Raises InputError if a store cannot be read, or if the stores hold different numbers of captures.
    """
    from ..scenes.errors import InputError
    from .store.faces import open_captures

    first, second = open_captures(a), open_captures(b)
    if len(first) != len(second):
        raise InputError(
            "The stores hold different numbers of captures.",
            where=f"{os.fspath(a)}, {os.fspath(b)}", value=(len(first), len(second)), allowed="equal numbers",
        )  # fmt: skip
    return [compare_captures(first[i], second[i]) for i in range(len(first))]


def _variable(name: str, a: xr.Variable | None, b: xr.Variable | None) -> VariableComparison:
    if a is None or b is None:
        present = b if a is None else a
        size = 0 if present is None else present.size
        return VariableComparison(name, size, size, np.nan, f"only in the {'second' if a is None else 'first'}")
    for what, x, y in (("dims", a.dims, b.dims), ("shape", a.shape, b.shape), ("dtype", a.dtype, b.dtype)):
        if x != y:
            return VariableComparison(name, a.size, a.size, np.nan, f"{what} {x} and {y}")
    x, y = np.ascontiguousarray(a.values), np.ascontiguousarray(b.values)
    differs = _bits(x, y)
    if not differs.any():
        return VariableComparison(name, a.size, 0, 0.0)
    left, right = x.reshape(-1)[differs], y.reshape(-1)[differs]
    kind = np.complex128 if x.dtype.kind == "c" else np.float64
    with np.errstate(invalid="ignore"):
        gap = np.abs(left.astype(kind) - right.astype(kind))
    finite = gap[np.isfinite(gap)]
    return VariableComparison(name, a.size, int(differs.sum()), float(finite.max()) if finite.size else np.nan)


def _bits(x: np.ndarray[Any, Any], y: np.ndarray[Any, Any]) -> np.ndarray[Any, np.dtype[np.bool_]]:
    if x.dtype.itemsize <= 8:
        unsigned = np.dtype(f"u{x.dtype.itemsize}")
        return np.asarray(x.reshape(-1).view(unsigned) != y.reshape(-1).view(unsigned))
    halves = x.reshape(-1).view(np.uint64) != y.reshape(-1).view(np.uint64)
    return np.asarray(halves.reshape(x.size, -1).any(axis=1))


def _same(a: object, b: object) -> bool:
    return type(a) is type(b) and bool(np.all(a == b))  # type: ignore[call-overload,operator]
