"""Where one ray through the pixel's centre is not enough, and how many are.

A smooth pixel is exact to second order from its centre ray and the tangent plane there. Second differences of the echo
between neighbours tell where that fails: at depth edges, facet edges, shadow and beam edges, and under steep tilt. Such a
pixel gets a regular n×n grid, whose error for a straight edge of contrast δ is about 0.3 δ/n^1.5 (a regular grid of 64
equals about 730 random samples). n follows from the error asked for and from the share of the light in such pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["SubsamplePlan", "contrast", "plan"]

Float = NDArray[np.float64]

#: Classes of contrast: hard edges, creases, faint creases. The faintest threshold follows from rtol.
_CLASS_BOUNDS = (0.3, 0.06)
#: Error of a straight edge of unit contrast, seen by an n×n grid, times n^1.5.
_GRID_ERROR = 0.3
_MOST = 32


@dataclass(frozen=True)
class SubsamplePlan:
    """Pixels (flat indices) and the n of their n×n grids."""

    pixel: NDArray[np.int64]
    n: int


def contrast(amplitude: Float, tau: Float, target: NDArray[np.int32], spread_s: Float, sigma_s: float) -> Float:
    """Contrast δ (rows, cols) of the echo within each pixel, 0 … 1, from its neighbours.

    The largest of: second differences of the amplitude relative to the largest amplitude there; of the time relative
    to σ of R (an amount that changes R by about itself); another object or a miss beside it (1); and the tangent
    plane's spread over the pixel where that is not small against σ (two-point quadrature leaves its fourth order).
    """
    a = np.pad(amplitude, 1, mode="reflect", reflect_type="odd") if min(amplitude.shape) > 1 else np.pad(amplitude, 1)
    t = np.where(target >= 0, tau, 0.0)
    result = np.zeros_like(amplitude)
    hit = target >= 0
    for axis in (0, 1):
        if amplitude.shape[axis] < 2:
            continue
        before, here, after = _three(a, axis)
        largest = np.maximum(np.maximum(np.abs(before), np.abs(after)), np.abs(here))
        with np.errstate(invalid="ignore", divide="ignore"):
            jump = np.where(largest > 0, np.abs(before - 2 * here + after) / largest, 0.0)
        np.maximum(result, np.minimum(jump, 1.0), out=result)
        if amplitude.shape[axis] > 2:
            middle = [slice(None), slice(None)]
            middle[axis] = slice(1, -1)
            index = tuple(middle)
            low, high = [slice(None), slice(None)], [slice(None), slice(None)]
            low[axis], high[axis] = slice(None, -2), slice(2, None)
            bend = np.abs(t[tuple(low)] - 2 * t[index] + t[tuple(high)]) / sigma_s
            all_hit = hit[tuple(low)] & hit[index] & hit[tuple(high)]
            result[index] = np.maximum(result[index], np.where(all_hit, np.minimum(bend, 1.0), 0.0))
    result[_beside_another(target)] = 1.0
    # Two-point quadrature of a uniform spread s leaves (s/σ)⁴/… of R; below 0.25 σ that is under 1e-4.
    steep = (spread_s / sigma_s) ** 4 / 20.0
    return np.asarray(np.maximum(result, np.minimum(steep, 1.0)))


def _three(padded: Float, axis: int) -> tuple[Float, Float, Float]:
    core = padded[:, 1:-1] if axis == 0 else padded[1:-1, :]
    if axis == 0:
        return core[:-2], core[1:-1], core[2:]
    return core[:, :-2], core[:, 1:-1], core[:, 2:]


def _beside_another(target: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Pixels one of whose eight neighbours sees another object, or nothing where it sees something."""
    edge = np.zeros(target.shape, dtype=bool)
    rows, cols = target.shape
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = (slice(0, rows - dr), slice(max(0, -dc), cols - max(0, dc)))
        there = (slice(dr, rows), slice(max(0, dc), cols - max(0, -dc)))
        differ = target[here] != target[there]
        edge[here] |= differ
        edge[there] |= differ
    return edge


def plan(delta: Float, weight: Float, rtol: float) -> list[SubsamplePlan]:
    """Choose grids so that the stack's relative error ε stays near `rtol`.

    Main arguments:
        delta: contrast (rows, cols); `weight`: brightness of a pixel (its largest neighbour's amplitude).
        rtol: ε of DESIGN.md, sqrt(Σ(ΔX)²/ΣX²).

    A pixel of contrast δ that stays at one sample errs by about 0.3 δ at most where an edge crosses it.
    """
    flat, light = delta.ravel(), np.square(weight.ravel())
    total = float(light.sum())
    if total <= 0:
        return []
    faint = 3.0 * rtol
    bounds = [np.inf, *(b for b in _CLASS_BOUNDS if b > faint), faint]
    plans = []
    for upper, lower in zip(bounds[:-1], bounds[1:], strict=True):
        chosen = np.flatnonzero((flat > lower) & (flat <= upper))
        if not len(chosen):
            continue
        share = float(light[chosen].sum()) / total
        typical = min(upper, 1.0)
        # Three classes add in squares, and each may take a third of ε².
        wanted = _GRID_ERROR * typical * np.sqrt(3.0 * share) / rtol
        n = int(np.clip(np.ceil(max(wanted, 0.0) ** (2.0 / 3.0)), 2, _MOST))
        plans.append(SubsamplePlan(chosen.astype(np.int64), n))
    return plans
