"""Is there turbulence, how strong, and where: r₀ from slopes by maximum likelihood, layers from successive gates.

Slopes of F frames are s ~ N(0, q C + N), q = r₀^{−5/3}, C their covariance for r₀ = 1 m, N that of the noise. With N^{−1/2} C
N^{−1/2} = V diag(e) Vᵀ and T_i the sum over frames of the squares of Vᵀ N^{−1/2} s,

    ln L(q) = −½ Σ_i [F ln(1 + q e_i) + T_i/(1 + q e_i)],

of which the maximum gives r₀, the drop by ½χ² its interval, and ln L(q̂) − ln L(0) a statistic of detection.

A gate selects the range r of the reflector, not a layer: the phase is gathered from 0 to r. The strength of layers follows
from those at successive gates by q_gate = W x, x ≥ 0, with the range weights W of `range_weights`.

Sources: S. S. Wilks, Ann. Math. Stat. 9:60, 1938; C. L. Lawson and R. J. Hanson, Solving Least Squares Problems, 1974 (x ≥ 0).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq, minimize_scalar, nnls
from scipy.special import chdtri, expit, logsumexp

__all__ = [
    "Strength",
    "increment_strength",
    "layer_shares",
    "layer_strengths",
    "range_weights",
    "strength_and_probability",
    "strength_from_slopes",
    "without_common_tilt",
]

Float = NDArray[np.float64]

#: Draws from the likelihoods of the strengths at the gates, and their seed: shares have an error of 2 %, the same in every call.
_DRAWS, _DRAW_SEED = 400, 20171
#: Standard errors of a 95 % interval's half.
_HALF = 1.96
#: Nodes of the mean over ln r₀: likelihoods of many slopes are a few per cent of r₀ wide.
_NODES = 2001


@dataclass(frozen=True)
class Strength:
    """Turbulence found in slopes.

    Main arguments:
        q: r₀^{−5/3} [m^{−5/3}], 0 where none is seen; low, high its interval. gain: ln L(q̂) − ln L(0), 0 where q̂ = 0.
        sigma: standard error of q from the curvature of ln L.
    """

    q: float
    low: float
    high: float
    gain: float
    sigma: float

    @property
    def r0_m(self) -> float:
        """r₀ [m]; infinite without turbulence."""
        return _length(self.q)

    @property
    def r0_interval_m(self) -> tuple[float, float]:
        """Interval of r₀ [m]; its upper end is infinite where q = 0 is not excluded."""
        return _length(self.high), _length(self.low)


def strength_from_slopes(slopes: ArrayLike, unit: ArrayLike, noise: ArrayLike, *, level: float = 0.95) -> Strength:
    """Maximum-likelihood strength and its likelihood-ratio interval.

    Main arguments:
        slopes (frames, values): independent frames, zero mean. unit (values, values): C of these values for r₀ = 1 m, in the
        square of
            their unit. noise: N (values, values), or variances (values), or one.

    Other arguments:
        level: of the interval.

    Raises ValueError for shapes that do not fit, values that are not finite, or N that is not positive definite.
    """
    value, energy, frames = _decomposed(slopes, unit, noise)
    return _maximum(value, energy, frames, level)


def strength_and_probability(
    slopes: ArrayLike, unit: ArrayLike, noise: ArrayLike, r0_limits_m: tuple[float, float], *, level: float = 0.95
) -> tuple[Strength, float]:
    """(`strength_from_slopes`, P(turbulence | slopes)).

    P is that of turbulence which is there in half of the cases, ln r₀ then even between two limits [m]: P = Λ/(1 + Λ), Λ =
    ⟨L(q)⟩/L(0), the mean over ln r₀. Raises ValueError as `strength_from_slopes`, and for limits that do not ascend from above 0.
    """
    low, high = r0_limits_m
    if not 0.0 < low < high < np.inf:
        raise ValueError(f"r0_limits_m must be positive and ascend, not {r0_limits_m!r}.")
    value, energy, frames = _decomposed(slopes, unit, noise)
    q = np.exp(-5.0 / 3.0 * np.linspace(np.log(low), np.log(high), _NODES))[:, None]
    log_ratio = -0.5 * (frames * np.log1p(q * value) + energy / (1.0 + q * value) - energy).sum(axis=1)
    weight = np.full(_NODES, 1.0 / (_NODES - 1))
    weight[[0, -1]] *= 0.5
    return _maximum(value, energy, frames, level), float(expit(logsumexp(log_ratio, b=weight)))


def _decomposed(slopes: ArrayLike, unit: ArrayLike, noise: ArrayLike) -> tuple[Float, Float, int]:
    """(e, T, frames) of the module's head."""
    s, c = np.atleast_2d(np.asarray(slopes, np.float64)), np.asarray(unit, np.float64)
    if c.shape != (s.shape[1],) * 2 or not np.isfinite(s).all():
        raise ValueError(f"slopes (frames, values) must be finite and fit unit (values, values): {s.shape}, {c.shape}.")
    n = np.asarray(noise, np.float64)
    n = n if n.ndim == 2 else np.diag(np.broadcast_to(n, (s.shape[1],)))
    try:
        lower = np.linalg.cholesky(n)
    except np.linalg.LinAlgError as error:
        raise ValueError("noise must be positive definite.") from error
    half = np.linalg.solve(lower, c)
    value, vector = np.linalg.eigh(np.linalg.solve(lower, half.T))
    value = np.maximum(value, 0.0)
    energy = ((np.linalg.solve(lower, s.T).T @ vector) ** 2).sum(axis=0)
    return value, energy, len(s)


def increment_strength(
    near: ArrayLike, far: ArrayLike, unit: ArrayLike, noise_near: ArrayLike, noise_far: ArrayLike
) -> tuple[float, float]:
    """(Δq, its standard error) [m^{−5/3}]: the strength that slopes gain from one gate to the next, by their covariances.

    Δq = ⟨tr C (s_f s_fᵀ − N_f − s_n s_nᵀ + N_n)⟩/tr C², least squares of the increment of the covariance on C. The error is
    the scatter of the frames' own differences, so that turbulence which both gates see may be the same in both (which lowers it).

    Main arguments:
        near, far (frames, values): slopes of both gates, frame by frame. unit (values, values): C for r₀ = 1 m. noise_near,
        noise_far:
            variances of the noise, one or (values).

    Raises ValueError for shapes that do not fit or fewer than two frames.
    """
    a, b = np.atleast_2d(np.asarray(near, np.float64)), np.atleast_2d(np.asarray(far, np.float64))
    c = np.asarray(unit, np.float64)
    if a.shape != b.shape or c.shape != (a.shape[1],) * 2 or len(a) < 2:
        raise ValueError(f"near and far (2 or more frames, values) must fit unit: {a.shape}, {b.shape}, {c.shape}.")
    offset = float((c.diagonal() * (np.asarray(noise_far, np.float64) - np.asarray(noise_near, np.float64))).sum())
    each = (
        np.einsum("fi,ij,fj->f", b, c, b, optimize=True) - np.einsum("fi,ij,fj->f", a, c, a, optimize=True) - offset
    ) / (c**2).sum()
    return float(each.mean()), float(each.std(ddof=1) / np.sqrt(len(each)))


def without_common_tilt(lenslets: int) -> Float:
    """P (2·lenslets − 2, 2·lenslets): orthonormal rows that remove the mean slope per axis, as jitter of a platform makes it.

    Use P s and P C Pᵀ in `strength_from_slopes`.
    """
    mean = np.zeros((2 * lenslets, 2))
    mean[0::2, 0] = mean[1::2, 1] = 1.0 / np.sqrt(lenslets)
    return np.linalg.svd(mean, full_matrices=True)[0][:, 2:].T.copy()


def range_weights(gate_range_m: ArrayLike, layer_edge_m: ArrayLike, target: Literal["mirror", "diffuse"]) -> Float:
    """W (gates, layers): strength at the pupil per strength of a layer, for a reflector at each gate's range.

    Main arguments:
        gate_range_m (gates): r. layer_edge_m (layers + 1): ascending borders [m] from the sensor; turbulence is even within a
        layer. target: "mirror": a collimated beam there and back through the same air, 2φ, thus 4 times the share of the
        layer before r;
            "diffuse": one spherical wave from the target, ∫ (1 − z/r)^{5/3} dz over the layer's thickness.

    Raises ValueError for another target or borders that do not ascend.
    """
    r = np.asarray(gate_range_m, np.float64)[:, None]
    edge = np.asarray(layer_edge_m, np.float64)
    if edge.ndim != 1 or edge.size < 2 or not (np.diff(edge) > 0).all() or edge[0] < 0:
        raise ValueError("layer_edge_m must be at least two ascending borders, none negative.")
    low, high = np.minimum(edge[:-1][None, :], r), np.minimum(edge[1:][None, :], r)
    if target == "mirror":
        return np.asarray(4.0 * (high - low) / np.diff(edge))
    if target == "diffuse":
        power = 8.0 / 3.0
        return np.asarray(r / power * ((1.0 - low / r) ** power - (1.0 - high / r) ** power) / np.diff(edge))
    raise ValueError(f'target must be "mirror" or "diffuse", not {target!r}.')


def layer_strengths(gate_strength: ArrayLike, gate_sigma: ArrayLike, weights: ArrayLike) -> Float:
    """x (layers) [m^{−5/3}], the strengths r₀^{−5/3} of the layers: least Σ((q − W x)/σ)² with x ≥ 0.

    `gate_strength` q and `gate_sigma` σ (gates), `weights` W (gates, layers). A layer that no gate sees gets 0. With a
    diffuse target the last layers before the farthest gate weigh little (.037 for the last of four) and take up the noise of
    the rest. Raises ValueError where σ is not positive.
    """
    q, sigma, w = (np.asarray(value, np.float64) for value in (gate_strength, gate_sigma, weights))
    if not (sigma > 0).all() or w.shape[0] != q.size:
        raise ValueError(f"gate_sigma must be positive and weights fit the gates: {q.shape}, {sigma.shape}, {w.shape}.")
    # In units in which the numbers are near 1: the solver's tolerance is absolute.
    scale = float(np.abs(q / sigma).max()) or 1.0
    size = np.linalg.norm(w / sigma[:, None], axis=0)
    safe = np.where(size > 0, size, 1.0)
    return np.asarray(nnls(w / sigma[:, None] / safe, q / sigma / scale)[0] * scale / safe)


def layer_shares(gates: Sequence[Strength], weights: ArrayLike) -> Float:
    """p (layers): the share of draws from the likelihoods at the gates in which each layer is the strongest.

    ln q of a gate is taken as Gaussian with a width of its likelihood-ratio interval (95 %) over 3.92, the lower half alone where
    the interval holds no turbulence; each draw is solved as `layer_strengths` does (B. Efron, Ann. Stat. 7:1, 1979: parametric
    bootstrap). `weights` W (gates, layers). Raises ValueError as `layer_strengths`.
    """
    w = np.asarray(weights, np.float64)
    q = np.array([max(one.q, 1e-3 * one.high) for one in gates])
    high = np.array([one.high for one in gates])
    low = np.array([max(one.low, 1e-3 * one.high) for one in gates])
    sigma = np.array([one.sigma for one in gates])
    normal = np.random.default_rng(_DRAW_SEED).standard_normal((_DRAWS, q.size))
    drawn = q * np.exp(normal * np.where(normal > 0, np.log(high / q), np.log(q / low)) / _HALF)
    best = [int(np.argmax(layer_strengths(one, sigma, w))) for one in drawn]
    return np.asarray(np.bincount(best, minlength=w.shape[1]) / _DRAWS)


def _maximum(e: Float, energy: Float, frames: int, level: float) -> Strength:
    """Maximum over q ≥ 0 of ln L, its interval and curvature, from the eigenvalues."""

    def log_likelihood(q: float) -> float:
        return float(-0.5 * (frames * np.log1p(q * e) + energy / (1.0 + q * e)).sum())

    seen = e > 1e-12 * max(float(e.max(initial=0.0)), 1e-300)
    if not seen.any():
        raise ValueError("unit is zero: these slopes do not see turbulence.")
    # Between the strength that one mode alone would give at most and far below the least that any mode can show.
    top = float(np.max(energy[seen] / frames / e[seen])) + 1.0 / float(e[seen].max())
    bottom = 1e-9 / float(e.max())
    found = minimize_scalar(
        lambda u: -log_likelihood(float(np.exp(u))), bounds=(np.log(bottom), np.log(10.0 * top)), method="bounded",
        options={"xatol": 1e-9},
    )  # fmt: skip
    q = float(np.exp(found.x))
    at_zero = log_likelihood(0.0)
    if log_likelihood(q) <= at_zero or q < 2.0 * bottom:
        q = 0.0
    best = max(log_likelihood(q), at_zero)
    drop = 0.5 * float(chdtri(1, 1.0 - level))

    def over(value: float) -> float:
        return log_likelihood(value) - best + drop

    low = 0.0 if q == 0.0 or over(0.0) >= 0.0 else brentq(over, 0.0, q, xtol=1e-300, rtol=1e-10)
    high = max(q, 1.0 / float(e.max()))
    while over(high) > 0.0:
        high *= 2.0
    high = brentq(over, q, high, xtol=1e-300, rtol=1e-10)
    information = 0.5 * frames * ((e / (1.0 + q * e)) ** 2).sum()
    return Strength(q, float(low), float(high), float(best - at_zero), float(1.0 / np.sqrt(information)))


def _length(q: float) -> float:
    return float(q**-0.6) if q > 0 else float(np.inf)
