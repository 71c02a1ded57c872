"""What estimates are compared with: the truth of a quantity, its bound, the error of an answer, and when it has failed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...captures.quantities import Quantity, Stage

__all__ = ["Bound", "Truth", "aligned", "errors_of", "failure_limit", "single_valued"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Truth:
    """The truth of one quantity.

    Main arguments:
        value: in the quantity's unit and dimensions, NaN where there is none.
        mixed: of the same shape; elements for which several values are right, as for a pixel that sees two surfaces.
        alternatives: arrays of those values, of the same shape; the nearest one counts.
    """

    value: Float
    mixed: Bool
    alternatives: tuple[Float, ...] = ()

    @classmethod
    def plain(cls, value: Any) -> Truth:
        """The truth of a quantity whose elements each have one right value."""
        array = np.asarray(value, np.float64)
        return cls(array, np.zeros(array.shape, bool))


@dataclass(frozen=True)
class Bound:
    """Bound of the standard error per element, and what sets the scale of failure; all in the quantity's unit.

    Main arguments:
        sigma: of the truth's shape; infinite where the capture holds no information, NaN where there is no truth.
        kind: "exact" or "quasi"; "ziv-zakai" or "bayes"; "none".
        scale: width of the echo, line or spot, as a standard deviation: an answer off by more has followed something else.
        window: span of values that the capture can answer.
    """

    sigma: Float
    kind: str
    scale: float
    window: float

    @property
    def prior(self) -> float:
        """Standard error of an answer that is drawn evenly over the window: window/√12."""
        return self.window / math.sqrt(12.0)


def single_valued(truth: Truth) -> Bool:
    """Elements that have one true value."""
    return np.asarray(np.isfinite(truth.value) & ~truth.mixed)


def errors_of(estimate: Float, truth: Truth) -> Float:
    """estimate − truth; for mixed elements the signed distance to the nearest of the alternatives. NaN where either is
    missing."""
    error = estimate - truth.value
    if not truth.alternatives or not truth.mixed.any():
        return error
    nearest = estimate - truth.alternatives[0]
    for other in truth.alternatives[1:]:
        distance = estimate - other
        nearest = np.where(np.abs(nearest) <= np.abs(distance), nearest, distance)
    return np.where(truth.mixed, nearest, error)


def failure_limit(sigma: Float, bound: Bound, failure_at: float | None = None) -> Float:
    """|error| beyond which an element has failed: five bounds, but at least X and at most the larger of 2X and the scale; X
    where there is no bound.

    Main arguments:
        sigma: bounds of the elements wanted, any shape. bound: of the capture, for its scale.
    Other arguments:
        failure_at: X; half of the scale if None.
    """
    at = failure_at if failure_at is not None else 0.5 * bound.scale
    # fmax: elements without a bound are judged by X.
    return np.asarray(np.minimum(np.fmax(5.0 * sigma, at), max(2.0 * at, bound.scale)), np.float64)


def aligned(
    arrays: dict[str, npt.NDArray[Any]], stage: Stage, quantity: Quantity, shape: tuple[int, ...]
) -> tuple[Float, Float, Bool]:
    """Value, sigma and valid of a quantity in the truth's shape.

    A dimension that the estimator chose may be longer or shorter than the truth's: what lies beyond the truth is left out,
    what is lacking is invalid. `valid` is repeated over the components of an element.
    """
    names = stage.variables(quantity)
    value, sigma = (np.asarray(arrays[name], np.float64) for name in (names.value, names.sigma))
    valid = np.asarray(arrays[names.valid], bool)
    valid = np.broadcast_to(valid.reshape(valid.shape + (1,) * len(quantity.components)), value.shape)
    if value.shape == shape:
        return value, sigma, valid
    common = tuple(slice(0, min(a, b)) for a, b in zip(value.shape, shape, strict=True))
    made = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, bool)
    for whole, part in zip(made, (value, sigma, valid), strict=True):
        whole[common] = part[common]
    return made
