"""Parabola: three points around the brightest slice."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..registry import estimator
from ..result import range_result
from .tools.maximum import brightest
from .tools.stack import read_stack
from .tools.vertex_error import vertex_sigma

__all__ = ["parabola"]

Float = npt.NDArray[np.float64]


def _vertex(before: Float, at: Float, after: Float, a: Float, b: Float) -> Float:
    up, down = after - at, before - at
    bottom = -a * up - b * down
    return np.asarray(np.where(bottom > 0, 0.5 * (a**2 * up - b**2 * down) / bottom, np.nan))


@estimator("gated", cites="Risholm et al., Appl. Opt. 57(14):3927, 2018 (parabola through the brightest slices)")
def parabola(capture: xr.Dataset) -> xr.Dataset:
    """Vertex of the parabola through the brightest slice and its two neighbours, plus the argument of max R.

    With y₋, y₀, y₊ at delays t₀−a, t₀, t₀+b: vertex t₀ + ½ (a²(y₊−y₀) − b²(y₋−y₀)) / (−a(y₊−y₀) − b(y₋−y₀)), which is
    ½·step·(y₋−y₊)/(y₋−2y₀+y₊) for even steps. Returns range, sigma [m], valid (row, col).
    sigma is the root mean square error at the amplitude, the level and the place in the step of the pixel (`vertex_error`):
    noise of the three samples, choice of the brightest slice, and the bias of a parabola through a top of another form, which
    is the same for all pixels at one place in the step. Invalid: maximum at an end of the stack, clipped or NaN samples, no
    curvature.
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
        x = _vertex(found.before, found.at, found.after, a, b)
        same_gate = (stack.gate[k - 1] == stack.gate[k]) & (stack.gate[k + 1] == stack.gate[k])
        valid = found.ok & (found.index == k) & (found.bad == 0) & same_gate & (a > 0) & (b > 0)
    sigma = vertex_sigma(stack, found, found.low, x, _vertex, "least")
    tau = t[k] + x + np.array([r.peak_s for r in rig.responses])[stack.gate[k]]
    return range_result(*rig.to_range(tau, sigma), valid)
