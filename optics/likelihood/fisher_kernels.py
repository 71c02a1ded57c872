"""Compiled lookup of log J in log μ, and the sums of the 3×3 Fisher matrix over slices."""

from __future__ import annotations

import math
from typing import Any

from ..jit import kernel

__all__ = ["accumulate", "lookup"]


@kernel
def _one(mu: float, x: Any, y: Any, slope: Any) -> float:
    u = math.log(mu if mu > 1e-12 else 1e-12)
    last = x.size - 1
    if u > x[last]:
        return 0.0
    if u <= x[0]:
        return math.exp(y[0] + max(slope[0], -1.0) * (u - x[0])) if slope[0] < 0.0 else math.exp(y[0])
    low = 0
    high = last
    while high - low > 1:
        middle = (low + high) // 2
        if x[middle] <= u:
            low = middle
        else:
            high = middle
    h = x[high] - x[low]
    t = (u - x[low]) / h
    rest = 1.0 - t
    value = y[low] * (1.0 + 2.0 * t) * rest * rest + y[high] * t * t * (3.0 - 2.0 * t)
    return math.exp(value + h * t * rest * (slope[low] * rest - slope[high] * t))


@kernel
def lookup(mu: Any, x: Any, y: Any, slope: Any, out: Any) -> None:
    """out[k] = J(mu[k]) from nodes x = log μ, y = log J and slopes dy/dx."""
    for k in range(mu.size):
        out[k] = _one(mu[k], x, y, slope)


@kernel
def accumulate(mu: Any, d_tau: Any, d_amplitude: Any, d_background: Any, x: Any, y: Any, slope: Any, out: Any) -> None:
    """Adds J·d_i·d_j of each slice (slice, pixel) to out (6, pixel): ττ, τa, τb, aa, ab, bb."""
    for k in range(mu.shape[0]):
        for p in range(mu.shape[1]):
            j = _one(mu[k, p], x, y, slope)
            t, a, b = d_tau[k, p], d_amplitude[k, p], d_background[k, p]
            out[0, p] += j * t * t
            out[1, p] += j * t * a
            out[2, p] += j * t * b
            out[3, p] += j * a * a
            out[4, p] += j * a * b
            out[5, p] += j * b * b
