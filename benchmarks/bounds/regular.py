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

from ..scores.truth import Bound
from .scan import Elements, Scan
from .threshold import ThresholdTable, table_of

__all__ = ["Form", "regular", "with_threshold"]

Bool = npt.NDArray[np.bool_]
Form = Literal["ziv-zakai", "bayes"]


def regular(scan: Scan, elements: Elements, table: ThresholdTable | None = None) -> Bool:
    """Per element: True where its Cramér-Rao bound may be asserted; elements without truth are False.

    Other arguments:
        table: of the scan; looked up if not given.
    """
    return (table or table_of(scan)).regular(elements.delay_s, elements.amplitude, elements.level)


def with_threshold(
    bound: Bound,
    scan: Scan,
    elements: Elements,
    mixed: Bool,
    table: ThresholdTable | None = None,
    *,
    form: Form = "bayes",
) -> Bound:
    """`bound` with another one in elements that are not regular.

    Main arguments:
        bound: the Cramér-Rao bound of the capture. scan, elements: of the same capture. mixed: elements with several true
        values. table: as for `regular`.
    Other arguments:
        form: "ziv-zakai", ε(θ)·c/2n_g: milliseconds, and up to half too low in the threshold region of a wide window; or
        "bayes", the rms error of the posterior mean on stacks from about there, uniform prior (`bayes.posterior_square`).
    The kind becomes `form` where any unmixed element with a truth is irregular: a mean over regular and irregular ones
    asserts no more than its weakest part. Neither form exceeds the prior's error. Both bound the mean square over delays
    of the window, not a single element: a scene that sits where the window is best may do better. An echo outside the
    window keeps its Cramér-Rao bound, at most the prior's error.
    """
    table = table or table_of(scan)
    other = ~np.isnan(bound.sigma) & ~regular(scan, elements, table)
    if not other.any():
        return bound
    low, high = scan.window_s
    with np.errstate(invalid="ignore"):
        inside = other & (elements.delay_s >= low) & (elements.delay_s <= high)
    delay = np.where(inside, elements.delay_s, np.nan)
    look = table.bayes_s if form == "bayes" else table.epsilon_s
    found = look(delay, elements.amplitude, elements.level) * elements.scale_m_per_s
    # fmin: elements outside the window, or without any light, have what is left of the Cramér-Rao bound, and the prior.
    replaced = np.fmin(np.where(np.isnan(found), bound.sigma, found), bound.prior)
    kind = form if (other & ~mixed).any() else bound.kind
    return replace(bound, sigma=np.where(other, replaced, bound.sigma), kind=kind)
