"""Crossings of a level by a profile over delay: shared by `threshold` and `constant-fraction`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .stack import Stack

__all__ = ["edge"]

Float = npt.NDArray[np.float64]


def edge(
    stack: Stack, y: Float, level: Float, start: npt.NDArray[np.int64], side: int, variance: Float
) -> tuple[Float, Float, Float]:
    """(t, slope, noise): delay [s] of the nearest crossing of `level` (row, col) before (side −1) or after (+1) slice
    `start`, by a straight line between two samples; |dy/dt| there; variance of the interpolated sample. NaN where there is
    no crossing.

    y, variance (group, row, col). The search starts at a sample at or above the level and ends at the first one below.
    """
    n = y.shape[0]
    t = stack.delay_s[:n]
    k = np.clip(start, 0, n - 1)
    running = np.take_along_axis(y, k[None], axis=0)[0] >= level
    cross = np.full(level.shape, np.nan)
    slope, noise = cross.copy(), cross.copy()
    while running.any():
        j = k + side
        running &= (j >= 0) & (j < n)
        j = np.clip(j, 0, n - 1)
        here, there = (np.take_along_axis(y, i[None], axis=0)[0] for i in (k, j))
        hit = running & (there < level)
        if hit.any():
            with np.errstate(divide="ignore", invalid="ignore"):
                f = (here - level) / (here - there)
                gap = t[j] - t[k]
                v0, v1 = (np.take_along_axis(variance, i[None], axis=0)[0] for i in (k, j))
                cross = np.where(hit, t[k] + f * gap, cross)
                slope = np.where(hit, np.abs((here - there) / gap), slope)
                noise = np.where(hit, (1 - f) ** 2 * v0 + f**2 * v1, noise)
        running &= ~hit
        k = np.where(running, j, k)
    return cross, slope, noise
