"""Propagate covariances, and so bounds, through the stages of a chain.

A stage y = f(x) transforms a covariance C of x into J C Jᵀ + Q, with J = ∂f/∂x and Q the covariance that the stage adds. If C
is a Cramér-Rao bound of x, then J C Jᵀ is that of y: a chain of stages, each at its bound, is compared with the propagated
bound, and a single stage with Q. This is first order in the error; `nonlinearity` shows where that is not sufficient.

Source: C. R. Rao, Linear Statistical Inference and its Applications, 1973, sec. 5a and 6a (delta method).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Propagated", "Stage", "carry", "chain", "nonlinearity", "numerical_jacobian"]

Float = npt.NDArray[np.float64]
Function = Callable[[Float], Float]


@dataclass(frozen=True)
class Stage:
    """One step of a chain, for a batch of elements: x (…, n) -> y (…, m).

    Main arguments:
        function: f. jacobian: x -> J (…, m, n); None: by differences, with the standard error of each input as step.
    Other arguments:
        own: x -> Q (…, m, m), the covariance that the stage adds; None: zero.
    """

    name: str
    function: Function
    jacobian: Function | None = None
    own: Function | None = None


@dataclass(frozen=True)
class Propagated:
    """Result of a stage: y (…, m), its covariance (…, m, m), the fraction of its variance that the stage added (…, m), and
    its `nonlinearity` (…, m)."""

    name: str
    value: Float
    covariance: Float
    own_share: Float
    nonlinearity: Float

    @property
    def sigma(self) -> Float:
        """Standard errors of y (…, m)."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1)))


def carry(covariance: npt.ArrayLike, jacobian: npt.ArrayLike) -> Float:
    """J C Jᵀ (…, m, m) from C (…, n, n) and J (…, m, n), symmetric to the last bit.

    An infinite variance (an unknown input) makes the variance of every output that depends on it infinite; outputs that do
    not depend on it remain finite.
    """
    c, j = np.asarray(covariance, np.float64), np.asarray(jacobian, np.float64)
    unknown = np.asarray(np.isinf(np.diagonal(c, axis1=-2, axis2=-1)))
    if not unknown.any():
        out = j @ c @ np.swapaxes(j, -1, -2)
        return np.asarray(0.5 * (out + np.swapaxes(out, -1, -2)))
    either = unknown[..., :, None] | unknown[..., None, :]
    out = carry(np.where(either, 0.0, c), j)
    hit = np.asarray((np.abs(j) * unknown[..., None, :]).sum(axis=-1) > 0.0)
    diagonal = np.eye(j.shape[-2], dtype=bool)
    out = np.where(hit[..., :, None] & diagonal, np.inf, out)
    return np.where((hit[..., :, None] | hit[..., None, :]) & ~diagonal, np.nan, out)


def numerical_jacobian(function: Function, x: npt.ArrayLike, step: npt.ArrayLike) -> Float:
    """J (…, m, n) of f at x (…, n) by central differences with steps `step` (…, n) and `step`/2, extrapolated.

    Error O(step⁴). Elements are independent: one call of f evaluates a whole batch.
    """
    at = np.asarray(x, np.float64)
    h = np.broadcast_to(np.asarray(step, np.float64), at.shape)
    columns = []
    for i in range(at.shape[-1]):
        unit = np.zeros(at.shape[-1])
        unit[i] = 1.0
        slopes = []
        for scale in (1.0, 0.5):
            move = scale * h * unit
            slopes.append((function(at + move) - function(at - move)) / (2.0 * scale * h[..., i : i + 1]))
        columns.append((4.0 * slopes[1] - slopes[0]) / 3.0)
    return np.asarray(np.stack(columns, axis=-1))


def nonlinearity(function: Function, x: npt.ArrayLike, covariance: npt.ArrayLike) -> Float:
    """Second-order bias of f over its first-order standard error, (…, m); first order is sufficient below about .1.

    ½ Σ over principal axes a of C of [f(x + a) + f(x − a) − 2f(x)] over √diag(J C Jᵀ), the latter from the same points.
    If y is known exactly (no spread), the result is 0 without bias, otherwise infinite. NaN where C is not finite.
    """
    at, c = np.asarray(x, np.float64), np.asarray(covariance, np.float64)
    finite = np.asarray(np.isfinite(c).all(axis=(-2, -1)))
    values, vectors = np.linalg.eigh(np.where(finite[..., None, None], c, 0.0))
    middle = function(at)
    bias, square = np.zeros(middle.shape), np.zeros(middle.shape)
    for i in range(at.shape[-1]):
        axis = np.sqrt(np.maximum(values[..., i : i + 1], 0.0)) * vectors[..., :, i]
        plus, minus = function(at + axis), function(at - axis)
        bias += 0.5 * (plus + minus - 2.0 * middle)
        square += (0.5 * (plus - minus)) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(bias == 0.0, 0.0, np.abs(bias) / np.sqrt(square))
    return np.asarray(np.where(finite[..., None], ratio, np.nan))


def chain(stages: Sequence[Stage], x: npt.ArrayLike, covariance: npt.ArrayLike) -> list[Propagated]:
    """Propagate a covariance through stages in order; one result per stage.

    Main arguments:
        x (…, n) and its covariance (…, n, n), e.g. the Cramér-Rao bound of the input of the first stage.
    Raises ValueError if the Jacobian of a stage does not fit its input and output.
    """
    value, spread = np.asarray(x, np.float64), np.asarray(covariance, np.float64)
    results = []
    for stage in stages:
        result = stage.function(value)
        if stage.jacobian is not None:
            jacobian = np.asarray(stage.jacobian(value), np.float64)
        else:
            error = np.sqrt(np.diagonal(spread, axis1=-2, axis2=-1))
            # The step is the error of the input, but not finer than rounding allows.
            least = 1e-6 * np.maximum(np.abs(value), 1e-12)
            jacobian = numerical_jacobian(
                stage.function, value, np.maximum(np.where(np.isfinite(error), error, 0.0), least)
            )
        if jacobian.shape[-2:] != (result.shape[-1], value.shape[-1]):
            raise ValueError(f"stage {stage.name!r}: Jacobian {jacobian.shape} for {value.shape} -> {result.shape}")
        bent = nonlinearity(stage.function, value, spread)
        carried = carry(spread, jacobian)
        own = np.zeros_like(carried) if stage.own is None else np.asarray(stage.own(value), np.float64)
        total = carried + own
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.diagonal(own, axis1=-2, axis2=-1) / np.diagonal(total, axis1=-2, axis2=-1)
        results.append(Propagated(stage.name, result, total, np.nan_to_num(share), bent))
        value, spread = result, total
    return results
