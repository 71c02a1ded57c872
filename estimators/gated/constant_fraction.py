"""Constant fraction: the crossing of a fraction of the maximum of the pixel."""

from __future__ import annotations

from typing import Literal

import numpy as np
import xarray as xr

from ...scenes.errors import InputError
from ..registry import estimator
from ..result import range_result
from .tools.edges import edge
from .tools.profiles import Background, background_e, blocks, crossing, variance
from .tools.stack import read_stack

__all__ = ["constant_fraction"]


@estimator(
    "gated", cites="Gedcke and McDonald, Nucl. Instrum. Methods 55:377, 1967 (constant fraction of pulse height)"
)
def constant_fraction(
    capture: xr.Dataset, *, fraction: float = 0.5, edges: Literal["leading", "trailing", "both"] = "both",
    background: Background = "outside",
) -> xr.Dataset:  # fmt: skip
    """τ = t_f + u_f: t_f where y − B crosses `fraction` of its maximum, u_f where R does; "both" takes their mean.

    The level follows the height of the echo, so that there is no walk as in `threshold`. The height is that of the parabola
    through the three highest samples. The search for the crossing goes outward from the brightest slice.
    Other arguments: fraction in (0, 1); edges: "leading" is the rising edge of the profile over delay; background:
    "outside" subtracts the mean of the slices that lie farther from the brightest than R reaches, "none" nothing.
    Returns range, sigma [m], valid (row, col). sigma propagates the noise of the crossing samples and of the height
    (which cancels between the edges of "both"), not the bias of straight lines through a curved edge. Invalid: no crossing
    inside the stack, clipped or NaN samples, height below 3 standard deviations. Raises InputError.
    """
    if not 0 < fraction < 1:
        raise InputError(
            "The fraction is out of range.", where="constant-fraction[fraction]", value=fraction,
            allowed="0 < fraction < 1",
        )  # fmt: skip
    stack = read_stack(capture)
    shape = stack.counts.shape[1:]
    tau, sigma, valid = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, dtype=bool)
    if stack.signal < 3 or np.unique(stack.gate[: stack.signal]).size > 1:
        return range_result(tau, sigma, valid)
    back = background_e(stack, background)
    sides = {"leading": ("leading",), "trailing": ("trailing",), "both": ("leading", "trailing")}[edges]
    for rows, y, bad in blocks(stack):
        v = variance(stack, y)
        net = y - back[rows]
        best = net.argmax(axis=0)
        k = np.clip(best, 1, stack.signal - 2)
        before, at, after = (np.take_along_axis(net, (k + s)[None], axis=0)[0] for s in (-1, 0, 1))
        with np.errstate(divide="ignore", invalid="ignore"):
            bend = 2 * at - before - after
            height = at + np.where((bend > 0) & (best == k), (after - before) ** 2 / (8 * bend), 0.0)
            top_noise = np.take_along_axis(v, k[None], axis=0)[0]
            total, quiet, lean = np.zeros(bad.shape), np.zeros(bad.shape), np.zeros(bad.shape)
            for side in sides:
                way = -1 if side == "leading" else 1
                cross, slope, noise = edge(stack, net, fraction * height, best, way, v)
                total += (cross + crossing(stack, fraction, "leading" if way < 0 else "trailing")) / len(sides)
                quiet += noise / (slope * len(sides)) ** 2
                lean += -way * fraction / (slope * len(sides))
            tau[rows], sigma[rows] = total, np.sqrt(quiet + lean**2 * top_noise)
            valid[rows] = ~bad & (best == k) & (height > 3 * np.sqrt(top_noise))
    return range_result(*stack.instrument.to_range(tau, sigma), valid)
