"""Damped scoring of many shots at once: the one loop behind matched filter, Gaussian fit and maximum likelihood.

With the mean μ_k(θ) of sample k, weights w_k and residuals e_k (so that the score is Σ w_k e_k ∂μ_k), a step solves
(H + κ diag H) δ = Σ w e ∂μ, H = Σ w ∂μ ∂μᵀ; κ falls while the objective falls and rises otherwise (Levenberg and
Marquardt; Fisher scoring where w is the information). The covariance is H⁻¹ (Σ w² v ∂μ ∂μᵀ) H⁻¹ with v the samples'
variance, which is H⁻¹ where w = 1/v.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Fit", "Weigh", "scoring"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: (mean (shot, sample), rows) -> objective (shot), weights w, residuals e, variances v of the samples (shot, sample).
Weigh = Callable[[Float, npt.NDArray[np.intp]], tuple[Float, Float, Float, Float]]
#: (parameters (shot, parameter), rows) -> mean (shot, sample), its derivatives (parameter, shot, sample).
Model = Callable[[Float, npt.NDArray[np.intp]], tuple[Float, Float]]

_STEPS = 60
_SETTLED = 1e-3  # of a standard error


@dataclass(frozen=True)
class Fit:
    """Parameters and variances (shot, parameter); settled (shot): the last step was far below a standard error."""

    value: Float
    variance: Float
    settled: Bool


def _solve(matrix: Float, right: Float) -> Float:
    """Solve symmetric systems (…, p, p), scaled to a unit diagonal; singular ones give NaN."""
    d = np.sqrt(np.maximum(np.diagonal(matrix, axis1=-2, axis2=-1), 1e-300))
    scaled = matrix / (d[..., :, None] * d[..., None, :])
    good = np.isfinite(scaled).all(axis=(-2, -1)) & (np.diagonal(matrix, axis1=-2, axis2=-1) > 0).all(axis=-1)
    scaled = np.where(good[..., None, None], scaled, np.eye(matrix.shape[-1]))
    good &= np.abs(np.linalg.det(scaled)) > 1e-12
    scaled = np.where(good[..., None, None], scaled, np.eye(matrix.shape[-1]))
    x = np.linalg.solve(scaled, right / d[..., :, None]) / d[..., :, None]
    return np.where(good[..., None, None], x, np.nan)


def scoring(
    model: Model, weigh: Weigh, start: Float, low: Float, high: Float, reach: Float, judged: tuple[int, ...] = (0,)
) -> Fit:
    """Fit every shot.

    Main arguments:
        model, weigh: as above; both get the indices of the shots that are still being fitted.
        start (shot, parameter): first values. low, high (shot, parameter): limits. reach (parameter): longest step.
    Other arguments:
        judged: the parameters whose steps decide whether a fit has settled.
    """
    theta = np.clip(start, low, high)
    shots, parameters = theta.shape
    variance = np.full_like(theta, np.nan)
    settled = np.zeros(shots, dtype=bool)
    damping = np.full(shots, 1e-3)
    rows: npt.NDArray[np.intp] = np.flatnonzero(np.isfinite(theta).all(axis=1))
    mean, slope = model(theta[rows], rows)
    objective, w, e, v = weigh(mean, rows)
    eye, some = np.eye(parameters), list(judged)
    for _ in range(_STEPS):
        if rows.size == 0:
            break
        h = np.einsum("psk,qsk->spq", slope * w, slope)
        gradient = np.einsum("psk,sk->sp", slope, w * e)
        damped = h + damping[rows, None, None] * h * eye
        step = _solve(damped, gradient[..., None])[..., 0]
        plain = _solve(h, gradient[..., None])[..., 0]
        longest = np.nanmax(np.abs(step) / reach, axis=1, initial=1.0)
        trial = np.clip(theta[rows] + step / longest[:, None], low[rows], high[rows])
        trial = np.where(np.isfinite(trial), trial, theta[rows])
        mean_t, slope_t = model(trial, rows)
        objective_t, w_t, e_t, v_t = weigh(mean_t, rows)
        better = objective_t <= objective
        moved = np.abs(trial - theta[rows])
        spread = _covariance(h, slope, w, v)
        small = (np.abs(plain[:, some]) <= _SETTLED * np.sqrt(spread[:, some])).all(axis=1)
        still = better & (moved[:, some] <= _SETTLED * np.sqrt(spread[:, some])).all(axis=1)
        theta[rows[better]] = trial[better]
        damping[rows] = np.where(better, np.maximum(damping[rows] * 0.2, 1e-9), np.minimum(damping[rows] * 8, 1e9))
        for old, new in ((mean, mean_t), (w, w_t), (e, e_t), (v, v_t)):
            old[better] = new[better]
        slope[:, better] = slope_t[:, better]
        objective = np.where(better, objective_t, objective)
        done = small | still
        variance[rows] = spread
        settled[rows[done]] = True
        keep = ~done & np.isfinite(step).all(axis=1)
        rows = rows[keep]
        mean, slope, w, e, v, objective = mean[keep], slope[:, keep], w[keep], e[keep], v[keep], objective[keep]
    return Fit(theta, variance, settled)


def _covariance(h: Float, slope: Float, w: Float, v: Float) -> Float:
    """Diagonal of H⁻¹ G H⁻¹, (shot, parameter)."""
    g = np.einsum("psk,qsk->spq", slope * (w * w * v), slope)
    inverse = _solve(h, np.broadcast_to(np.eye(h.shape[-1]), h.shape))
    return np.asarray(np.maximum(np.einsum("spq,sqr,srp->sp", inverse, g, inverse), 0.0), np.float64)
