"""Log-Gaussian: the parabola through the logarithms of three samples."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..registry import estimator
from ..result import range_result
from .tools.maximum import brightest
from .tools.profiles import Background, background_e
from .tools.stack import read_stack
from .tools.vertex_error import vertex_sigma

__all__ = ["log_gaussian"]

Float = npt.NDArray[np.float64]


def _vertex(before: Float, at: Float, after: Float, a: Float, b: Float) -> Float:
    net = [np.where(y > 0, y, np.nan) for y in (before, at, after)]
    down, up = np.log(net[0] / net[1]), np.log(net[2] / net[1])
    bottom = -a * up - b * down
    return np.asarray(np.where(bottom > 0, 0.5 * (a**2 * up - b**2 * down) / bottom, np.nan))


@estimator(
    "gated",
    cites="R. B. Fisher and D. K. Naidu, Image Technology, Springer 1996, p. 385 (Gaussian approximation)",
)
def log_gaussian(capture: xr.Dataset, *, background: Background = "outside") -> xr.Dataset:
    """Vertex of the parabola through ln(y − B) of the brightest slice and its neighbours, plus the argument of max R.

    Exact for a Gaussian response without noise: t₀ + ½(a²U − b²D)/(−aU − bD), U = ln y₊/y₀ at t₀+b, D = ln y₋/y₀ at t₀−a
    (for even steps ½·step·(ln y₋ − ln y₊)/(ln y₋ − 2 ln y₀ + ln y₊)).
    Other arguments: background: "outside" subtracts the mean of the slices that R does not reach, "none" nothing: a level
    that is left flattens the curvature of the logarithm.
    Returns range, sigma [m], valid (row, col). sigma is the root mean square error at the amplitude, the level and the
    place in the step of the pixel, as in `parabola`. Invalid: maximum at an end, a sample not above the background, clipped
    or NaN samples, no curvature.
    """
    stack = read_stack(capture)
    rig = stack.instrument
    shape = stack.counts.shape[1:]
    if stack.signal < 3:
        nothing = np.full(shape, np.nan)
        return range_result(nothing, nothing, np.zeros(shape, dtype=bool))
    found = brightest(stack)
    level = background_e(stack, background)
    t = stack.delay_s
    k = np.clip(found.index, 1, stack.signal - 2)
    a, b = t[k] - t[k - 1], t[k + 1] - t[k]
    with np.errstate(divide="ignore", invalid="ignore"):
        x = _vertex(found.before - level, found.at - level, found.after - level, a, b)
        same_gate = (stack.gate[k - 1] == stack.gate[k]) & (stack.gate[k + 1] == stack.gate[k])
        valid = found.ok & (found.index == k) & (found.bad == 0) & same_gate & (a > 0) & (b > 0)
    if background == "none":
        sigma = vertex_sigma(stack, found, found.low, x, _vertex, "left")
    else:
        sigma = vertex_sigma(stack, found, level, x, _vertex, "mean")
    tau = t[k] + x + np.array([r.peak_s for r in rig.responses])[stack.gate[k]]
    return range_result(*rig.to_range(tau, sigma), valid)
