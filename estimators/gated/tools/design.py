"""The design table of a likelihood fit: R and its derivatives at every delay, for echo times on a dense even grid.

Row j holds R(τ_j − t_k)·e_k and its first two Taylor terms for all groups k of the stack, so that a fit reads
neighbouring numbers and needs no interpolation: R(τ) = v + f·(s + f·c) with f = (τ−τ_j)/du in ±½. At du = σ_R/64 the
neglected cubic term is below 1e-7 of the peak for a Gaussian response.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ....scenes.errors import InputError
from .stack import Stack

__all__ = ["Design", "design_of"]

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

#: Most numbers in one Taylor order of a table (64 MB); longer windows get a coarser grid.
MAX_CELLS = 8_000_000
#: Largest curvature of R, in units of its peak over σ_R², of a smooth response: 1 for a Gaussian, 64 (σ_R over a row) at
#: a corner. Beyond it the tops of likelihoods are flat enough to matter (`poisson_flat`).
_CORNER = 16.0
_kept: OrderedDict[tuple[object, ...], Design] = OrderedDict()


@dataclass(frozen=True)
class Design:
    """The table and what a fit needs beside it.

    table (row, order, group). first, last (row): groups in which R is above 1e-6 of its peak. origin_s, step_s: τ of row 0
    and its step. low, high: rows between which an echo lies well inside the window. candidates: rows of the matched filter
    that starts a fit, with `mean` (projection on the background), `norm` (1/length without it; 1/length of its box) and
    `box` (first, last + 1, exposure² inside: groups in which R is above .3 of its peak). width: σ_R in rows. corners:
    whether R has corners.
    """

    table: Float
    first: Int
    last: Int
    origin_s: float
    step_s: float
    low: float
    high: float
    width: float
    candidates: Int
    mean: Float
    norm: Float
    box: Int
    corners: bool


def _build(stack: Stack) -> Design:
    responses = stack.instrument.responses
    delay, gate, exposure = stack.delay_s[: stack.signal], stack.gate[: stack.signal], stack.exposure
    used = [responses[i] for i in np.unique(gate)]
    width = float(np.sqrt(min(r.variance_s2 for r in used)))
    begin = min(float(delay[gate == i].min()) + responses[i].lo_s for i in np.unique(gate))
    end = max(float(delay[gate == i].max()) + responses[i].hi_s for i in np.unique(gate))
    step = max(width / 64, (end - begin) * stack.groups / MAX_CELLS)
    if step > width / 4:
        raise InputError(
            "The delays span too wide a window for the width of the response.", where="delay", value=end - begin,
            allowed=f"up to {width / 4 * MAX_CELLS / stack.groups:.3g} s", next_step="cut the stack into parts",
        )  # fmt: skip
    rows = int(np.ceil((end - begin) / step)) + 1
    tau = begin + step * np.arange(rows)
    table = np.zeros((rows, 3, stack.groups))
    for k in range(stack.signal):
        r, d, dd = responses[gate[k]](tau - delay[k])
        table[:, 0, k], table[:, 1, k], table[:, 2, k] = r, d * step, 0.5 * dd * step**2
    table *= exposure
    value = table[:, 0, :]
    held = value > 1e-6 * value.max()
    first = np.where(held.any(axis=1), held.argmax(axis=1), 0)
    last = np.where(held.any(axis=1), stack.groups - held[:, ::-1].argmax(axis=1), 0)
    light = value.sum(axis=1)
    inside = np.flatnonzero(light >= 0.25 * light.max())
    stride = max(1, int(0.75 * width / step))
    candidates = np.arange(inside[0], inside[-1] + 1, stride)
    square = float((exposure**2).sum())
    mean = value[candidates] @ exposure / square
    length = np.sqrt(np.maximum((value[candidates] ** 2).sum(axis=1) - mean**2 * square, 0))
    wide = value[candidates] > 0.3 * value.max()
    wide[np.arange(candidates.size), value[candidates].argmax(axis=1)] = True
    left, right = wide.argmax(axis=1), stack.groups - wide[:, ::-1].argmax(axis=1)
    running = np.concatenate(([0.0], np.cumsum(exposure**2)))
    box = running[right] - running[left]
    norm = np.stack([1 / np.maximum(length, 1e-3 * length.max()), 1 / np.sqrt(box)], axis=1)
    return Design(
        table=table,
        first=first.astype(np.int64),
        last=last.astype(np.int64),
        origin_s=begin,
        step_s=step,
        low=float(inside[0]),
        high=float(inside[-1]),
        width=width / step,
        candidates=candidates,
        mean=mean,
        norm=norm,
        box=np.stack([left, right, np.round(box)], axis=1).astype(np.int64),
        corners=_has_corners(value, width / step),
    )


def _has_corners(value: Float, width: float) -> bool:
    """Whether R (row, group) has corners; width: σ_R in rows."""
    if value.shape[0] < 3:
        return False
    bend = float(np.abs(value[2:] - 2 * value[1:-1] + value[:-2]).max())
    return bend * width**2 > _CORNER * float(value.max())


def design_of(stack: Stack) -> Design:
    """The table for the instrument and delays of a stack; the last few are kept. Raises InputError for too wide a window."""
    parts = (stack.delay_s, stack.gate, stack.exposure)
    key = (stack.instrument.key, stack.signal, *(part.tobytes() for part in parts))
    if key in _kept:
        _kept.move_to_end(key)
    else:
        _kept[key] = _build(stack)
        while len(_kept) > 4:
            _kept.popitem(last=False)
    return _kept[key]
