"""Which elements of a capture are regular, decided from rig and truth before anything is estimated, and the bound of
those that are not.

An element is regular where its Cramér-Rao bound is what an estimator can reach: the Ziv-Zakai bound at its delay within
1.05 of it on either side, and wrong cells adding less than that (`ziv_zakai.LocalBound.regular`). Amplitude and
background are taken as known; profiling them moves the threshold little (for echoes apart the test is the same) and the
edges of the window much, where the Cramér-Rao bound itself tells it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..scores.score import Bound
from .scan import Elements, elements_of
from .threshold import ThresholdTable, table_of, threshold_table

__all__ = ["ThresholdTable", "is_regular", "threshold_bound", "threshold_table"]

Bool = npt.NDArray[np.bool_]


def _regular(table: ThresholdTable, elements: Elements) -> Bool:
    return table.regular(elements.delay_s, elements.amplitude, elements.level)


def is_regular(capture: xr.Dataset, table: ThresholdTable | None = None) -> Bool:
    """Per element of a generated capture, in the shape of its truth: True where its Cramér-Rao bound may be asserted.

    Main arguments:
        table: of the same rig; found here if not given.
    Elements without truth are False. Raises InputError where the capture lacks its true scene.
    """
    scan, elements = elements_of(capture)
    return _regular(table or table_of(scan), elements)


def threshold_bound(
    capture: xr.Dataset, bound: Bound, table: ThresholdTable | None = None,
    *, form: Literal["ziv-zakai", "bayes"] = "bayes",
) -> Bound:  # fmt: skip
    """`bound` with another one in elements that are not regular.

    Main arguments:
        bound: the Cramér-Rao bound of the capture. table: as for `is_regular`.
    Other arguments:
        form: "ziv-zakai", ε(θ)·c/2n_g: milliseconds, and up to half too low in the threshold region of a wide window; or
        "bayes", the rms error of the posterior mean on stacks from about there, uniform prior (`bayes.posterior_square`).
    The kind becomes `form` where any unmixed element with a truth is irregular: a mean over regular and irregular ones
    asserts no more than its weakest part. Neither form exceeds the prior's error. Both bound the mean square over delays
    of the window, not a single element: a scene that sits where the window is best may do better. An echo outside the
    window keeps its Cramér-Rao bound, at most the prior's error. "none" stays. Raises InputError where the capture lacks
    its true scene.
    """
    if bound.kind == "none":
        return bound
    scan, elements = elements_of(capture)
    table = table or table_of(scan)
    other = ~np.isnan(bound.sigma) & ~_regular(table, elements)
    if not other.any():
        return bound
    low, high = scan.window_s
    with np.errstate(invalid="ignore"):
        inside = other & (elements.delay_s >= low) & (elements.delay_s <= high)
    delay = np.where(inside, elements.delay_s, np.nan)
    look = table.bayes_s if form == "bayes" else table.epsilon_s
    found = look(delay, elements.amplitude, elements.level) * elements.scale_m_per_s
    # fmin: elements outside the window, or without any light, have what is left of the Cramér-Rao bound, and the prior.
    replaced = np.fmin(np.where(np.isnan(found), bound.sigma, found), bound.prior_m)
    mixed = np.asarray(capture["truth_mixed"].values, bool) if "truth_mixed" in capture else np.zeros(other.shape, bool)
    kind = form if (other & ~mixed).any() else bound.kind
    return replace(bound, sigma=np.where(other, replaced, bound.sigma), kind=kind)
