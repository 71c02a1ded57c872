"""Data at which an estimator may divide by zero, run off its window or mistake noise for a signal.

A singularity is a function maker -> change of the clean data (sample, element), or None where it does not apply.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from .maker import Change, Maker

__all__ = ["SINGULARITIES"]

Array = npt.NDArray[Any]

#: A count that is neither dark nor bright, DN.
_CONSTANT = 100


def _filled(value: int) -> Change:
    return lambda data: np.full_like(data, value)


def _one_sample(top: int) -> Change:
    """Light in the middle sample only, as much as there can be."""

    def change(data: Array) -> Array:
        changed = np.full_like(data, data.min())
        changed[len(data) // 2] = top
        return changed

    return change


def _clipped(top: int) -> Change:
    """The brightest sample of each element at the top of the converter."""

    def change(data: Array) -> Array:
        data[data.argmax(axis=0), np.arange(data.shape[1])] = top
        return data

    return change


def _with_nan(kind: str) -> Change:
    """One sample of every other element, and all of every fourth, are no numbers."""

    def change(data: Array) -> Array:
        changed = data.astype(kind)
        changed[data.argmax(axis=0)[::2], np.arange(data.shape[1])[::2]] = np.nan
        changed[:, ::4] = np.nan
        return changed

    return change


def _nan(maker: Maker) -> Change | None:
    return _with_nan(maker.float_type) if maker.float_type else None


SINGULARITIES: Mapping[str, Callable[[Maker], Change | None]] = {
    "all zero": lambda maker: _filled(0),
    "saturated": lambda maker: _filled(maker.top),
    "constant": lambda maker: _filled(_CONSTANT),
    "light in one sample": lambda maker: _one_sample(maker.top),
    "one clipped sample": lambda maker: _clipped(maker.top),
    "not a number": _nan,
}
