"""How much of the truth's detail an estimate keeps: its response at a period of four elements, beside its error.

A mean over neighbours lowers the noise and gives up resolution; on scenes with little detail its error does not tell. With the
second differences D x = x[i−2] − 2 x[i] + x[i+2] along every direction of an image, a line or a scan, over elements with one true
value that are valid at all three places,

    response = Σ Dx̂ Dx / Σ (Dx)²,    standard error = √Σ (w e)²,   w = Dᵀ D x / Σ (Dx)²,

since the response is 1 + Σ w e, e = estimate − truth, linear in the errors, which are taken as independent. D's transfer is
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


def response(
    estimate: Float, valid: npt.NDArray[np.bool_], truth: Float, axes: Sequence[int]
) -> tuple[float, float, int]:
    """(response, standard error, number of second differences) along the given axes; NaN without detail.

    Main arguments:
        estimate, truth: values of one shape; elements that are not `valid` are left out. axes: directions, by number.
    """
    error = np.where(valid, estimate - truth, 0.0)
    held = np.where(valid, truth, 0.0)
    adjoint = np.zeros(held.shape)
    square, count = 0.0, 0
    for axis in axes:
        x, used, back = (np.moveaxis(array, axis, -1) for array in (held, valid, adjoint))
        if x.shape[-1] <= 2 * _SPACING:
            continue
        parts = (slice(None, -2 * _SPACING), slice(_SPACING, -_SPACING), slice(2 * _SPACING, None))
        early, middle, late = (x[..., part] for part in parts)
        whole = np.logical_and.reduce([used[..., part] for part in parts])
        d = np.where(whole, early - 2.0 * middle + late, 0.0)
        for part, factor in zip(parts, (1.0, -2.0, 1.0), strict=True):
            back[..., part] += factor * d
        square += float((d**2).sum())
        count += int(whole.sum())
    if not square > 0.0:
        return math.nan, math.nan, count
    w = adjoint / square
    return 1.0 + float((w * error).sum()), float(np.sqrt(((w * error) ** 2).sum())), count


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
