"""The compiled sums of `ziv_zakai.local_bound`: ∫ h Q(d(h)/2) dh over both sides of every delay."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...optics.jit import kernel

__all__ = ["local_sums"]

_ROOT2 = math.sqrt(2.0)
_ROOT2PI = math.sqrt(2.0 * math.pi)


@kernel
def _piece(h0: float, h1: float, x0: float, x1: float) -> float:
    """∫ h Q(x(h)) dh over [h0, h1], with x linear from x0 to x1. Closed form: ∫Q = xQ − φ, ∫xQ = ½(x²Q − xφ − Q)."""
    if x0 > 8.5 and x1 > 8.5:
        return 0.0
    q0, q1 = 0.5 * math.erfc(x0 / _ROOT2), 0.5 * math.erfc(x1 / _ROOT2)
    if abs(x1 - x0) < 1e-3:  # the closed form would subtract nearly equal numbers
        return 0.5 * (h1 - h0) * (h0 * q0 + h1 * q1)
    p0, p1 = math.exp(-0.5 * x0 * x0) / _ROOT2PI, math.exp(-0.5 * x1 * x1) / _ROOT2PI
    c = (x1 - x0) / (h1 - h0)
    one = (x1 * q1 - p1) - (x0 * q0 - p0)
    two = 0.5 * ((x1 * x1 * q1 - x1 * p1 - q1) - (x0 * x0 * q0 - x0 * p0 - q0))
    return (two + (c * h0 - x0) * one) / (c * c)


@kernel
def local_sums(distance: Any, slope: Any, step: float, width: float) -> Any:
    """(ε² (θ), far² (θ), ∫P(θ, θ+h)dθ (h)) from d (θ, θ') and √F (θ)."""
    n = distance.shape[0]
    epsilon2, far2, error = np.zeros(n), np.zeros(n), np.zeros(n)
    for i in range(n):
        for side in (-1, 1):
            last = i if side < 0 else n - 1 - i
            if last < 1:
                continue
            # Within the first step: nodes at step/128 … step, d bent from the tangent to the chord.
            chord = distance[i, i + side] / step
            h0, x0 = 0.0, 0.0
            total = 0.0
            for power in range(-7, 1):
                h1 = step * 2.0**power
                x1 = 0.5 * h1 * (slope[i] + (chord - slope[i]) * h1 / step)
                total += _piece(h0, h1, x0, x1)
                h0, x0 = h1, x1
            far, cell, worst = 0.0, 0, 0.0
            for j in range(2, last + 1):
                h1 = step * j
                x1 = 0.5 * distance[i, i + side * j]
                total += _piece(h0, h1, x0, x1)
                if h0 >= 2.0 * width and x0 < 8.5:
                    # One wrong decision per cell of one width, the most probable one, as lobes are narrower than cells (phases).
                    here = int((h0 - 2.0 * width) / width)
                    if here != cell:
                        far, cell, worst = far + worst, here, 0.0
                    worst = max(worst, h0 * h0 * 0.5 * math.erfc(x0 / _ROOT2))
                h0, x0 = h1, x1
            epsilon2[i] += 0.5 * total
            far2[i] += far + worst
            if side > 0:
                for j in range(last + 1):  # the pair of both ends spans no delays
                    if j == n - 1:
                        break
                    weight = 0.5 if i == 0 or j == last else 1.0
                    error[j] += step * weight * 0.5 * math.erfc(0.5 * distance[i, i + j] / _ROOT2)
    return epsilon2, far2, error
