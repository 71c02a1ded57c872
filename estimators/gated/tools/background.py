"""Background level of every pixel, from laser-off slices or from slices that the echo cannot reach."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ....optics.jit import kernel
from ....scenes.errors import InputError
from .maximum import TILE
from .stack import Stack, load_row

__all__ = ["from_off_slices", "from_outside"]

Float = npt.NDArray[np.float64]


def from_off_slices(stack: Stack, where: str = "weighted-average") -> tuple[Float, float]:
    """Mean count [DN] (row, col) of the laser-off slices per nominal exposure, and the number of such exposures.

    where: name of the estimator, for the message. Raises InputError where there is no such slice.
    """
    off = stack.slices[stack.group >= stack.signal]
    if off.size == 0:
        raise InputError(
            "The capture has no laser-off slice.",
            where=f"{where}[background=off-slices]",
            allowed="none, outside",
            next_step="generate with rig.delays.laser_off > 0",
        )
    total = np.zeros(stack.counts.shape[1:])
    for k in off:
        total += stack.counts[k]
    exposures = float(stack.exposure[stack.signal]) / stack.frames
    offset = stack.instrument.offset_dn
    return offset + (total - off.size * offset) / exposures, exposures


@kernel(error_model="numpy")
def _outside(counts, slices, group, share, centroid, signal, reach, offset, background, number):  # type: ignore[no-untyped-def]
    rows, cols = counts.shape[1], counts.shape[2]
    bad = np.zeros(TILE, np.int64)
    for row in range(rows):
        for first in range(0, cols, TILE):
            width = min(TILE, cols - first)
            y = np.empty((width, group.max() + 1))
            load_row(counts, slices, group, row, first, offset, 1.0, np.inf, y, bad[:width])
            for c in range(width):
                k = 0
                for g in range(signal):
                    y[c, g] *= share[g]
                    if y[c, g] > y[c, k]:
                        k = g
                total, n = 0.0, 0
                for g in range(signal):
                    if abs(centroid[g] - centroid[k]) > reach:
                        total += y[c, g]
                        n += 1
                background[row, first + c] = offset + total / n if n > 0 else np.nan
                number[row, first + c] = n


def from_outside(stack: Stack) -> tuple[Float, Float]:
    """Mean count [DN] (row, col) per nominal exposure of the slices that lie farther from the brightest than R reaches
    (1e-3 of its peak), and the number of such exposures. NaN where there is no such slice."""
    shape = stack.counts.shape[1:]
    background, number = np.full(shape, np.nan), np.zeros(shape)
    if stack.signal:
        # Beyond, R is under a thousandth of its peak; a limit of 1e-7 would leave no slice in a window of usual length.
        reach = max(0.5 * r.step_s * float((r.value >= 1e-3 * r.peak).sum()) for r in stack.instrument.responses)
        _outside(stack.counts, stack.slices, stack.group, stack.frames / stack.exposure, stack.centroid_delay_s,
                 stack.signal, reach, stack.instrument.offset_dn, background, number)  # fmt: skip
    repeats = float(stack.exposure[: stack.signal].mean()) / stack.frames if stack.signal else 1.0
    return background, number * repeats
