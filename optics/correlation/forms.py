"""Closed forms of R(u) = ∫ p(t) g(t + u) dt for every pair of a pulse p and a gate g (public face: `response.py`).

With S(x) = ∫_x^∞ p and Q(x) = ∫_x^∞ S, a piecewise-linear gate with jumps J_i and slope changes D_i at x_i gives

    R(u) = Σ J_i S(x_i − u) + D_i Q(x_i − u),       dR/du = Σ J_i p(x_i − u) + D_i S(x_i − u).

Gaussian gates and exponential decays with piecewise-linear pulses use the same form with the roles of p and g swapped;
with Gaussian and exGaussian pulses they give error functions (`_pair`). No quadrature is used.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammainc

from .gates import Gate, gate_parts
from .parts import Array, Decay, ExGaussian, Gaussian, Part, PiecewiseLinear
from .pulses import Pulse, pulse_part

__all__ = ["correlation", "correlation_kinks", "correlation_slope", "correlation_support"]


def correlation(pulse: Pulse, gate: Gate, u: ArrayLike) -> Array:
    """R(u) = ∫ p(t) g(t + u) dt, dimensionless: the fraction of a pulse that the gate (transmission ≤ 1) transmits.

    Main arguments:
        pulse, gate: shapes of `waveforms`; the pulse has unit area and its centroid at 0, the gate opens at 0.
        u: s, any shape: time from the gate's opening edge to the arrival of the pulse's centroid.
    Returns R in the shape of u. Raises ValueError for impossible shapes.
    """
    return _summed(_pair, pulse, gate, u)


def correlation_slope(pulse: Pulse, gate: Gate, u: ArrayLike) -> Array:
    """dR/du in 1/s at u [s], closed forms as in `correlation`; one-sided where R has a kink."""
    return _summed(_pair_slope, pulse, gate, u)


def _summed(pair: Callable[..., Array], pulse: Pulse, gate: Gate, u: ArrayLike) -> Array:
    """Sum over the gate's parts, exactly 0 outside the support, where the terms in Q cancel only up to rounding."""
    lo, hi = correlation_support(pulse, gate)
    x = np.asarray(u, dtype=np.float64)
    inside = np.clip(x, lo, hi)
    part = pulse_part(pulse)
    total = sum((pair(part, piece, inside) for piece in gate_parts(gate)), np.zeros_like(x))
    return np.asarray(np.where((x < lo) | (x > hi), 0.0, total), dtype=np.float64)


def correlation_support(pulse: Pulse, gate: Gate) -> tuple[float, float]:
    """(lo, hi) in s: R is zero, or below 1e-13 of its peak, outside."""
    (p_lo, p_hi), spans = pulse_part(pulse).support, [piece.support for piece in gate_parts(gate)]
    return min(s[0] for s in spans) - p_hi, max(s[1] for s in spans) - p_lo


def correlation_kinks(pulse: Pulse, gate: Gate) -> tuple[Array, float]:
    """(u, bend): the u [s] at which dR/du jumps, and the largest such jump [1/s]; empty and 0 if p or g is continuous.

    dR/du jumps by −J_g·J_p at u = x_g − x_p, x and J being the positions and heights of the jumps.
    """
    at_p, by_p = _jumps(pulse_part(pulse))
    found = [_jumps(piece) for piece in gate_parts(gate)]
    # Jumps of two parts at the same place add up: a rectangle's end and a decay's start may cancel.
    at_g, where = np.unique(np.concatenate([at for at, _ in found]), return_inverse=True)
    by_g = np.bincount(where, np.concatenate([by for _, by in found]), minlength=at_g.size)
    keep = np.abs(by_g) > 1e-12 * np.max(np.abs(by_g), initial=0.0)
    bend = float(np.max(np.abs(by_g[keep]), initial=0.0) * np.max(np.abs(by_p), initial=0.0))
    return np.unique((at_g[keep][:, None] - at_p[None, :]).ravel()), bend


def _jumps(part: Part) -> tuple[Array, Array]:
    if isinstance(part, PiecewiseLinear):
        return part.knot[part.jumps != 0.0], part.jumps[part.jumps != 0.0]
    if isinstance(part, Decay):
        return np.array([part.start]), np.array([part.height])
    return np.empty(0), np.empty(0)


def _pair(p: Gaussian | ExGaussian | PiecewiseLinear, g: Part, u: Array) -> Array:
    """R of two elementary shapes."""
    if isinstance(g, PiecewiseLinear) and not (isinstance(p, PiecewiseLinear) and p.knot.size < g.knot.size):
        total = np.zeros_like(u)
        for x, jump, bend in zip(g.knot, g.jumps, g.bends, strict=True):
            if jump != 0.0:
                total += jump * p.upper(x - u)
            if bend != 0.0:
                total += bend * p.upper2(x - u)
        return total
    if isinstance(p, PiecewiseLinear):
        if isinstance(g, Decay):
            return _lines_with_decay(p, g, u)
        total = np.zeros_like(u)
        for x, jump, bend in zip(p.knot, p.jumps, p.bends, strict=True):
            if jump != 0.0:
                total += jump * g.upper(x + u)
            if bend != 0.0:
                total += bend * g.upper2(x + u)
        return total
    if isinstance(g, Gaussian):
        return _with_gaussian(p, g).density(g.mean - u)
    assert isinstance(g, Decay)
    if isinstance(p, Gaussian):
        # The decay, mirrored, convolved with the Gaussian: an exGaussian of raw start g.start.
        return _decayed(p.sigma, g.tail, u + p.mean - g.start, g.height * g.tail * p.area)
    # exGaussian pulse X + E: either X alone is beyond the edge, or the memoryless E carries the sum beyond it.
    v = u + p.mean - p.tail - g.start
    weight = p.area * g.height * g.tail / (g.tail + p.tail)
    return weight * (_decayed(p.sigma, g.tail, v, g.tail) + _decayed(p.sigma, p.tail, -v, p.tail))


def _pair_slope(p: Gaussian | ExGaussian | PiecewiseLinear, g: Part, u: Array) -> Array:
    """dR/du of two elementary shapes."""
    if isinstance(g, Decay):
        # g' = height·δ(τ − start) − g/tail
        return g.height * p.density(g.start - u) - _pair(p, g, u) / g.tail
    total = np.zeros_like(u)
    if isinstance(g, PiecewiseLinear) and not (isinstance(p, PiecewiseLinear) and p.knot.size < g.knot.size):
        for x, jump, bend in zip(g.knot, g.jumps, g.bends, strict=True):
            if jump != 0.0:
                total += jump * p.density(x - u)
            if bend != 0.0:
                total += bend * p.upper(x - u)
        return total
    if isinstance(p, PiecewiseLinear):
        for x, jump, bend in zip(p.knot, p.jumps, p.bends, strict=True):
            if jump != 0.0:
                total -= jump * g.density(x + u)
            if bend != 0.0:
                total -= bend * g.upper(x + u)
        return total
    assert isinstance(g, Gaussian)
    if isinstance(p, Gaussian):
        both = _with_gaussian(p, g)
        return both.density(g.mean - u) * ((g.mean - u) - both.mean) / both.sigma**2
    return -ExGaussian(p.mean, float(np.hypot(p.sigma, g.sigma)), p.tail, p.area * g.area).derivative(g.mean - u)


def _with_gaussian(p: Gaussian | ExGaussian, g: Gaussian) -> Gaussian | ExGaussian:
    """p convolved with the (even) Gaussian gate, to be evaluated at g.mean − u."""
    sigma, area = float(np.hypot(p.sigma, g.sigma)), p.area * g.area
    return Gaussian(p.mean, sigma, area) if isinstance(p, Gaussian) else ExGaussian(p.mean, sigma, p.tail, area)


def _decayed(sigma: float, tail: float, v: Array, area: float) -> Array:
    """area/tail · E[exp(−(X + v)/tail); X + v > 0] with X ~ N(0, sigma): an exGaussian evaluated at v."""
    return ExGaussian(tail, sigma, tail, area).density(v)


def _lines_with_decay(p: PiecewiseLinear, g: Decay, u: Array) -> Array:
    """∫ p(t) g(t + u) dt cell by cell: ∫₀^L (a + m s) e^{−s/τ} ds = a τ(1 − e^{−L/τ}) + m τ² P(2, L/τ).

    P is the regularised lower incomplete gamma function, accurate for small and large L/τ, so that no digits are
    lost for decays much longer or shorter than the pulse.
    """
    total = np.zeros_like(u)
    slope = (p.left[1:] - p.right[:-1]) / np.diff(p.knot)
    for i in range(p.knot.size - 1):
        begin = np.clip(g.start - u, p.knot[i], p.knot[i + 1])
        length = (p.knot[i + 1] - begin) / g.tail
        value = p.right[i] + slope[i] * (begin - p.knot[i])
        arrival = np.exp(-np.maximum(begin + u - g.start, 0.0) / g.tail)
        total += arrival * (value * -np.expm1(-length) + slope[i] * g.tail * gammainc(2.0, length))
    return g.height * g.tail * total
