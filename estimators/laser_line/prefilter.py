"""Smoothing of the image before the line is found (Kusters 1992, sec. 3.1): less noise, and a wider line."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.ndimage import correlate1d

from .windows import Formula

__all__ = ["REACH", "kernel", "smoothed"]

Float = npt.NDArray[np.float64]

#: Standard deviations over which the filter reaches.
REACH = 4.0


def kernel(sigma_px: float) -> Float:
    """A Gaussian at whole pixels (2r + 1), r = ⌈4σ⌉, of unit sum; a single 1 where `sigma_px` is 0."""
    if sigma_px <= 0:
        return np.ones(1)
    x = np.arange(-np.ceil(REACH * sigma_px), np.ceil(REACH * sigma_px) + 1)
    g = np.exp(-0.5 * (x / sigma_px) ** 2)
    return np.asarray(g / g.sum())


def smoothed(formula: Formula, sigma_px: float) -> Formula:
    """The formula of windows that are smoothed along the row; beyond the window there is no light."""
    weight = kernel(sigma_px)

    def after(z: Float) -> Float:
        return formula(np.asarray(correlate1d(z, weight, axis=1, mode="constant", cval=0.0)))

    return after
