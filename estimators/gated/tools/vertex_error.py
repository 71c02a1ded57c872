"""The error of a vertex through the brightest slice and its neighbours, tabulated by simulation.

The error has three causes, and only the third is linear: the brightest slice need not be the one nearest the top (noise
decides among those of nearly equal height), the curve through three samples is not R (a bias that repeats in every step),
and the noise of the three samples moves the vertex through a quotient. So the estimator is simulated: on pixels of the declared
response, at places spread evenly over the steps and amplitudes spread evenly in decades, with normal noise of fixed draws. The
table holds the mean square of the errors against three numbers that every pixel shows: the relative noise, the share of it that
does not grow with the echo, and the place of the vertex between its neighbours. The mean over a cell contains the square of
the bias.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from statistics import NormalDist
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ....optics.jit import kernel
from .maximum import Maximum
from .stack import Stack

__all__ = ["Vertex", "vertex_sigma"]

Float = npt.NDArray[np.float64]
#: x(y before, at, after, step before, step after): place of the vertex after the brightest sample, NaN without one.
Vertex = Callable[[Float, Float, Float, Float, Float], Float]
Level = Literal["least", "mean", "left"]

#: lg of the relative noise variance of the brightest sample: cells per decade, and limits.
_PER_DECADE, _QUIETEST, _LOUDEST = 4, -9.0, 0.5
_NOISE = int(_PER_DECADE * (_LOUDEST - _QUIETEST)) + 1
#: Cells over the flat share of the variance (background, read noise), and over the place of the vertex.
_SHARES, _PLACES = 3, 9
#: Numbers drawn for each share, and most and least trials: 20 to 150 in a cell, a standard error of its sigma of 6 to 16 %,
#: less where the eight cells about a pixel are averaged.
_DRAWS, _MOST, _LEAST = 250_000, 12_000, 5_000
#: A slice takes part in a trial where R may exceed this part of its peak.
_SEEN = 0.02
_tables: OrderedDict[tuple[Any, ...], Float] = OrderedDict()


@kernel(error_model="numpy")
def _weigh(noise, share, place):  # type: ignore[no-untyped-def]
    """Cells, and fractions of cells, of (lg noise, flat share, place −1…1), each kept inside the table."""
    a = (min(max(noise, _QUIETEST), _LOUDEST) - _QUIETEST) * _PER_DECADE
    b = min(max(share, 0.0), 1.0) * (_SHARES - 1)
    c = (min(max(place, -1.0), 1.0) + 1) * 0.5 * (_PLACES - 1)
    i, j, k = min(int(a), _NOISE - 2), min(int(b), _SHARES - 2), min(int(c), _PLACES - 2)
    return i, j, k, a - i, b - j, c - k


@kernel(error_model="numpy")
def _deposit(noise, share, place, square, total, number):  # type: ignore[no-untyped-def]
    for t in range(noise.size):
        i, j, k, a, b, c = _weigh(noise[t], share, place[t])
        for di in range(2):
            for dk in range(2):
                w = (a if di else 1 - a) * (c if dk else 1 - c)
                for dj in range(2):
                    v = w * (b if dj else 1 - b)
                    total[i + di, j + dj, k + dk] += v * square[t]
                    number[i + di, j + dj, k + dk] += v


@kernel(error_model="numpy")
def _look(at, low, x, index, t, exposure, reads, noise, table, out):  # type: ignore[no-untyped-def]
    excess, floor = noise
    for p in range(at.size):
        k = index[p]
        height = at[p] - low[p]
        if not (height > 0 and x[p] == x[p]):
            continue
        flat = excess * max(low[p], 0.0) + floor * reads[k]
        variance = (excess * max(height, 0.0) + flat) / exposure[k]
        step = t[k + 1] - t[k] if x[p] > 0 else t[k] - t[k - 1]
        relative = np.log10(max(variance / (height * height), 1e-30))
        share = flat / (excess * height + flat)
        i, j, m, a, b, c = _weigh(relative, share, 2 * x[p] / step)
        value = 0.0
        for di in range(2):
            for dj in range(2):
                w = (a if di else 1 - a) * (b if dj else 1 - b)
                value += w * ((1 - c) * table[i + di, j + dj, m] + c * table[i + di, j + dj, m + 1])
        out[p] = np.exp(value)


def _cells(response: Any, t: Float) -> tuple[Float, Float, npt.NDArray[np.int64], float]:
    """τ of trials spread evenly over the steps that have neighbours, R/max R of the slices about each (trial, slice; NaN
    beyond the stack), the first slice of each, and the number of slices that R does not reach."""
    n = t.size
    held = response.start_s + response.step_s * np.flatnonzero(response.value >= _SEEN * response.peak)
    before, after = held[-1] - response.peak_s, response.peak_s - held[0]
    # Slices that may see an echo whose top is at t: R(τ − t_k) with τ = t + peak_s.
    first = np.searchsorted(t, t - before)
    last = np.searchsorted(t, t + after, side="right")
    reach = max(int((last - first).max()) + 2, 3)
    trials = int(np.clip(_DRAWS // reach, _LEAST, _MOST))
    # Where the steps are even one stands for all: the middle one, far from the ends.
    gaps = np.diff(t)
    even = float(np.ptp(gaps)) <= 1e-6 * float(gaps.mean())
    edges = t[(n - 1) // 2 : (n - 1) // 2 + 2] if even else t[1:-1] if n > 3 else t
    place = (np.arange(trials) + 0.5) / trials * (edges.size - 1)
    top = np.interp(place, np.arange(edges.size), edges)
    start = np.clip(np.searchsorted(t, top - before) - 1, 0, None)
    index = start[:, None] + np.arange(reach)
    inside = index < n
    when = t[np.minimum(index, n - 1)]
    r = response(np.asarray(top[:, None] + response.peak_s - when))[0] / response.peak
    return top + response.peak_s, np.where(inside, np.maximum(r, 0.0), np.nan), start, float(max(n - reach, 1))


def _trials(stack: Stack, vertex: Vertex, level_is: Level) -> Float:
    n = stack.signal
    response = stack.instrument.responses[int(stack.gate[0])]
    t = stack.delay_s[:n]
    tau, r, start, outside = _cells(response, t)
    rng = np.random.default_rng(20170904)
    trials, reach = r.shape
    normal = rng.standard_normal((trials, reach))
    # Weak and strong echoes at every place: a golden-ratio sequence covers both evenly.
    scale = 10 ** (_QUIETEST + (_LOUDEST - _QUIETEST) * ((np.arange(trials) * 0.6180339887498949) % 1.0))
    # The least of many slices lies below their mean (Blom's mean of an extreme).
    least = NormalDist().inv_cdf(0.625 / (outside + 0.25)) if level_is != "mean" and outside > 1 else 0.0
    total, number = np.zeros((_NOISE, _SHARES, _PLACES)), np.zeros((_NOISE, _SHARES, _PLACES))
    rows = np.arange(trials)
    for share in np.linspace(0, 1, _SHARES):
        level = min(share, 0.95) / (1 - min(share, 0.95)) if level_is == "left" else 0.0
        y = r + level + np.sqrt(scale[:, None] * ((1 - share) * r + share)) * normal
        best = np.nanargmax(y, axis=1)
        middle = np.clip(best, 1, reach - 2)
        here = start + middle
        inner = (best == middle) & (here >= 1) & (here <= n - 2)
        here = np.clip(here, 1, n - 2)
        a, b = t[here] - t[here - 1], t[here + 1] - t[here]
        at = y[rows, middle]
        with np.errstate(divide="ignore", invalid="ignore"):
            x = vertex(y[rows, middle - 1], at, y[rows, middle + 1], a, b)
            error = t[here] + x + response.peak_s - tau
            height = at - level - least * np.sqrt(scale * share)
            noise = np.log10(scale * ((1 - share) * np.maximum(height, 0) + share) / height**2)
            good = inner & np.isfinite(error) & np.isfinite(noise) & (height > 0)
            place = 2 * x / np.where(x > 0, b, a)
        _deposit(noise[good], share, place[good], error[good] ** 2, total, number)
    return _filled(total, number)


def _filled(total: Float, number: Float) -> Float:
    """ln of the mean square per cell; cells of few trials take the mean of others, along the place, then the share, and then
    the values of the nearest noise."""
    for axis in (2, 1):
        few = number < 8
        total, number = (np.where(few, a + a.sum(axis=axis, keepdims=True), a) for a in (total, number))
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.log(total / number)
    known = np.isfinite(found) & (number >= 8)
    rows = np.flatnonzero(known.all(axis=(1, 2)))
    if rows.size == 0:
        return np.full(found.shape, np.nan)
    nearest = rows[np.abs(np.arange(_NOISE)[:, None] - rows).argmin(axis=1)]
    return np.ascontiguousarray(np.where(known, found, found[nearest]))


def vertex_sigma(stack: Stack, found: Maximum, low: Float, x: Float, vertex: Vertex, level_is: Level) -> Float:
    """Root mean square error [s] (row, col) of vertices at x [s] after the brightest slice; NaN where x is NaN or there is no
    light above low.

    low: level of the pixel without echo [photoelectrons per slice]; vertex: the formula of the estimator; level_is: whether
    low is the "least" of the samples, a "mean", or the least of a level that is "left" in the samples of the formula (where it
    bends logarithms). The first call with an instrument and its delays takes some hundredths of a second, later ones a lookup.
    """
    key = (stack.key, vertex.__module__, level_is)
    if key not in _tables:
        _tables[key] = _trials(stack, vertex, level_is)
        while len(_tables) > 8:
            _tables.popitem(last=False)
    rig = stack.instrument
    out = np.full(x.shape, np.nan)
    index = np.clip(found.index, 1, stack.signal - 2)
    _look(
        found.at.reshape(-1), low.reshape(-1), x.reshape(-1), index.reshape(-1), stack.delay_s, stack.exposure, stack.reads,
        (rig.excess, rig.floor_var), _tables[key], out.reshape(-1),
    )  # fmt: skip
    return np.asarray(np.sqrt(out))
