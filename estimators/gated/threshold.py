"""Threshold: the leading edge's crossing of a fixed level, as a counter with a comparator reads it."""

from __future__ import annotations

import numpy as np
import xarray as xr

from ...scenes.errors import InputError
from ..registry import estimator
from ..result import range_result
from .tools.edges import edge
from .tools.profiles import Background, background_e, blocks, crossing, variance
from .tools.stack import read_stack

__all__ = ["threshold"]


@estimator(
    "gated", cites="Palojarvi, Ruotsalainen and Kostamovaara, IEEE J. Solid-State Circuits 40(5):1213, 2005 (recalled)"
)
def threshold(capture: xr.Dataset, *, level_e: float = 30.0, background: Background = "outside") -> xr.Dataset:
    """τ = t× + u½: t× the delay at which the profile y − B first rises through `level_e`, u½ where R is half its peak.

    The profile over delay rises where a slice begins to see the echo (u = τ − t falling from R's far end). A bright echo
    crosses a fixed level early: the walk, which this estimator has by nature, is zero only where the level is half the
    echo's height. (The source, on walk in leading-edge detection, is cited from memory.)
    Other arguments: level_e [photoelectrons per slice]; background: "outside" subtracts the mean of the slices beyond
    R's reach from the brightest, "none" nothing.
    Returns range, sigma [m], valid (row, col). sigma is the interpolated sample's noise over the slope, not the walk.
    Invalid: no crossing inside the stack, clipped or NaN samples. Raises InputError for level_e <= 0.
    """
    if not level_e > 0:
        raise InputError("the level must be positive", where="threshold", value=level_e, allowed="> 0")
    stack = read_stack(capture)
    shape = stack.counts.shape[1:]
    tau, sigma, valid = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, dtype=bool)
    if stack.signal < 2 or np.unique(stack.gate[: stack.signal]).size > 1:
        return range_result(tau, sigma, valid)
    back = background_e(stack, background)
    for rows, y, bad in blocks(stack):
        v = variance(stack, y)
        net = y - back[rows]
        high = net >= level_e
        # The first sample at or above the level that comes after one below it.
        rise = np.zeros_like(high)
        rise[1:] = high[1:] & ~high[:-1]
        cross, slope, noise = edge(stack, net, np.full(bad.shape, level_e), rise.argmax(axis=0), -1, v)
        with np.errstate(divide="ignore", invalid="ignore"):
            tau[rows], sigma[rows] = cross + crossing(stack, 0.5, "leading"), np.sqrt(noise) / slope
        valid[rows] = rise.any(axis=0) & ~bad
    return range_result(*stack.instrument.to_range(tau, sigma), valid)
