"""Profiles of the pixels of a stack over delay, in photoelectrons, block by block: for estimators written in numpy."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
import numpy.typing as npt

from .background import from_outside
from .stack import Stack

__all__ = ["Background", "background_e", "blocks", "crossing", "variance"]

Float = npt.NDArray[np.float64]
Background = Literal["none", "outside"]
#: Numbers per block: a few rows at a time, so that memory does not hold a large stack twice.
NUMBERS = 2_000_000


def blocks(stack: Stack) -> Iterator[tuple[slice, Float, npt.NDArray[np.bool_]]]:
    """(rows, y, bad) for one block of rows after another: y (signal group, row, col) in photoelectrons per slice of nominal
    exposure, bad (row, col) where a sample is clipped or not finite (such samples are 0 in y)."""
    rig = stack.instrument
    rows, cols = stack.counts.shape[1:]
    step = max(1, NUMBERS // max(1, cols * stack.signal))
    used = stack.group < stack.signal
    scale = stack.frames / stack.exposure / rig.dn_per_pe
    for first in range(0, rows, step):
        cut = slice(first, min(first + step, rows))
        y = np.zeros((stack.signal, cut.stop - first, cols))
        bad = np.zeros(y.shape[1:], dtype=bool)
        for k, g in zip(stack.slices[used], stack.group[used], strict=True):
            sample = stack.counts[k, cut].astype(np.float64)
            fine = sample < rig.saturation_dn
            fine &= np.isfinite(sample)
            bad |= ~fine
            y[g] += np.where(fine, sample - rig.offset_dn, 0.0) * scale[g]
        yield cut, y, bad


def variance(stack: Stack, y: Float) -> Float:
    """Variance [photoelectrons²] of samples y (signal group, …): (F² max(y, 0) + reads·σ_r²)/exposure of each group."""
    exposure, reads = (a[: stack.signal].reshape(-1, *([1] * (y.ndim - 1))) for a in (stack.exposure, stack.reads))
    rig = stack.instrument
    return np.asarray((rig.excess * np.maximum(y, 0) + reads * rig.floor_var) / exposure)


def background_e(stack: Stack, how: Background) -> Float:
    """Background [photoelectrons per slice] (row, col): 0 for "none"; for "outside" the mean of the slices that lie farther
    from the brightest than R reaches (0 where there is no such slice)."""
    if how == "none":
        return np.zeros(stack.counts.shape[1:])
    level, _number = from_outside(stack)
    light = (level - stack.instrument.offset_dn) / stack.instrument.dn_per_pe
    # The level is infinite where a sample is: such a pixel is bad, and must not overflow here.
    return np.asarray(np.nan_to_num(light, nan=0.0, posinf=0.0, neginf=0.0))


def crossing(stack: Stack, fraction: float, side: Literal["leading", "trailing"]) -> float:
    """The argument u [s] at which R falls to `fraction` of its peak.

    side: of the profile over delay: its "leading" edge shows R at arguments above that of the peak, since slice k sees
    R(τ − t_k); its "trailing" edge shows R below.
    """
    response = stack.instrument.responses[int(stack.gate[0])]
    above = np.flatnonzero(response.value >= fraction * response.peak)
    i = int(above[-1] if side == "leading" else above[0])
    j = i + 1 if side == "leading" else i - 1
    high, low = response.value[i], response.value[j]
    part = (high - fraction * response.peak) / (high - low)
    return float(response.start_s + response.step_s * (i + (j - i) * part))
