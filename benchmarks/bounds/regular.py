"""The regular elements of a capture, which depend on rig and truth only, not on any estimate; the bound of irregular ones.

An element is regular if an estimator can reach its Cramér-Rao bound: the Ziv-Zakai bound at its delay is within a factor of
1.05 of it, and wrong cells add less than that (`ziv_zakai.LocalBound.regular`). Amplitude and background are taken as known.
Profiling them changes the threshold little (for separate echoes the test is the same), but it changes the edges of the window
much; there the Cramér-Rao bound itself shows it.
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
    """Flags of the elements: True if the Cramér-Rao bound can be reached; False without truth.

    Other arguments:
        table: the table of the scan; by default that of `table_of`.
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
    """`bound`, replaced in irregular elements.

    Main arguments:
        bound: the Cramér-Rao bound of the capture. scan, elements: scan and elements of the same capture. mixed: flags of
        elements with several true values. table: as for `regular`.
    Other arguments:
        form: "ziv-zakai", ε(θ)·c/2n_g: takes milliseconds, and is up to half too low in the threshold region of a wide window;
        or "bayes", the rms error of the posterior mean for delays near θ, with a uniform prior (`bayes.posterior_square`).
    The kind becomes `form` if any unmixed element with truth is irregular, because a mean over regular and irregular elements
    is only as strong as its weakest part. Neither form exceeds the prior's error. Both bound the mean square over the delays
    of the window, not a single element, so that a scene in the best part of the window may have a smaller error. An echo
    outside the window keeps its Cramér-Rao bound, limited to the prior's error.
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
    # fmin: elements outside the window or without light have the smaller one of Cramér-Rao bound and prior.
    replaced = np.fmin(np.where(np.isnan(found), bound.sigma, found), bound.prior)
    kind = form if (other & ~mixed).any() else bound.kind
    return replace(bound, sigma=np.where(other, replaced, bound.sigma), kind=kind)
