"""The reference of estimates: the truth of a quantity, its bound, the error of an estimate, and the limit of failure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...captures.quantities import Quantity, Stage

__all__ = ["Bound", "Truth", "aligned", "errors_of", "failure_limit", "refusal_error", "single_valued"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Truth:
    """The truth of one quantity.

    Main arguments:
        value: true values in the quantity's unit and dimensions, NaN where unknown.
        mixed: flags of the same shape; elements with several true values, e.g. a pixel that sees two surfaces.
        alternatives: arrays of these values, of the same shape; the nearest one counts.
    """

    value: Float
    mixed: Bool
    alternatives: tuple[Float, ...] = ()

    @classmethod
    def plain(cls, value: Any) -> Truth:
        """The truth of a quantity with one true value per element."""
        array = np.asarray(value, np.float64)
        return cls(array, np.zeros(array.shape, bool))


@dataclass(frozen=True)
class Bound:
    """Bound of the standard error per element, and the scales of failure, all in the unit of the quantity.

    Main arguments:
        sigma: bound in the shape of the truth; infinite without information, NaN without truth.
        kind: "exact", "quasi", "ziv-zakai", "bayes" or "none".
        scale: width of the echo, line or spot, as a standard deviation; an estimate with a larger error follows another signal.
        window: span of the values that can be estimated from the capture.
    Other arguments:
        drawn: standard deviation with which the suite draws the values of a scene, per seed; NaN if it does not.
    """

    sigma: Float
    kind: str
    scale: float
    window: float
    drawn: float = math.nan

    @property
    def prior(self) -> float:
        """Standard error of an estimate drawn uniformly from the window: window/√12."""
        return self.window / math.sqrt(12.0)


def refusal_error(truth: Truth, chosen: Bool, bound: Bound) -> float:
    """The error with which a refused element of a row counts: that of the best constant guess by one who knows the suite.

        P² = min(window²/12, var(truth) + drawn²)

    Main arguments:
        truth, bound: of the quantity. chosen: flags of the row's elements, in the shape of the truth.

    One number for all elements errs by var(truth) + (mean − guess)², and the mean is drawn per seed, so that no guess has a
    smaller mean square than var(truth) + drawn² over seeds: who guesses gains nothing over one who refuses. Where the suite draws
    nothing, P = window/√12, that of a guess in a window of which nothing is known.
    """
    if not math.isfinite(bound.drawn) or not chosen.any():
        return bound.prior
    spread = float(truth.value[chosen].std())
    return min(bound.prior, math.hypot(spread, bound.drawn))


def single_valued(truth: Truth) -> Bool:
    """Elements with exactly one true value."""
    return np.asarray(np.isfinite(truth.value) & ~truth.mixed)


def errors_of(estimate: Float, truth: Truth) -> Float:
    """estimate − truth; for mixed elements the signed distance to the nearest alternative. NaN where either is missing."""
    error = estimate - truth.value
    if not truth.alternatives or not truth.mixed.any():
        return error
    nearest = estimate - truth.alternatives[0]
    for other in truth.alternatives[1:]:
        distance = estimate - other
        nearest = np.where(np.abs(nearest) <= np.abs(distance), nearest, distance)
    return np.where(truth.mixed, nearest, error)


def failure_limit(sigma: Float, bound: Bound, failure_at: float | None = None) -> Float:
    """|error| above which an element has failed: five bounds, but at least X and at most the larger of 2X and the scale;
    X without a bound.

    Main arguments:
        sigma: bounds of the elements, any shape. bound: the bound of the capture, for its scale.
    Other arguments:
        failure_at: X; half of the scale if None.
    """
    at = failure_at if failure_at is not None else 0.5 * bound.scale
    # fmax: the limit is X for elements without a bound.
    return np.asarray(np.minimum(np.fmax(5.0 * sigma, at), max(2.0 * at, bound.scale)), np.float64)


def aligned(
    arrays: dict[str, npt.NDArray[Any]], stage: Stage, quantity: Quantity, shape: tuple[int, ...]
) -> tuple[Float, Float, Bool]:
    """Value, sigma and valid of a quantity, in the shape of the truth.

    The length of a dimension that the estimator chose may differ from the truth's: additional elements are left out, missing
    ones are invalid. `valid` is repeated over the components of an element.
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
