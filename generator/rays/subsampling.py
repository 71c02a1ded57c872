"""Where one ray through the pixel's centre is not enough, and how many are.

A smooth pixel is exact to second order from its centre ray and the tangent plane there. Neighbours show where that
fails: depth edges, facet edges, shadow and beam edges, creases, steep tilt. A regular n×n grid over such a pixel errs by
about q/n^1.5 (a regular grid of 64 equals about 730 random samples), q being the error of the centre ray alone. Rays are
shared out so that the stack's ε meets the request with the fewest rays: minimising Σn² under
Σ w²q²/n³ = rtol² Σw² gives n ∝ (w q)^(2/5).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...optics.jit import kernel, prange

__all__ = ["GRIDS", "SubsamplePlan", "centre_error", "lattice", "plan", "stack_power"]

Float = NDArray[np.float64]

#: Sides of the grids that are used.
GRIDS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64])
#: Error of the centre ray at a straight edge of unit contrast that crosses the pixel or its border: rms over positions.
_EDGE = 0.3
#: Error of the centre ray at a crease, per relative change of the time's gradient over the pixel: at most 1/8 for one crease,
#: more for several.
_CREASE = 0.16
#: By how much an edge's error grows, at most, where the pixel's depth exceeds R's width.
_DEEP = 0.7


@dataclass(frozen=True)
class SubsamplePlan:
    """Pixels (flat indices) and the n of their n×n grids."""

    pixel: NDArray[np.int64]
    n: int


def centre_error(
    amplitude: Float, tau: Float, per_row: Float, per_col: Float, sigma_s: float, seen: Float | None = None
) -> tuple[Float, Float, Float, Float]:
    """Relative error q of each pixel's centre ray, predicted from its eight neighbours, and the brightness w near it;
    and what one ray stands for: the shift of the echo's centroid from its own time, and the time's spread (1 σ), s.

    Main arguments (rows + 2, cols + 2): the image and one ring of rays around it, without which an edge that crosses the
    outer half of a border pixel would go unseen. Results are (rows, cols).
        amplitude: photoelectrons of the centre ray, 0 where nothing is seen; tau: its time, s.
        per_row, per_col: gradient of tau on the tangent plane, s per pixel; sigma_s: σ of R.
        seen: weight of each ray's light in the stack, which w is multiplied by; by default 1.

    A jump of the time by σ changes R by about itself; a jump of the amplitude counts by its share of the brighter side.
    On a surface without jump two neighbours differ by the mean of their gradients, give or take half the difference.
    Over a pixel the time is spread evenly along both axes: variance (g_row² + g_col²)/12. Where the echo brightens
    toward later times, its centroid is later than the centre ray's: Σ (∂a/a)(∂τ)/12.
    """
    shape = (amplitude.shape[0] - 2, amplitude.shape[1] - 2)
    error, bright, shift, spread = (np.zeros(shape) for _ in range(4))
    weighted = amplitude if seen is None else amplitude * seen
    _centre_error(amplitude, weighted, tau, per_row, per_col, 1.0 / sigma_s, error, bright, shift, spread)
    return error, bright, shift, spread


@kernel(parallel=True)
def _centre_error(a, weighted, t, gr, gc, inv_sigma, error, bright, shift, spread):  # type: ignore[no-untyped-def]
    rows, cols = error.shape
    for i in prange(rows):
        for j in range(cols):
            p, q = i + 1, j + 1
            here = a[p, q]
            t_here = t[p, q]
            top = weighted[p, q]
            worst = 0.0
            for dr in range(-1, 2):
                for dc in range(-1, 2):
                    if dr == 0 and dc == 0:
                        continue
                    there = a[p + dr, q + dc]
                    top = max(top, weighted[p + dr, q + dc])
                    share = 1.0 if dr == 0 or dc == 0 else 0.5  # a diagonal neighbour's edge cuts a corner only
                    larger = max(abs(there), abs(here), abs(a[p - dr, q - dc]))
                    jump = 0.0
                    if larger > 0.0:
                        jump = min(abs(there - 2.0 * here + a[p - dr, q - dc]) / larger, 1.0)
                    if here > 0.0 and there > 0.0:
                        mean = 0.5 * ((gr[p, q] + gr[p + dr, q + dc]) * dr + (gc[p, q] + gc[p + dr, q + dc]) * dc)
                        bend = abs((gr[p, q] - gr[p + dr, q + dc]) * dr) + abs((gc[p, q] - gc[p + dr, q + dc]) * dc)
                        step = max(abs(t[p + dr, q + dc] - t_here - mean) - 0.5 * bend, 0.0) * inv_sigma
                        jump = max(jump, min(step, 1.0))
                        worst = max(worst, _CREASE * share * min(bend * inv_sigma, 2.0))
                    worst = max(worst, _EDGE * share * jump)
            variance = (gr[p, q] * gr[p, q] + gc[p, q] * gc[p, q]) / 12.0
            spread[i, j] = np.sqrt(variance)
            if here > 0.0:
                turn = (a[p + 1, q] - a[p - 1, q]) * gr[p, q] + (a[p, q + 1] - a[p, q - 1]) * gc[p, q]
                # Light that changes linearly and is nowhere negative moves its centroid by no more than a sixth per axis.
                most = (abs(gr[p, q]) + abs(gc[p, q])) / 6.0
                shift[i, j] = min(max(turn / (24.0 * here), -most), most)
            variance *= inv_sigma * inv_sigma
            # Where the pixel is deeper than R is wide, every slice sees a part of it, with edges of its own.
            worst *= 1.0 + _DEEP * min(variance, 1.0)
            # Two-point quadrature of a uniform spread s leaves about (s/σ)⁴/20 of R.
            error[i, j] = max(worst, min(variance * variance / 20.0, 1.0))
            bright[i, j] = top


def lattice(count: int) -> tuple[Float, Float]:
    """`count` points of a golden-ratio lattice in the pixel, (row, col) offsets in −0.5 … 0.5, their mean at the centre.

    As even as a square grid for slanted edges, and unlike it as even for edges along rows and columns.
    """
    i = np.arange(count)
    row = (i + 0.5) / count - 0.5
    col = (i * 0.6180339887498949 + 0.5) % 1.0
    return row, col - col.mean()


def stack_power(error: Float, light: Float) -> float:
    """Σ of the squared light of the pixels: what ε² is relative to.

    Main arguments: `error` q of `centre_error`; `light` of the centre rays, as the stack shows it. An edge anywhere in a pixel
    leaves a share s of its light, 〈s²〉 = 1/3, whose centre ray is lit half the time.
    """
    cut = np.minimum(error / _EDGE, 1.0) / 3.0
    return float(np.sum(light**2 * (1.0 - cut)))


def plan(error: Float, bright: Float, power: float, rtol: float) -> list[SubsamplePlan]:
    """Choose grids so that the stack's relative error ε = sqrt(Σ(ΔX)²/ΣX²) is about `rtol` with the fewest rays.

    Main arguments: `error` q and `bright` w of `centre_error`; power: ΣX² by `stack_power`; rtol: ε aimed at.
    """
    q, w = error.ravel(), bright.ravel()
    wq = w * q
    budget = rtol**2 * power
    if budget <= 0 or float(np.dot(wq, wq)) <= budget:
        return []
    # Work on a histogram of log(wq): a few hundred bins stand for all pixels.
    live = np.flatnonzero(wq > np.sqrt(budget / wq.size) * 0.1)
    edges = np.geomspace(wq[live].min() * 0.999, wq[live].max() * 1.001, 257)
    which = np.digitize(wq[live], edges) - 1
    count = np.bincount(which, minlength=256)[:256]
    centre = np.sqrt(edges[:-1] * edges[1:])
    low, high = 1e-6 / centre.max(), 1e6 / centre.min()
    side = np.ones(256, dtype=int)
    for _ in range(60):
        middle = np.sqrt(low * high)
        side = _side((middle * centre) ** 0.4)
        if float(np.sum(count * centre**2 / side**3.0)) > budget:
            low = middle
        else:
            high = middle
    side = _side((high * centre) ** 0.4)
    n_of = side[which]
    return [SubsamplePlan(live[n_of == n].astype(np.int64), int(n)) for n in GRIDS[1:] if np.any(n_of == n)]


def _side(wanted: Float) -> NDArray[np.int64]:
    """The grid side nearest above `wanted`."""
    return np.asarray(GRIDS[np.minimum(np.searchsorted(GRIDS, wanted - 0.25), len(GRIDS) - 1)], dtype=np.int64)
