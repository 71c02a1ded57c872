"""Slips of whoever wrote an answer, seen by what mends it: another unit, or rows and columns exchanged.

A change is told where the median error of the answered elements falls by `UNIT_FALL` or `ORDER_FALL` when it is made, and ends
below half of the median truth. A bad method has no such error: it is not smaller in another unit or order. Scores are those of the
answer as it stands; a slip is a warning, never a correction.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from ...captures.quantities import Quantity, Stage
from ...estimators.labels import label_of
from .truth import Truth, aligned, single_valued

__all__ = ["LEAST_ELEMENTS", "ORDER_FALL", "UNIT_FALL", "slip_warnings", "slips_of"]

Float = npt.NDArray[np.float64]
Array = npt.NDArray[Any]
Change = Callable[[Array], Array]

#: By how much the median error falls at least. Exchanged rows and columns of a scene of little depth err little: less is asked,
#: since no other mistake is mended by an exchange.
UNIT_FALL, ORDER_FALL = 10.0, 3.0
#: Elements that must say so together; fewer may do so by chance.
LEAST_ELEMENTS = 32
#: Unit of a quantity -> units that are written in its place by mistake, and how many of them are one of it.
_UNITS: Mapping[str, Mapping[str, float]] = {
    "m": {"mm": 1e3, "cm": 1e2},
    "rad": {"mrad": 1e3, "degrees": 180.0 / math.pi},
}
_ROWS, _COLS = ("row", "pupil_row", "image_row"), ("col", "pupil_col", "image_col")


def slips_of(stage: Stage, arrays: Mapping[str, npt.NDArray[Any]], truths: Mapping[str, Truth]) -> list[dict[str, Any]]:
    """What the answer to one capture is mended by: at most one row for each quantity.

    Main arguments:
        stage: of the estimator. arrays: its answer, by variable. truths: of the capture, by quantity.

    Returns rows with `quantity`, `slip` (a sentence of what is wrong), `elements` (how many say so), and the median errors
    `before` and `after` [unit of the quantity].
    """
    found = []
    for quantity in stage.gives:
        if quantity.name not in truths or not arrays:
            continue
        truth = truths[quantity.name]
        value, _, valid = aligned(dict(arrays), stage, quantity, truth.value.shape)
        if row := _slip(quantity, value, valid, truth):
            found.append(row)
    return found


def _slip(quantity: Quantity, value: Float, valid: npt.NDArray[np.bool_], truth: Truth) -> dict[str, Any]:
    """The change that leaves the smallest error, {} where none is worth telling."""
    chosen = single_valued(truth)
    before, _ = _median_error(value, valid, truth, chosen)
    best: dict[str, Any] = {}
    for told, (fall, change) in _changes(quantity, value.shape).items():
        after, elements = _median_error(change(value), change(valid), truth, chosen)
        small = elements and after * fall <= before and after <= 0.5 * float(np.median(np.abs(truth.value[chosen])))
        if small and (not best or after < best["after"]):
            best = {
                "quantity": quantity.name, "slip": told, "elements": elements, "before": before, "after": after,
            }  # fmt: skip
    return best


def _median_error(
    value: Float, valid: npt.NDArray[np.bool_], truth: Truth, chosen: npt.NDArray[np.bool_]
) -> tuple[float, int]:
    """The median absolute error of the answered elements, and their number. A median: one wild answer must not hide a slip."""
    used = chosen & (valid > 0) & np.isfinite(value)
    return (float(np.median(np.abs(value[used] - truth.value[used]))), int(used.sum())) if used.any() else (math.inf, 0)


def _changes(quantity: Quantity, shape: tuple[int, ...]) -> dict[str, tuple[float, Change]]:
    """What may be wrong -> (by how much the error must fall, the change that mends it, of values and of flags alike)."""
    changes: dict[str, tuple[float, Change]] = {}
    for unit, factor in _UNITS.get(quantity.unit, {}).items():
        told = f"given in {unit} in place of {quantity.unit}"
        changes[told] = UNIT_FALL, partial(_divided, by=factor)
    pairs = [(quantity.dims.index(a), quantity.dims.index(b)) for a, b in zip(_ROWS, _COLS, strict=True)
             if a in quantity.dims and b in quantity.dims]  # fmt: skip
    for first, second in pairs:
        # The values in the order of a language whose first index runs fastest, in the right shape: reshape undoes both.
        swapped = list(shape)
        swapped[first], swapped[second] = shape[second], shape[first]
        exchanged = partial(_exchanged, shape=tuple(swapped), axes=(first, second))
        changes["given with rows and columns exchanged"] = ORDER_FALL, exchanged
    if "axis" in quantity.components:
        changes["given with the components along rows and columns exchanged"] = ORDER_FALL, _flipped
    return changes


def _divided(array: Array, by: float) -> Array:
    return array if array.dtype == bool else array / by


def _exchanged(array: Array, shape: tuple[int, ...], axes: tuple[int, int]) -> Array:
    return np.swapaxes(array.reshape(shape), *axes)


def _flipped(array: Array) -> Array:
    return array[..., ::-1]


def slip_warnings(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """A sentence for every estimator and quantity of whose answers enough elements are mended by one change.

    Main arguments:
        rows: of `slips_of`, with `estimator` and `params`, of all captures.
    """
    held: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        label = label_of(str(row["estimator"]), str(row["params"]))
        held.setdefault((label, str(row["quantity"]), str(row["slip"])), []).append(row)
    return [
        f"{label}: the {quantity} seems to be {slip}; the error of {sum(int(row['elements']) for row in found):,} elements falls "
        f"from {_mean(found, 'before'):.3g} to {_mean(found, 'after'):.3g} in the median when that is mended. Scores are those of "
        "the answer as it stands"
        for (label, quantity, slip), found in held.items()
        if sum(int(row["elements"]) for row in found) >= LEAST_ELEMENTS
    ]


def _mean(rows: list[Mapping[str, Any]], name: str) -> float:
    return float(np.mean([float(row[name]) for row in rows]))
