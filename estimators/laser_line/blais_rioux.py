"""Blais and Rioux' detector: the zero crossing of a linear derivative filter along the row."""

from __future__ import annotations

from functools import partial
from typing import Literal

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..registry import estimator
from .frames import OffFrames
from .windows import line_windows, with_locking

__all__ = ["line_blais_rioux"]

Float = npt.NDArray[np.float64]


def _crossing(z: Float, reach: int) -> Float:
    """Zero of g_i = Σ_k (z_{i−k} − z_{i+k}), k = 1 … reach, between the two pixels about the peak; linear between them."""
    half = z.shape[1] // 2
    at = [half - 1, half, half + 1]
    g = [sum(z[:, i - k] - z[:, i + k] for k in range(1, reach + 1)) for i in at]
    with np.errstate(divide="ignore", invalid="ignore"):
        right = np.where((g[1] <= 0) & (g[2] > 0), g[1] / (g[1] - g[2]), np.nan)
        left = np.where((g[0] <= 0) & (g[1] > 0), -1.0 + g[0] / (g[0] - g[1]), np.nan)
    return np.asarray(np.where(np.isfinite(right), right, left))


@estimator(
    "line", cites="F. Blais and M. Rioux, Signal Processing 11:145, 1986 (numerical peak detector, 4th and 8th order)"
)
def line_blais_rioux(
    capture: xr.Dataset, *, order: Literal[2, 4, 8] = 4, returns: int = 1, off_frames: OffFrames = "unused",
    least_sigmas: float = 5.0,
) -> xr.Dataset:  # fmt: skip
    """c: where the filter g_i = Σ_{k=1}^{order/2} (z_{i−k} − z_{i+k}) passes through zero beside the brightest pixel.

    Returns column, sigma [px], valid (frame, row, return). sigma: noise and pixel locking. Invalid where the peak is not
    `least_sigmas` above the row's noise, where there is no crossing, or where the window holds a bad pixel.
    """
    windows = line_windows(
        capture, least_sigmas=least_sigmas, least_half=order // 2 + 1, returns=returns, off_frames=off_frames
    )  # fmt: skip
    return with_locking(windows, partial(_crossing, reach=order // 2), reach=order // 2 + 1, follows_peak="free")
