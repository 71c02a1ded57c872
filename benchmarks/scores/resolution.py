"""How much of the truth's detail an estimate keeps: its response at a period of four elements, beside its error.

A mean over neighbours lowers the noise and gives up resolution; on scenes with little detail its error does not tell. With the
second differences D x = x[i−2] − 2 x[i] + x[i+2] along every direction of an image, a line or a scan, over elements with one true
value that are valid at all three places,

    response R = Σ Dx̂ Dx / Σ (Dx)²,    standard error = √Σ w² s²,   w = Dᵀ D x / Σ (Dx)²,   s² = (Dx̂ − R Dx)²/6,

since the response is linear in the noise of elements, which is taken as independent, and its variance s² is read from what is
left beside the response. D's transfer is
−4 sin²(2π f), which is largest at a period of four elements (half the Nyquist frequency) and zero for planes: those have no detail.
An estimator that reads each element by itself has 1; a mean over three neighbours of a line has .5 at a step, one over five .1,
one over all 0. A median keeps steps. A spacing of two lets a step pass whose own element is mixed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...captures.quantities import Quantity, Stage
from ...estimators.labels import label_of
from ..folders.files import write_text
from .score import KEY
from .tables import read_numbers, to_csv
from .truth import Truth, aligned, single_valued

__all__ = [
    "RESOLUTION_COLUMNS", "Response", "gives_up", "pooled_response", "read_resolution", "resolution_rows", "resolution_warnings",
    "response", "write_resolution",
]  # fmt: skip

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Dimensions along which elements are neighbours in space.
_DIRECTIONS = ("row", "col", "shot")
_SPACING = 2
#: A response that is known less well than this tells nothing.
_LARGEST_ERROR = 0.2
#: Below this response by more than three standard errors, resolution was given up.
_LEAST = 0.8
_TEXTS = (
    "scene",
    "stress",
    "level",
    "stress2",
    "level2",
    "seed",
    "condition",
    "stage",
    "estimator",
    "params",
    "quantity",
)
RESOLUTION_COLUMNS = (*KEY, "modality", "quantity", "n", "response", "response_error")

#: (response, standard error).
Response = tuple[float, float]


def response(estimate: Float, valid: Bool, truth: Float, axes: Sequence[int]) -> tuple[float, float, int]:
    """(response, standard error, number of second differences) along the given axes; NaN without detail.

    Main arguments:
        estimate, truth: values of one shape; elements that are not `valid` are left out. axes: directions, by number.
    """
    found = [_Differences(np.where(valid, estimate, 0.0), np.where(valid, truth, 0.0), valid, axis) for axis in axes]
    found = [one for one in found if one.whole.size]
    square = sum(float((one.truth**2).sum()) for one in found)
    count = sum(int(one.whole.sum()) for one in found)
    if not square > 0.0:
        return math.nan, math.nan, count
    share = sum(float((one.estimate * one.truth).sum()) for one in found) / square
    adjoint, noise, known = np.zeros(truth.shape), np.zeros(truth.shape), np.zeros(truth.shape)
    for one in found:
        one.back(one.truth, adjoint)
        # D of white noise has six times its variance.
        one.middle((one.estimate - share * one.truth) ** 2 / 6.0, noise)
        one.middle(one.whole, known)
    mean = float(noise.sum() / known.sum())
    variance = np.divide(noise, known, out=np.full(truth.shape, mean), where=known > 0)
    return share, float(np.sqrt((adjoint**2 * variance).sum())) / square, count


class _Differences:
    """Second differences along one axis, zero where one of the three elements is not valid; `whole`: where all are."""

    def __init__(self, estimate: Float, truth: Float, valid: Bool, axis: int) -> None:
        self.axis = axis
        self.parts = (slice(None, -2 * _SPACING), slice(_SPACING, -_SPACING), slice(2 * _SPACING, None))
        self.whole = np.logical_and.reduce([self._part(valid, number) for number in range(3)])
        self.estimate, self.truth = (self._of(array) for array in (estimate, truth))

    def _part(self, array: Any, number: int) -> Any:
        return np.moveaxis(array, self.axis, -1)[..., self.parts[number]]

    def _of(self, array: Float) -> Float:
        early, middle, late = (self._part(array, number) for number in range(3))
        return np.where(self.whole, early - 2.0 * middle + late, 0.0)

    def back(self, values: Float, into: Float) -> None:
        """Add the adjoint of D, of values, to an array."""
        for number, factor in enumerate((1.0, -2.0, 1.0)):
            self._part(into, number)[...] += factor * values

    def middle(self, values: Any, into: Float) -> None:
        """Add values to the elements in the middle of their differences."""
        self._part(into, 1)[...] += values


def resolution_rows(
    key: Mapping[str, Any], stage: Stage, arrays: dict[str, npt.NDArray[Any]], truths: Mapping[str, Truth]
) -> list[dict[str, Any]]:
    """A row for each quantity of an answer whose response is known to .2; none for quantities without directions in space.

    Main arguments:
        key: values of the key columns but `stage`. stage: of the estimator. arrays: its answer. truths: by quantity.
    """
    rows = []
    for quantity in stage.gives:
        axes = _axes(quantity)
        if not axes or quantity.name not in truths:
            continue
        truth = truths[quantity.name]
        value, _, valid = aligned(arrays, stage, quantity, truth.value.shape)
        with np.errstate(invalid="ignore", over="ignore"):
            found, error, n = response(value, valid & single_valued(truth), truth.value, axes)
        if error <= _LARGEST_ERROR:
            rows.append({
                **key, "stage": stage.name, "modality": stage.modality, "quantity": quantity.name, "n": n, "response": found,
                "response_error": error,
            })  # fmt: skip
    return rows


def _axes(quantity: Quantity) -> list[int]:
    return [number for number, dim in enumerate(quantity.dims) if dim in _DIRECTIONS]


def pooled_response(rows: Iterable[Mapping[str, Any]]) -> Response:
    """The mean of some responses by weight 1/error², and its standard error; NaN without rows."""
    # An answer without any error has the response 1, and no more weight than .001 gives.
    known = [(float(row["response"]), max(float(row["response_error"]), 1e-3)) for row in rows]
    weight = sum(error**-2 for _, error in known)
    if not weight:
        return math.nan, math.nan
    return sum(value * error**-2 for value, error in known) / weight, weight**-0.5


def gives_up(found: Response) -> bool:
    """Whether a response is below .8 by more than three standard errors."""
    return found[0] + 3.0 * found[1] < _LEAST


def write_resolution(folder: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write resolution.csv of a run, its rows sorted by key, completely or not at all."""
    ordered = sorted(rows, key=lambda row: tuple(str(row[name]) for name in _TEXTS))
    write_text(folder / "resolution.csv", to_csv([dict(row) for row in ordered], RESOLUTION_COLUMNS))


def read_resolution(folder: Path) -> list[dict[str, Any]]:
    """The rows of resolution.csv; none without the file, as in a run of before.

    Raises:
        InputError: the file is not such a table.
    """
    return read_numbers(
        folder / "resolution.csv", ("n", "response", "response_error"), "The table of resolution", texts=_TEXTS
    )


def resolution_warnings(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """A sentence for every estimator that gives up resolution in the unstressed captures of a scene, seeds pooled."""
    cells: dict[tuple[str, str, str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        if row["stress"] == "none":
            label = label_of(str(row["estimator"]), str(row["params"]))
            cells.setdefault((label, str(row["quantity"]), str(row["scene"]), str(row["condition"])), []).append(row)
    return [
        f"{label} keeps {found[0]:.2f} ± {found[1]:.2f} of the detail of the {quantity} in {scene}, {condition}: it gives up "
        "resolution, and its error is not that of single elements"
        for (label, quantity, scene, condition), held in cells.items()
        if gives_up(found := pooled_response(held))
    ]
