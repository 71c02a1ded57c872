"""The truth of captures from which ranges are estimated."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from ..scores.truth import Truth

__all__ = ["range_truth"]


def range_truth(capture: xr.Dataset) -> Mapping[str, Truth]:
    """The true range, m; an element that sees two surfaces (`truth_mixed`) has two true values, `truth_first` and `truth_last`."""
    true_range = np.asarray(capture["truth_range"].values, np.float64)
    if "truth_mixed" not in capture:
        return {"range": Truth.plain(true_range)}
    first, last = (np.asarray(capture[name].values, np.float64) for name in ("truth_first", "truth_last"))
    return {"range": Truth(true_range, np.asarray(capture["truth_mixed"].values, bool), (first, last))}
