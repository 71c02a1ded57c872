"""The brightest group of every pixel with its neighbours: shared by `peak` and `parabola`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ....optics.jit import kernel
from .stack import Stack, load_row

__all__ = ["Maximum", "brightest"]

Float = npt.NDArray[np.float64]
#: Pixels read at a time: their samples stay in the first-level cache.
TILE = 32


@dataclass(frozen=True)
class Maximum:
    """Per pixel (row, col): index of the brightest signal group; photoelectrons per slice before, at and after it (NaN
    beyond an end) and in the darkest group (low); number of clipped or NaN samples (bad); whether a maximum exists (ok)."""

    index: npt.NDArray[np.int64]
    before: Float
    at: Float
    after: Float
    low: Float
    bad: npt.NDArray[np.int64]
    ok: npt.NDArray[np.bool_]


@kernel(error_model="numpy")
def _scan(counts, slices, group, share, signal, offset, scale, saturation, index, values, bad):  # type: ignore[no-untyped-def]
    rows, cols = counts.shape[1], counts.shape[2]
    for row in range(rows):
        for first in range(0, cols, TILE):
            width = min(TILE, cols - first)
            y = np.empty((width, share.size))
            load_row(counts, slices, group, row, first, offset, scale, saturation, y, bad[row, first : first + width])
            for c in range(width):
                best, low, k = -np.inf, np.inf, -1
                for g in range(signal):
                    v = y[c, g] * share[g]
                    if v > best:
                        best, k = v, g
                    if v < low:
                        low = v
                    if v != v:
                        k = -1
                        break
                index[row, first + c] = k
                if k >= 0:
                    at = values[:, row, first + c]
                    at[0] = y[c, k - 1] * share[k - 1] if k > 0 else np.nan
                    at[1] = best
                    at[2] = y[c, k + 1] * share[k + 1] if k + 1 < signal else np.nan
                    at[3] = low


def brightest(stack: Stack) -> Maximum:
    """The brightest group of every pixel. Values are photoelectrons per slice of nominal exposure."""
    rig = stack.instrument
    shape = stack.counts.shape[1:]
    index = np.full(shape, -1, dtype=np.int64)
    values = np.full((4, *shape), np.nan)
    bad = np.zeros(shape, dtype=np.int64)
    if stack.signal:
        arguments: tuple[Any, ...] = (stack.slices, stack.group, stack.frames / stack.exposure, stack.signal)
        levels = (rig.offset_dn, 1 / rig.dn_per_pe, rig.saturation_dn)
        _scan(stack.counts, *arguments, *levels, index, values, bad)
    ok = index >= 0
    return Maximum(np.maximum(index, 0), values[0], values[1], values[2], values[3], bad, ok)
