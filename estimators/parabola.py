"""Parabola: three points around the brightest slice."""

from __future__ import annotations

import numpy as np
import xarray as xr

from .maximum import brightest
from .registry import estimator
from .result import range_result
from .stack import read_stack

__all__ = ["parabola"]


@estimator("gated", cites="Risholm et al., Appl. Opt. 57(14):3927, 2018 (parabola through the brightest slices)")
def parabola(capture: xr.Dataset) -> xr.Dataset:
    """Vertex of the parabola through the brightest slice and its two neighbours, plus the argument of max R.

    With y₋, y₀, y₊ at delays t₀−a, t₀, t₀+b: vertex t₀ + ½ (a²(y₊−y₀) − b²(y₋−y₀)) / (−a(y₊−y₀) − b(y₋−y₀)), which is
    ½·step·(y₋−y₊)/(y₋−2y₀+y₊) for even steps. Returns range, sigma [m], valid (row, col).
    sigma propagates the three samples' noise with the curvature of R, capped by the cell's (a+b)²/12, plus the wander
    of the brightest slice as in `peak` where noise makes the top flat; not the bias of a parabola through a curved
    top. Invalid: maximum at an end of the stack, clipped or NaN samples, no curvature.
    """
    stack = read_stack(capture)
    found = brightest(stack)
    rig = stack.instrument
    shape = stack.counts.shape[1:]
    if stack.signal < 3:
        nothing = np.full(shape, np.nan)
        return range_result(nothing, nothing, np.zeros(shape, dtype=bool))
    t = stack.delay_s
    k = np.clip(found.index, 1, stack.signal - 2)
    a, b = t[k] - t[k - 1], t[k + 1] - t[k]
    with np.errstate(divide="ignore", invalid="ignore"):
        up, down = found.after - found.at, found.before - found.at
        top = a**2 * up - b**2 * down
        bottom = -a * up - b * down
        x = 0.5 * top / bottom
        # x(y₋, y₀, y₊): the gradient, then independent noise of the three samples. The curvature is that of R at the
        # pixel's amplitude: the sample's own is so noisy that sigma would follow the noise instead of telling it.
        response = rig.responses[int(stack.gate[0])]
        near = [response(np.asarray(response.peak_s + shift))[0] for shift in (-a, b)]
        curve = (found.at - found.low) * (a * (1 - near[1] / response.peak) + b * (1 - near[0] / response.peak))
        d_up = 0.5 * (a**2 + 2 * a * np.abs(x)) / curve
        d_down = -0.5 * (b**2 + 2 * b * np.abs(x)) / curve
        total = np.zeros(shape)
        for slope, level, g in (
            (d_down, found.before, k - 1),
            (-d_up - d_down, found.at, k),
            (d_up, found.after, k + 1),
        ):
            variance = (rig.excess * np.maximum(level, 0) + rig.floor_var) / stack.count[g]
            total += slope**2 * variance
        # Near a flat top the vertex cannot leave its own cell, but the cell moves as in `peak`.
        noise = np.sqrt(2 * (rig.excess * np.maximum(found.at, 0) + rig.floor_var) / stack.count[k])
        wander = response.half_width(noise / np.maximum(found.at - found.low, 1e-12))
        moved = np.maximum(wander**2 - ((a + b) / 4) ** 2, 0) / 20
        sigma = np.sqrt(1 / (1 / total + 12 / (a + b) ** 2) + moved)
        same_gate = (stack.gate[k - 1] == stack.gate[k]) & (stack.gate[k + 1] == stack.gate[k])
        valid = found.ok & (found.index == k) & (found.bad == 0) & (bottom > 0) & same_gate & (a > 0) & (b > 0)
    tau = t[k] + x + np.array([r.peak_s for r in rig.responses])[stack.gate[k]]
    return range_result(*rig.to_range(tau, sigma), valid)
