"""Centres of mass of the line in a row: above a threshold, as the instrument of 1992 reads it, and in a window."""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..registry import estimator
from .frames import OffFrames
from .prefilter import smoothed
from .windows import Formula, line_windows, with_locking

__all__ = ["line_centroid", "line_window_centroid"]

Float = npt.NDArray[np.float64]


def _above(z: Float, threshold: float) -> Float:
    """Σ x z/Σ z over the pixels beside the peak, up to the first one below the threshold on each side."""
    half = z.shape[1] // 2
    kept = z >= threshold * z[:, half : half + 1]
    left = np.logical_and.accumulate(kept[:, half::-1], axis=1)[:, ::-1]
    right = np.logical_and.accumulate(kept[:, half:], axis=1)
    weight = np.where(np.concatenate([left, right[:, 1:]], axis=1), z, 0.0)
    return _mean(weight)


def _within(z: Float, reach: int) -> Float:
    half = z.shape[1] // 2
    return _mean(z[:, half - reach : half + reach + 1])


def _mean(weight: Float) -> Float:
    x = np.arange(weight.shape[1]) - weight.shape[1] // 2
    total = weight.sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(total > 0, (weight * x).sum(axis=1) / total, np.nan))


@estimator("line", cites="Kusters 1992, sec. 3.1: centre of mass of the pixels above a threshold")
def line_centroid(
    capture: xr.Dataset, *, threshold: float = 0.3, prefilter_px: float = 0.0, returns: int = 1,
    off_frames: OffFrames = "unused", least_sigmas: float = 5.0,
) -> xr.Dataset:  # fmt: skip
    """c = Σ x z/Σ z over the pixels z >= `threshold` · peak that join the brightest one, z above the row's background.

    `prefilter_px`: the row is smoothed first by a Gaussian of this standard deviation (sec. 3.1), 0 for none.

    Returns column, sigma [px], valid (frame, row, return). sigma: noise and pixel locking. Invalid where the peak is not
    `least_sigmas` above the row's noise, or where the window holds a bad pixel.
    """
    windows = line_windows(capture, least_sigmas=least_sigmas, returns=returns, off_frames=off_frames)
    formula: Formula = partial(_above, threshold=threshold)
    return with_locking(windows, smoothed(formula, prefilter_px) if prefilter_px > 0 else formula)


@estimator(
    "line",
    cites="R. B. Fisher and D. K. Naidu, Image Technology, Springer 1996, p. 385 (centre of mass, 3 to 7 pixels)",
)
def line_window_centroid(
    capture: xr.Dataset,
    *,
    reach: int = 2,
    returns: int = 1,
    off_frames: OffFrames = "unused",
    least_sigmas: float = 5.0,
) -> xr.Dataset:
    """c = Σ x z/Σ z over the 2·`reach` + 1 pixels around the brightest one, z above the row's background.

    Returns column, sigma [px], valid (frame, row, return), as `line_centroid`.
    """
    windows = line_windows(capture, least_sigmas=least_sigmas, returns=returns, off_frames=off_frames)
    read = int(np.clip(reach, 1, windows.half))
    return with_locking(windows, partial(_within, reach=read), reach=read, follows_peak="held")
