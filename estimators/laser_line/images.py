"""Whole frames for finders that look along the line too: light above the rows' backgrounds, and what bad pixels spoil."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from .windows import Windows

__all__ = ["above_background", "spoilt_pixels"]

Float = npt.NDArray[np.float64]


def above_background(windows: Windows, capture: xr.Dataset) -> tuple[Float, npt.NDArray[np.bool_]]:
    """Photoelectrons above the rows' backgrounds (frame, row, col), bad pixels at zero; and which pixels are bad."""
    electrons, good = windows.electrons(capture)
    frames, rows, returns = windows.shape
    level = windows.row_level.reshape(frames, rows, returns)[:, :, :1]
    return np.where(good & np.isfinite(level), electrons - level, 0.0), ~good


def spoilt_pixels(bad: npt.NDArray[np.bool_], reach: int) -> npt.NDArray[np.bool_]:
    """Pixels with a bad one within reach, or the image's edge within reach along the row."""
    from scipy.ndimage import maximum_filter

    near = np.asarray(maximum_filter(bad, size=(1, 2 * reach + 1, 2 * reach + 1), mode="nearest"))
    near[:, :, :reach] = True
    near[:, :, near.shape[2] - reach :] = True
    return near
