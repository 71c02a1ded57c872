"""`beambench bound`: the least standard error that an estimate from a capture can have."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["bound"]


def bound(data: str | Path) -> pd.DataFrame:
    """Show the bound of every capture of a store: the least standard error that an estimate can have, from rig and truth.

    It is what scores are compared with: Cramér-Rao where that can be reached in every element, else Bayesian. The arrays
    of one capture, element by element, are those of `beambench.benchmarks.judges.bound.bounds_of`.

    Main arguments:
        data: A store of captures with truth.

    Returns:
        A table with a row per capture and quantity. capture, scene, quantity, unit; kind: "exact", "quasi" (the capture holds
        something that the likelihood leaves out), "bayes" (some elements are below threshold) or "none"; elements: those with
        a truth; informed: those whose bound is finite; bound_median and bound_rms over these (an element never counts with
        more than the prior); prior: standard error of a guess within the window; scale: width of the echo; window. All in the
        unit.

    Raises:
        InputError: There is no store, it holds no truth, or its modality is not scored.
    """
    import pandas as pd

    from ..benchmarks.datasets.bound import bound_rows

    return pd.DataFrame(bound_rows(Path(data)))
