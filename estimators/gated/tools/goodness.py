"""Goodness of fit for the estimators that fit R: `misfit` of their answers, with the counts of the stack."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .design import Design
from .misfit import LIMIT, NO_VEIL, state_misfit
from .stack import Stack

__all__ = ["hold_misfit"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]


def hold_misfit(
    stack: Stack, design: Design, tau: Float, sigma: Float, ok: Bool, *, veil: tuple[Float, Float] = NO_VEIL
) -> None:
    """Enlarge sigma (row, col) in place where the profile of a pixel is broader than R, or unlike it, by more than chance.

    Main arguments: tau, sigma (row, col): place of the echo and its standard error, in rows of the table of `design`, as the
    echo's light is read at place τ; ok (row, col): the pixels that have an answer.
    Other arguments: veil: (below (row of the table, group), strength (row, col)), light of a known course beside the echo.
    """
    rig = stack.instrument
    shift = stack.count * rig.floor_var / rig.excess**2
    floor = -0.5 * float((shift / stack.exposure).min())
    levels = (rig.offset_dn, stack.frames / (rig.dn_per_pe * rig.excess), rig.saturation_dn)
    state_misfit(
        stack.counts, stack.slices, stack.group, stack.exposure, shift, levels, design.table, design.first, design.last,
        design.width, floor, LIMIT, (0.0, 1.0), tau, sigma, ok, *veil,
    )  # fmt: skip
