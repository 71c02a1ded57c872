"""The line finder of Kusters 1992, sec. 3.1: zero crossings of the derivative across the line, where the second is negative.

The derivatives are central differences of the frame, smoothed first where that is asked for. Beside the brightest pixel of a row
the first derivative across the line (`optics.crest`, Eq. 3.19) falls through zero between two pixels; the line lies where the
straight line between its values does. Both values are taken in the direction of the pixel that is more of a crest: one that lies
beyond the line's inflection has its most negative second derivative along the line. Directions come from 3 × 3 pixels, so that
rows beside each other share noise.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.ndimage import correlate1d

from ...optics.crest import across_eq3_15, directional_eq3_17, least_second_eq3_9
from ...optics.sheet import gaussian_mean
from ..registry import estimator
from .frames import OffFrames
from .images import above_background, spoilt_pixels
from .prefilter import kernel
from .windows import Windows, answered, line_windows

__all__ = ["line_derivative"]

Float = npt.NDArray[np.float64]

#: Pixels left of the crossing, from the brightest one.
_STEPS = (-2, -1, 0, 1)
#: A crossing this far from the brightest pixel belongs to another line.
_FARTHEST_PX = 1.5
#: Half of the frame in which pixel locking is computed; phases of the pixel.
_MIDDLE, _PHASES = 24, 64

_SMOOTH, _SLOPE, _BEND = (0.0, 1.0, 0.0), (-0.5, 0.0, 0.5), (1.0, -2.0, 1.0)


@estimator("line", cites="Kusters 1992, Eq. 3.1-3.19: second-directional-derivative line finder", joint=True)
def line_derivative(
    capture: xr.Dataset, *, prefilter_px: float = 0.0, returns: int = 1, off_frames: OffFrames = "unused",
    least_sigmas: float = 5.0,
) -> xr.Dataset:  # fmt: skip
    """c: where s·∇I of Eq. 3.19 falls through zero beside the brightest pixel, linear between two pixels.

    `prefilter_px`: the frame is smoothed first by a Gaussian of this standard deviation, along and across rows; 0 for none.
    Returns column, sigma [px], valid (frame, row, return). sigma: noise of the first derivative, and pixel locking. Invalid where
    the peak is not `least_sigmas` above the row's noise, where a pixel within the filters' reach is bad or outside of the
    image, or where no crossing with a negative second derivative lies within 1.5 px of the brightest pixel.
    """
    windows = line_windows(capture, least_half=4, least_sigmas=least_sigmas, returns=returns, off_frames=off_frames)
    weight = kernel(prefilter_px)
    image, bad = above_background(windows, capture)
    _, rows, cols = image.shape
    reach = weight.size // 2 + 1
    row, frame = windows.row, windows.frame
    peak = np.clip(windows.peak, 3, cols - 4)
    at = (frame[:, None], row[:, None], peak[:, None] + np.arange(-2, 3))
    derivative = {key: _derivative(image, weight, *order)[at] for key, order in _ORDERS.items()}
    place, fall, step, across = _crossing(derivative)
    ok = ~spoilt_pixels(bad, reach + 2)[frame, row, windows.peak] & (np.abs(place) <= _FARTHEST_PX)
    ok &= (row >= reach) & (row < rows - reach)
    with np.errstate(divide="ignore", invalid="ignore"):
        noise = np.sqrt(_slope_variance(windows, weight, place - step, step, across)) / np.abs(fall)
    line = float(np.median(windows.width()))
    return answered(windows, place, np.hypot(noise, _locking(round(line, 3), prefilter_px)), ok)


#: Filters along (row direction y, column direction x) of the derivatives.
_ORDERS = {
    "x": (_SMOOTH, _SLOPE), "y": (_SLOPE, _SMOOTH), "xx": (_SMOOTH, _BEND), "xy": (_SLOPE, _SLOPE), "yy": (_BEND, _SMOOTH),
}  # fmt: skip


def _derivative(image: Float, weight: Float, down: tuple[float, ...], right: tuple[float, ...]) -> Float:
    """Smoothed by `weight` (2r + 1) and differenced, (frame, row, col)."""
    once = correlate1d(image, np.convolve(weight, down), axis=1, mode="nearest")
    return np.asarray(correlate1d(once, np.convolve(weight, right), axis=2, mode="nearest"))


def _crossing(d: dict[str, Float]) -> tuple[Float, Float, Float, Float]:
    """(place [px] from the brightest pixel, NaN where there is none; slope there; pixel left of it; direction (2, n)).

    d: derivatives (n, 5) at the brightest pixel and the two to either side.
    """
    across = across_eq3_15(d["xx"], d["xy"], d["yy"])
    second = least_second_eq3_9(d["xx"], d["xy"], d["yy"])
    n = second.shape[0]
    place, fall, left, direction = np.full(n, np.nan), np.full(n, np.nan), np.zeros(n), np.zeros((2, n))
    for step in _STEPS:
        k = step + 2
        crest = np.where(second[:, k] <= second[:, k + 1], k, k + 1)
        s = np.take_along_axis(across, crest[None, :, None], axis=2)[:, :, 0]
        a, b = (directional_eq3_17(d["x"][:, i], d["y"][:, i], s) for i in (k, k + 1))
        with np.errstate(divide="ignore", invalid="ignore"):
            there = (a > 0) & (b <= 0) & (np.minimum(second[:, k], second[:, k + 1]) < 0)
            here = np.where(there, step + a / (a - b), np.nan)
            better = np.isfinite(here) & ~(np.abs(place) <= np.abs(here))
        place, fall, left = np.where(better, here, place), np.where(better, b - a, fall), np.where(better, step, left)
        direction = np.where(better, s, direction)
    return place, fall, left, direction


def _slope_variance(windows: Windows, weight: Float, share: Float, left: Float, across: Float) -> Float:
    """Variance (n) of s·∇I at the crossing: Σ V w², w the filter at the two pixels beside it, weighted as between them; V is that
    of the window's pixels, alike in the rows beside."""
    total = np.zeros(share.shape)
    for order, part in zip(("x", "y"), across, strict=True):
        down, right = (np.convolve(weight, filt) for filt in _ORDERS[order])
        total += (
            part**2 * (down**2).sum() * (windows.variance * _shifted(right, share, left, windows.half) ** 2).sum(axis=1)
        )
    return total


def _shifted(weight: Float, share: Float, left: Float, half: int) -> Float:
    """The filter about a place between two pixels (n, 2 half + 1): (1 − share) of that at `left`, share of that at left + 1."""
    wide = np.zeros(2 * half + 1 + 2 * weight.size)
    middle = half + weight.size
    wide[middle - weight.size // 2 : middle + weight.size // 2 + 1] = weight
    k = np.arange(2 * half + 1) + weight.size
    held = np.nan_to_num(share)[:, None]
    one, two = (wide[np.clip(k - (left[:, None] + more).astype(np.int64), 0, wide.size - 1)] for more in (0, 1))
    return np.asarray((1.0 - held) * one + held * two)


@lru_cache(maxsize=32)
def _locking(line: float, prefilter_px: float) -> float:
    """rms [px] of the error without noise over the phases of a pixel, of an upright line of σ = `line`."""
    x = np.arange(-_MIDDLE, _MIDDLE + 1.0)
    phase = (np.arange(_PHASES) + 0.5) / _PHASES - 0.5
    image = gaussian_mean(x - 0.5 - phase[:, None], x + 0.5 - phase[:, None], line)
    weight = kernel(prefilter_px)
    right = {key: correlate1d(image, np.convolve(weight, order[1]), axis=1) for key, order in _ORDERS.items()}
    none = np.zeros((_PHASES, 5))
    d = {key: right[key][:, _MIDDLE - 2 : _MIDDLE + 3] if key in ("x", "xx") else none for key in _ORDERS}
    error = _crossing(d)[0] - phase
    return float(np.sqrt(np.nanmean(error**2))) if np.isfinite(error).any() else 0.5
