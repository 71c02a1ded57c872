"""Peak: the delay of the brightest slice."""

from __future__ import annotations

from typing import Literal

import numpy as np
import xarray as xr

from ..registry import estimator
from ..result import range_result
from .tools.maximum import brightest
from .tools.stack import read_stack

__all__ = ["peak"]


@estimator("gated", cites="Busck and Heiselberg, Appl. Opt. 43(24):4705, 2004 (time-slicing; the brightest slice)")
def peak(capture: xr.Dataset, *, saturated: Literal["refuse", "use"] = "refuse") -> xr.Dataset:
    """Range of the brightest slice: τ = t_k* + u*, k* = argmax of the counts (first of equal ones), u* = argmax of R.

    Main arguments: a gated capture, counts (slice, row, col).
    Other arguments: saturated: "refuse" makes pixels with a clipped sample invalid, "use" reads them.
    Returns range, sigma [m] and valid (row, col). sigma² = step²/12 + w²/5, w: half the width over which R stays within √2
    standard deviations of the noise of the brightest sample. Invalid: all slices equal, no light, NaN.
    """
    stack = read_stack(capture)
    found = brightest(stack)
    rig = stack.instrument
    response = rig.responses[0]
    peak_u = np.array([r.peak_s for r in rig.responses])
    if stack.signal == 0:
        nothing = np.full(stack.counts.shape[1:], np.nan)
        return range_result(nothing, nothing, np.zeros(nothing.shape, dtype=bool))
    tau = stack.delay_s[found.index] + peak_u[stack.gate[found.index]]
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = (stack.reads * rig.floor_var)[found.index]
        noise = np.sqrt(2 * (rig.excess * np.maximum(found.at, 0) + floor) / stack.exposure[found.index])
        drop = noise / np.maximum(found.at - found.low, 1e-12)
    sigma = np.sqrt(stack.spacing_s() ** 2 / 12 + response.half_width(drop) ** 2 / 5)
    valid = found.ok & (found.at > found.low) & ((found.bad == 0) | (saturated == "use"))
    return range_result(*rig.to_range(tau, sigma), valid)
