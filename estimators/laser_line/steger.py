"""Steger's detector of curvilinear structures: the ridge of the image smoothed in both directions.

With r the image smoothed by a Gaussian of `scale` px, and n the direction across the line, in which the second derivative is most
negative, the ridge crosses a pixel at t n, t = −(r_x n_x + r_y n_y)/(r_xx n_x² + 2 r_xy n_x n_y + r_yy n_y²). It lies along
(−n_y, n_x), and so meets the middle of its row at x + t/n_x.

Smoothing along the line joins rows: errors fall below what one row allows, and a step of the line is blurred over about `scale`
rows. `line-derivative` (Kusters 1992, Eq. 3.1-3.19) is the same second directional derivative, with other filters.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.ndimage import gaussian_filter1d

from ...optics.sheet import gaussian_mean
from ..registry import estimator
from .frames import OffFrames
from .images import above_background, spoilt_pixels
from .windows import Windows, answered, line_windows

__all__ = ["line_steger"]

Float = npt.NDArray[np.float64]

#: Filters reach over this many scales.
_REACH = 4.0
#: A ridge this far from the pixel in which it was found belongs to another one.
_FARTHEST_PX = 0.75


@estimator("line", cites="C. Steger, IEEE Trans. Pattern Analysis and Machine Intelligence 20:113, 1998", joint=True)
def line_steger(
    capture: xr.Dataset,
    *,
    scale: float = 0.0,
    returns: int = 1,
    off_frames: OffFrames = "unused",
    least_sigmas: float = 5.0,
) -> xr.Dataset:
    """c = x + t/n_x from the derivatives of the image smoothed with `scale` px (0: w/√3 of a bar of half
    width w = 1.5 σ of the declared line, as Steger advises; at least .9 px).

    Returns column, sigma [px], valid (frame, row, return). sigma: noise through both smoothings, and pixel locking: t is one step
    of Newton's method, which misses the ridge by x³/(σ² + scale²). Rows beside each other err alike. Invalid where the peak is
    not `least_sigmas` above the row's noise, where a pixel within the filters' reach is bad or outside of the image, or where
    no ridge lies beside the brightest pixel.
    """
    windows = line_windows(capture, least_sigmas=least_sigmas, returns=returns, off_frames=off_frames)
    line = float(np.median(windows.width()))
    width = max(scale, 0.0) or max(1.5 * line / np.sqrt(3.0), 0.9)
    image, bad = above_background(windows, capture)
    r = {key: _derivative(image, width, *order) for key, order in _ORDERS.items()}
    reach = int(np.ceil(_REACH * width))
    _, rows, cols = image.shape
    spoilt = spoilt_pixels(bad, reach)
    row, frame = windows.row, windows.frame
    column = np.full(row.size, np.nan)
    curve = np.zeros(row.size)
    # The brightest smoothed pixel may be a neighbour of the brightest one. Of several the sharpest ridge counts: beyond the line's
    # inflection the second derivative is most negative along the line, and a crossing there is noise.
    for step in (0, -1, 1):
        at = np.clip(windows.peak + step, 0, cols - 1)
        local = {key: value[frame, row, at] for key, value in r.items()}
        place, bend = _ridge(**local)
        with np.errstate(invalid="ignore"):
            better = (np.abs(place) <= _FARTHEST_PX) & (np.abs(bend) > np.abs(curve))
        column, curve = np.where(better, step + place, column), np.where(better, bend, curve)
    ok = ~spoilt[frame, row, windows.peak] & np.isfinite(column)
    ok &= (row >= reach) & (row < rows - reach)
    with np.errstate(divide="ignore", invalid="ignore"):
        noise = np.sqrt(_slope_variance(windows, width)) / np.abs(curve)
    sigma = np.hypot(noise, _locking(round(line, 3), width))
    return answered(windows, column, sigma, ok)


#: Orders of the derivatives along (row, col).
_ORDERS = {"x": (0, 1), "y": (1, 0), "xx": (0, 2), "xy": (1, 1), "yy": (2, 0)}


def _derivative(image: Float, width: float, down: int, right: int) -> Float:
    once = gaussian_filter1d(image, width, axis=1, order=down, truncate=_REACH, mode="nearest")
    return np.asarray(gaussian_filter1d(once, width, axis=2, order=right, truncate=_REACH, mode="nearest"))


def _ridge(x: Float, y: Float, xx: Float, xy: Float, yy: Float) -> tuple[Float, Float]:
    """(t/n_x [px], second derivative across times n_x: the slope of r_x along the row's ridge); NaN where r is no ridge."""
    # The eigenvector of the most negative eigenvalue: half the angle of (xx − yy, 2 xy), turned by a right angle.
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy) + 0.5 * np.pi
    nx, ny = np.cos(angle), np.sin(angle)
    bend = xx * nx * nx + 2.0 * xy * nx * ny + yy * ny * ny
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.where(bend < 0, -(x * nx + y * ny) / bend / nx, np.nan)
    return np.asarray(place), np.asarray(bend * nx)


@lru_cache(maxsize=32)
def _locking(line: float, width: float) -> float:
    """rms [px] of the error without noise over the phases of a pixel, of an upright line of σ = `line`."""
    x = np.arange(-24.0, 25.0)
    phase = (np.arange(64) + 0.5) / 64 - 0.5
    image = gaussian_mean(x - 0.5 - phase[:, None], x + 0.5 - phase[:, None], line)
    first, second = (gaussian_filter1d(image, width, axis=1, order=order, truncate=_REACH) for order in (1, 2))
    best, error = np.full(phase.size, np.inf), np.full(phase.size, 0.5)
    for step in (0, -1, 1):
        place = -first[:, 24 + step] / second[:, 24 + step]
        nearer = (second[:, 24 + step] < 0) & (np.abs(place) < best)
        best = np.where(nearer, np.abs(place), best)
        error = np.where(nearer, step + place - phase, error)
    return float(np.sqrt((error**2).mean()))


def _slope_variance(windows: Windows, width: float) -> Float:
    """Variance (n) of r_x at the line: Σ V (g'(x) g(y))² over the filter, V of the window's pixels, alike in the rows beside."""
    x = np.arange(-windows.half, windows.half + 1, dtype=np.float64)
    g = np.exp(-0.5 * (x / width) ** 2)
    g /= g.sum()
    slope = x / width**2 * g
    y = np.arange(-np.ceil(_REACH * width), np.ceil(_REACH * width) + 1)
    h = np.exp(-0.5 * (y / width) ** 2)
    h /= h.sum()
    return np.asarray((windows.variance * slope**2).sum(axis=1) * (h**2).sum())
