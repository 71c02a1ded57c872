"""The judge of laser lines: columns, and the points that follow from them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from ..bounds.laser_line import laser_line_bounds
from ..scores.truth import Truth
from .judge import Judge
from .laser_line_boards import board_calibration

__all__ = ["JUDGE"]


def _truth(capture: xr.Dataset) -> Mapping[str, Truth]:
    """The true column [px] and point [m]. Every lit surface of a row is a return of its own, that of the brightest pixel first."""
    return {name: Truth.plain(np.asarray(capture[f"truth_{name}"].values, np.float64)) for name in ("column", "point")}


JUDGE = Judge(
    truth=_truth,
    bound=laser_line_bounds,
    calibrate=board_calibration,
    neighbours=("line-ml", "line-log-gaussian", "line-centroid"),
    scenes=("spotscan-wall",),
    feeders={"triangulation": "line-erf"},
    laws="beambench.benchmarks.laws.laser_line:LAWS",
    rungs="beambench.benchmarks.fidelity.laser_line:BENCH",
)
