"""The design of a likelihood fit for even delays: one small table for all echo times.

For delays t_k = t_0 + k·h and τ = t_0 + h·x, R(τ − t_k) = R(h·(x − k)) depends on x − k alone. A pixel is read in a
window of W slices from k₀, and row i of the table holds R(h·(ξ_i − m)) for m = 0 … W−1 at ξ_i = ξ_0 + i/P: neighbouring
numbers, so that a Fisher step is a plain loop over slices. In between R = v + f·d, f in ±½: at P = 128 h/σ_R the
neglected term is below 1e-5 of the peak for a Gaussian response, and it vanishes in the mean over a row.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...response import Response
from .stack import Stack

__all__ = ["EvenDesign", "even_design_of"]

Float = npt.NDArray[np.float64]
Single = npt.NDArray[np.float32]
#: Windows are whole vectors of 16 single-precision lanes, two at a time.
LANES = 32
#: Slices by which an echo may move from its start before the window would have to follow.
SLACK = 4
#: Tables of more numbers would not fit the processor's caches: such stacks are fitted the general way.
MAX_CELLS = 4_000_000
_kept: OrderedDict[tuple[object, ...], EvenDesign | None] = OrderedDict()


@dataclass(frozen=True)
class EvenDesign:
    """The table and what a fit needs beside it.

    table (row, order, slice of the window). bend (row, slice of the window): R(ξ+d) + R(ξ−d) − 2R(ξ), d = σ_R/2: 2d² times
    the curvature that `misfit` takes. held (row, slice of the window): 1 where R or its
    curvature is above 1e-6 of the peak. phases: P, rows per step. xi: ξ of row 0. mask: 1 for slices
    that exist, from `-pad` on. low, high: x between which an echo lies well inside the window. width: σ_R in steps. grid: x
    of the matched filter that starts a fit, with template (candidate, slice), span (first, last + 1), mean (projection on
    the background) and norm (1/length without it). origin_s, step_s: delay of slice 0, and the step h.
    """

    table: Single
    bend: Single
    held: Single
    phases: int
    xi: float
    mask: Single
    pad: int
    low: float
    high: float
    width: float
    grid: Float
    template: Single
    span: npt.NDArray[np.int64]
    mean: Single
    norm: Single
    origin_s: float
    step_s: float


def _curvature(
    response: Response, u: Float, value: Float, step: float, width: float
) -> tuple[Float, npt.NDArray[np.bool_]]:
    """(`bend` of a design, where R or its curvature is above 1e-6 of the peak) at u steps, where R is `value`."""
    half = 0.5 * width
    sides = np.asarray(sum(response(np.asarray((u + side) * step, dtype=np.float64))[0] for side in (-half, half)))
    return sides - 2 * value, np.maximum(value, sides) > 1e-6 * response.peak


def _span(template: Float) -> npt.NDArray[np.int64]:
    """First and last + 1 slice of every candidate (row) that is above 1e-3 of the peak, or that candidate's own peak."""
    seen = template > 1e-3 * template.max()
    seen[np.arange(len(seen)), template.argmax(axis=1)] = True
    return np.stack([seen.argmax(axis=1), seen.shape[1] - seen[:, ::-1].argmax(axis=1)], axis=1).astype(np.int64)


def _build(stack: Stack) -> EvenDesign | None:
    n = stack.signal
    if n < 4 or n != stack.groups or np.unique(stack.gate).size > 1:
        return None
    if np.ptp(stack.exposure) != 0 or np.ptp(stack.count) != 0 or stack.slices.size != n:
        return None
    delay = stack.delay_s
    step = float((delay[-1] - delay[0]) / (n - 1))
    if not step > 0 or np.abs(delay - delay[0] - step * np.arange(n)).max() > 1e-6 * step:
        return None
    response = stack.instrument.responses[int(stack.gate[0])]
    width = float(np.sqrt(response.variance_s2)) / step
    held = np.flatnonzero(response.value > 1e-6 * response.peak)
    first = (response.start_s + response.step_s * (held[0] - 1)) / step
    last = (response.start_s + response.step_s * (held[-1] + 1)) / step
    phases = int(np.ceil(128 / width))
    support = int(np.ceil(last - first)) + 1
    slices = -(-(support + SLACK) // LANES) * LANES
    room = slices - support  # the part of the window that R does not fill: an echo may move by so much
    rows = (room + 1) * phases + 1
    if 2 * rows * slices > MAX_CELLS or support > 4 * n:
        return None
    xi = last
    u = xi + np.arange(rows)[:, None] / phases - np.arange(slices)
    value, slope, _bend = response(np.asarray(u * step, dtype=np.float64))
    table = np.stack([value, slope * step / phases], axis=1) * stack.exposure[0]
    bend, reached = _curvature(response, u, value, step, width)

    fine = np.arange(first, n - 1 + last, 1 / phases)
    light = np.zeros(fine.size)
    for k in range(n):
        light += response(np.asarray((fine - k) * step, dtype=np.float64))[0]
    inside = fine[light >= 0.25 * light.max()]
    grid = np.arange(inside[0], inside[-1], 0.75 * width)
    template = response(np.asarray((grid[:, None] - np.arange(n)) * step, dtype=np.float64))[0] * stack.exposure[0]
    span = _span(template)
    mean = template.mean(axis=1)
    length = np.sqrt(np.maximum((template**2).sum(axis=1) - mean**2 * n, 0))
    pad = slices + SLACK
    mask = np.zeros(n + 2 * pad)
    mask[pad : pad + n] = 1
    return EvenDesign(
        table=table.astype(np.float32),
        bend=np.asarray(bend * stack.exposure[0], dtype=np.float32),
        held=reached.astype(np.float32),
        phases=phases,
        xi=float(xi),
        mask=mask.astype(np.float32),
        pad=pad,
        low=float(inside[0]),
        high=float(inside[-1]),
        width=width,
        grid=grid,
        template=template.astype(np.float32),
        span=span,
        mean=mean.astype(np.float32),
        norm=(1 / np.maximum(length, 1e-3 * length.max())).astype(np.float32),
        origin_s=float(delay[0]),
        step_s=step,
    )


def even_design_of(stack: Stack) -> EvenDesign | None:
    """The table for a stack of even delays under one gate, in which no two slices share a delay and all have the same
    exposure; None for other stacks."""
    parts = (stack.delay_s, stack.gate, stack.exposure, stack.count)
    key = (stack.instrument.key, stack.signal, stack.slices.size, *(part.tobytes() for part in parts))
    if key in _kept:
        _kept.move_to_end(key)
    else:
        _kept[key] = _build(stack)
        while len(_kept) > 4:
            _kept.popitem(last=False)
    return _kept[key]
