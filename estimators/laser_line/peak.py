"""The brightest pixel of the row: the whole-pixel reading of early instruments."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..registry import estimator
from .frames import OffFrames
from .windows import line_windows, with_locking

__all__ = ["line_peak"]

Float = npt.NDArray[np.float64]


def _middle(z: Float) -> Float:
    return np.zeros(z.shape[0])


@estimator("line", cites="Kusters 1992, sec. 3.3.3: the range of the pixel's centre")
def line_peak(
    capture: xr.Dataset, *, returns: int = 1, off_frames: OffFrames = "unused", least_sigmas: float = 5.0
) -> xr.Dataset:
    """c = the column of the brightest pixel. sigma: rms over the phases of a pixel, 1/√12 for a symmetric line, and that of the
    pixels that noise may have made the brightest.

    Returns column, sigma [px], valid (frame, row, return). Invalid where the peak is not `least_sigmas` above the row's noise.
    """
    windows = line_windows(capture, least_sigmas=least_sigmas, returns=returns, off_frames=off_frames)
    return with_locking(windows, _middle, reach=0, follows_peak="held")
