"""What happens to the expected light before it is detected: speckle, and charge that spills beyond the full well."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...scenes.rigs.laser_line_effects import Blooming
from ...scenes.rigs.parts import Detector
from ..random import Stage, blocks, generator

__all__ = ["bloomed", "speckled"]

Float32 = NDArray[np.float32]

#: Charge that is left to spill, as a share of the full well, at which it is dropped.
_NOTHING = 1e-6


def speckled(electrons: Float32, background: Float32, looks: float, seed: int, key: int) -> Float32:
    """Expected photoelectrons (frames, rows, cols) of one draw of speckle.

    What is above the `background` (frames, rows or 1, cols or 1) is multiplied by Gamma(M, 1/M), of mean 1 and contrast 1/√M.
    Grains are no larger than a pixel: pixels are independent. Scattered light, from many depths, has none.

    Source: J. W. Goodman, Speckle Phenomena in Optics, 2007, sec. 3.3 and 4.6.
    """
    out = electrons.copy()
    for number in range(len(electrons)):
        for block, part in blocks(electrons.shape[1]):
            draw = generator(seed, key, Stage.SPECKLE, block + (number << 20))
            line = np.maximum(
                electrons[number, part] - np.broadcast_to(background[number], electrons[number].shape)[part], 0.0
            )
            grain = draw.standard_gamma(looks, line.shape) / looks
            out[number, part] = electrons[number, part] + (line * (grain - 1.0)).astype(np.float32)
    return out


def bloomed(electrons: Float32, detector: Detector, blooming: Blooming) -> Float32:
    """Expected photoelectrons (frames, rows, cols) after charge beyond the full well has spilled.

    The excess of a pixel over the well, less the share that the drain takes, goes in halves to the neighbours up and down (axis
    "columns") or left and right ("rows"), and from there on in the same direction as long as pixels are full; what leaves the array
    is lost. Of the expectation, so that spilled charge has the noise of light; dark charge has no part in it. A full pixel keeps
    the full well.
    """
    axis = 1 if blooming.axis == "columns" else 2
    moved = np.moveaxis(electrons.astype(np.float64), axis, 0)
    full, kept = detector.full_well_e, 1.0 - blooming.lost
    excess = np.maximum(moved - full, 0.0)
    level = np.minimum(moved, full)
    for order in (1, -1):
        carried = np.zeros_like(level[0])
        for index in range(len(level))[::order]:
            here = level[index] + carried
            over = np.maximum(here - full, 0.0)
            level[index] = here - over
            carried = kept * over + 0.5 * kept * excess[index]
            carried[carried < _NOTHING * full] = 0.0
    return np.moveaxis(level, 0, axis).astype(np.float32)
