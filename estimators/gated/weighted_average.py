"""Weighted average: the centroid of the counts over delay."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..registry import estimator
from ..result import masked_result, range_result
from .tools.background import from_off_slices, from_outside
from .tools.moments import average_even, average_general, even_order
from .tools.stack import Stack, read_stack

__all__ = ["weighted_average"]

_Background = Literal["none", "off-slices", "min", "outside"]


def _level(stack: Stack, background: _Background) -> tuple[npt.NDArray[np.float64], float]:
    """(level to subtract [DN], per pixel or one number for all; share of its variance in that of the answer)."""
    if background == "off-slices":
        mean, number = from_off_slices(stack)
        return mean.reshape(-1), 1 / number
    if background == "outside":
        mean, numbers = from_outside(stack)
        # These slices are in the sum as well: with Σ_out (x−t̄) = Σ (x−t̄) the covariance is twice the variance, and
        # subtracting their mean takes noise away.
        return mean.reshape(-1), -1 / max(1.0, float(np.median(numbers)))
    # The least count is found by the pass over the counts.
    return np.array([stack.instrument.offset_dn]), 1.0 if background == "min" else 0.0


@estimator("gated", cites="Busck and Heiselberg, Appl. Opt. 43(24):4705, 2004; Andersson, Opt. Eng. 45(3):034301, 2006")
def weighted_average(capture: xr.Dataset, *, background: _Background = "none") -> xr.Dataset:
    """τ = Σ_k (t_k + ū)·y_k / Σ_k y_k, y = counts − offset − background, ū = ∫u·R du/∫R du of the declared samples.

    Slice k sees R(τ − t_k), so that the plain average over the slices is τ − ū; with ū added it is unbiased where the delays
    cover R, are dense against its width, and no background is left. Uneven delays weigh y_k by half the distance of their
    neighbours, so that the sums stay integrals over delay.
    Other arguments: background: "none" subtracts the declared offset of the detector only, so that a level B per slice
    pulls the answer to the centre of the window by (t̄−τ)·KB/(S+KB); "off-slices" subtracts the mean of the laser-off
    slices, "min" the least count of the pixel (which noise makes too low), "outside" the mean of the slices that lie
    farther from the brightest than R reaches.
    Returns range, sigma [m] and valid (row, col). sigma propagates the counts' noise (excess noise factor included),
    not the bias above. Invalid: light below 3 standard deviations, a clipped sample, NaN. Raises InputError for
    "off-slices" without such slices.
    """
    stack = read_stack(capture)
    rig = stack.instrument
    shape = stack.counts.shape[1:]
    # One allocation for all three: new memory pages cost as much as the average itself.
    pixels = shape[0] * shape[1]
    memory = np.empty(13 * pixels, dtype=np.uint8)
    value = memory[: 8 * pixels].view(np.float64)
    sigma = memory[8 * pixels : 12 * pixels].view(np.float32)
    valid = memory[12 * pixels :].view(np.bool_)
    used = stack.group < stack.signal
    if not used.any():
        nothing = np.full(shape, np.nan)
        return range_result(nothing, nothing, np.zeros(shape, dtype=bool))
    level, share = _level(stack, background)
    direct = rig.gate_offset() is None and not rig.laser_m.any()
    factor = rig.m_per_s if direct else 1.0
    group, centroid = stack.group[used], stack.centroid_delay_s
    span = even_order(stack)
    origin = float(centroid.min())
    unit = float((centroid[-1] - centroid[0]) / (centroid.size - 1)) if span is not None else stack.spacing_s()
    x = np.arange(stack.signal, dtype=np.float64) if span is not None else (centroid - origin) / unit
    wide = stack.widths()
    sums = (float(wide.sum()), float((wide * x).sum()), float((wide * x * x).sum()))
    noise = (rig.offset_dn, 1 / rig.dn_per_pe, rig.excess, rig.floor_var, share, rig.saturation_dn)
    # A value that is the mean of some frames has a variance smaller by their number.
    scale = (factor * origin, factor * unit, float(x.max()), 1 / float(np.sqrt(stack.frames)))
    target = (value, sigma, valid)
    if span is not None:
        flat = stack.counts.reshape(stack.counts.shape[0], -1)
        average_even(flat, *span, level, background == "min", sums, noise, scale, *target)
    else:
        x, weight = x[group], wide[group] * (stack.frames / stack.exposure[group])
        square = weight**2
        floors = (float(square.sum()), float((square * x).sum()), float((square * x * x).sum()))
        plan = (x, weight, (stack.count / stack.exposure)[group])
        average_general(
            stack.counts, stack.slices[used], plan, level, background == "min", sums, floors, noise, scale, *target
        )
    value, sigma, valid = value.reshape(shape), sigma.reshape(shape), valid.reshape(shape)
    if direct:
        return masked_result(value, sigma, valid)
    return range_result(*rig.to_range(value, sigma.astype(np.float64)), valid)
