"""Threshold: the crossing of a fixed level by the leading edge, as a comparator sees it."""

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
    "gated",
    cites="Palojarvi, Ruotsalainen and Kostamovaara, IEEE J. Solid-State Circuits 40(5):1213, 2005 (not verified)",
)
def threshold(capture: xr.Dataset, *, level_e: float = 30.0, background: Background = "outside") -> xr.Dataset:
    """τ = t× + u½: t× the delay at which the profile y − B first rises through `level_e`, u½ where R is half its peak.

    The profile over delay rises where a slice begins to see the echo (u = τ − t falls from the far end of R). A bright echo
    crosses a fixed level early: this walk is zero only where the level is half the height of the echo. (The source, on
    walk in leading-edge detection, is not verified.)
    Other arguments: level_e [photoelectrons per slice]; background: "outside" subtracts the mean of the slices that lie
    farther from the brightest than R reaches, "none" nothing.
    Returns range, sigma [m], valid (row, col). sigma is the noise of the interpolated sample over the slope, without the
    walk. Invalid: no crossing inside the stack, clipped or NaN samples. Raises InputError for level_e <= 0.
    """
    if not level_e > 0:
        raise InputError("The level must be positive.", where="threshold[level_e]", value=level_e, allowed="> 0")
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
