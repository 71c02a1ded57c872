"""Reliefs for the page's 3-D view: estimate and error of a picture on a coarse grid, as bytes that the page's script reads."""

from __future__ import annotations

import base64
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .pictures import Picture

__all__ = ["MISSING", "SIDE", "coarse", "packed", "relief"]

#: Longest side of a relief, samples: 4,096 quadrilaterals turn smoothly without a graphics processor.
SIDE = 64
#: Code of a sample without a value.
MISSING = 65535
_STEPS = 65534


def coarse(values: NDArray[Any], side: int = SIDE) -> NDArray[np.float64]:
    """Medians of blocks, so that the longest side has at most `side` samples; NaN where a block has no value.

    A dimension that is a single row (a profile) keeps up to four times as many samples.
    """
    array = np.asarray(values, np.float64)
    most = side if min(array.shape) > 1 else 4 * side
    step = max(1, math.ceil(max(array.shape) / most))
    if step == 1:
        return array
    steps = tuple(min(step, size) for size in array.shape)
    rows, cols = (math.ceil(size / s) for size, s in zip(array.shape, steps, strict=True))
    padded = np.full((rows * steps[0], cols * steps[1]), np.nan)
    padded[: array.shape[0], : array.shape[1]] = array
    blocks = padded.reshape(rows, steps[0], cols, steps[1]).swapaxes(1, 2).reshape(rows, cols, -1)
    known = np.isfinite(blocks)
    filled = np.where(known, blocks, np.inf)  # unknown values sort last, and the median is of the others
    filled.sort(axis=-1)
    count = known.sum(axis=-1)
    low, high = (np.maximum(index, 0)[..., None] for index in ((count - 1) // 2, count // 2 - (count == 0)))
    middle = (np.take_along_axis(filled, low, -1) / 2 + np.take_along_axis(filled, high, -1) / 2)[..., 0]
    return np.where(count > 0, middle, np.nan)


def packed(values: NDArray[Any], lo: float, hi: float) -> str:
    """Base64 of little-endian uint16: lo..hi in 65,534 steps, values beyond at its ends, `MISSING` without a value."""
    finite = np.isfinite(values)
    scaled = np.clip((np.where(finite, values, lo) - lo) / (hi - lo), 0.0, 1.0)
    codes = np.where(finite, np.rint(scaled * _STEPS), MISSING).astype("<u2")
    return base64.b64encode(codes.tobytes()).decode("ascii")


def relief(picture: Picture, lo: float, hi: float, limit: float, side: int = SIDE) -> dict[str, str]:
    """Estimate and error of a picture, packed: the estimate from lo to hi, the error from −limit to limit, in its unit."""
    value, error = (np.where(picture.valid, a, np.nan) for a in (picture.value, picture.error))
    return {"value": packed(coarse(value, side), lo, hi), "error": packed(coarse(error, side), -limit, limit)}
