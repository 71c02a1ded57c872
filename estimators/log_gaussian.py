"""Log-Gaussian: the parabola through the logarithms of three samples."""

from __future__ import annotations

import numpy as np
import xarray as xr

from .maximum import brightest
from .profiles import Background, background_e
from .registry import estimator
from .result import range_result
from .stack import read_stack

__all__ = ["log_gaussian"]


@estimator(
    "gated",
    cites="Fisher and Naidu, in Image Technology (Springer), 1996 (recalled; Gaussian peak from three logarithms)",
)
def log_gaussian(capture: xr.Dataset, *, background: Background = "outside") -> xr.Dataset:
    """Vertex of the parabola through ln(y − B) of the brightest slice and its neighbours, plus the argument of max R.

    Exact for a Gaussian response without noise: t₀ + ½(a²U − b²D)/(−aU − bD), U = ln y₊/y₀ at t₀+b, D = ln y₋/y₀ at t₀−a
    (for even steps ½·step·(ln y₋ − ln y₊)/(ln y₋ − 2 ln y₀ + ln y₊)). (The source is cited from memory.)
    Other arguments: background: "outside" subtracts the mean of the slices beyond R's reach, "none" nothing: a level
    left in flattens the logarithm's curvature.
    Returns range, sigma [m], valid (row, col). sigma propagates the three samples' noise through the curvature of ln R,
    capped by the cell's (a+b)²/12, plus the wander of the brightest slice as in `parabola`. Invalid: maximum at an end,
    a sample not above the background, clipped or NaN samples, no curvature.
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
        net = [np.where(y > level, y - level, np.nan) for y in (found.before, found.at, found.after)]
        down, up = np.log(net[0] / net[1]), np.log(net[2] / net[1])
        bottom = -a * up - b * down
        x = 0.5 * (a**2 * up - b**2 * down) / bottom
        # The curvature of ln R itself: the samples' own is so noisy that sigma would follow the noise.
        response = rig.responses[int(stack.gate[0])]
        near = [
            np.log(np.maximum(response(np.asarray(response.peak_s - s))[0] / response.peak, 1e-12)) for s in (-a, b)
        ]
        curve = np.maximum(-a * near[1] - b * near[0], 1e-300)
        d_up, d_down = (0.5 * a**2 + a * x) / curve, (-0.5 * b**2 + b * x) / curve
        total = np.zeros(shape)
        levels = (found.before, found.at, found.after)
        for slope, y, own, g in zip((d_down, -d_up - d_down, d_up), levels, net, (k - 1, k, k + 1), strict=True):
            total += (slope / own) ** 2 * (rig.excess * np.maximum(y, 0) + rig.floor_var) / stack.count[g]
        noise = np.sqrt(2 * (rig.excess * np.maximum(found.at, 0) + rig.floor_var) / stack.count[k])
        wander = response.half_width(noise / np.maximum(net[1], 1e-12))
        moved = np.maximum(wander**2 - ((a + b) / 4) ** 2, 0) / 20
        sigma = np.sqrt(1 / (1 / total + 12 / (a + b) ** 2) + moved)
        same_gate = (stack.gate[k - 1] == stack.gate[k]) & (stack.gate[k + 1] == stack.gate[k])
        valid = found.ok & (found.index == k) & (found.bad == 0) & (bottom > 0) & same_gate & (a > 0) & (b > 0)
    tau = t[k] + x + np.array([r.peak_s for r in rig.responses])[stack.gate[k]]
    return range_result(*rig.to_range(tau, sigma), valid)
