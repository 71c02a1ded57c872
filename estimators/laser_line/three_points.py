"""Three-point formulas: a curve through the brightest pixel and its neighbours."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..registry import estimator
from .frames import OffFrames
from .three_point_kernel import three_points
from .windows import Windows, answered, line_windows, locked

__all__ = ["line_log_gaussian", "line_parabola", "log_gaussian", "parabola"]

Float = npt.NDArray[np.float64]


def _three(z: Float) -> tuple[Float, Float, Float]:
    half = z.shape[1] // 2
    return z[:, half - 1], z[:, half], z[:, half + 1]


def _vertex(a: Float, b: Float, c: Float) -> Float:
    """½ (a − c)/(a − 2b + c), the vertex of a parabola; NaN where it opens upward."""
    bend = a - 2.0 * b + c
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(bend < 0, 0.5 * (a - c) / bend, np.nan))


def parabola(z: Float) -> Float:
    """The vertex (n) of windows (n, 2h + 1); NaN where the parabola opens upward."""
    return _vertex(*_three(z))


def log_gaussian(z: Float) -> Float:
    """The vertex of the logarithms; NaN where a neighbour is not above the background."""
    three = _three(z)
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b, c = (np.where(v > 0, np.log(np.where(v > 0, v, 1.0)), np.nan) for v in three)
    return _vertex(a, b, c)


def _answer(windows: Windows, *, log: bool) -> xr.Dataset:
    """The result of a three-point formula: compiled, but for rows in which noise may move the brightest pixel."""
    formula = log_gaussian if log else parabola
    position, sigma, known = three_points(
        windows.z, windows.level, windows.floor_e2, windows.excess, *windows.shares(), windows.locking(formula), log=log
    )
    left = windows.sound & ~known
    if left.any():
        position[left], sigma[left] = locked(windows.of(left), formula, reach=1, follows_peak="free")
    return answered(windows, position, sigma)


@estimator("line", cites="R. B. Fisher and D. K. Naidu, Image Technology, Springer 1996, p. 385 (parabolic estimator)")
def line_parabola(
    capture: xr.Dataset, *, returns: int = 1, off_frames: OffFrames = "unused", least_sigmas: float = 5.0
) -> xr.Dataset:
    """c = k + ½ (z₋ − z₊)/(z₋ − 2z₀ + z₊), k the brightest pixel.

    Returns column, sigma [px], valid (frame, row, return). sigma: noise and pixel locking, .091 px rms for a line of σ = .5 px.
    Invalid where the peak is not `least_sigmas` above the row's noise, or where the window holds a bad pixel.
    """
    windows = line_windows(capture, least_sigmas=least_sigmas, returns=returns, off_frames=off_frames)
    return _answer(windows, log=False)


@estimator(
    "line", cites="R. B. Fisher and D. K. Naidu, Image Technology, Springer 1996, p. 385 (Gaussian approximation)"
)
def line_log_gaussian(
    capture: xr.Dataset, *, returns: int = 1, off_frames: OffFrames = "unused", least_sigmas: float = 5.0
) -> xr.Dataset:
    """c = k + ½ (ln z₋ − ln z₊)/(ln z₋ − 2 ln z₀ + ln z₊), k the brightest pixel, z above the row's background.

    Returns column, sigma [px], valid (frame, row, return), as `line_parabola`. Invalid also where a neighbour is not above the
    background.
    """
    windows = line_windows(capture, least_sigmas=least_sigmas, returns=returns, off_frames=off_frames)
    return _answer(windows, log=True)
