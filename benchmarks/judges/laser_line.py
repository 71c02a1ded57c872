"""The judge of laser lines: columns, and the points that follow from them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from ..bounds.laser_line import laser_line_bounds
from ..bounds.laser_line_roughness import roughness_bounds
from ..scores.truth import Bound, Truth
from .judge import Judge
from .laser_line_boards import board_calibration
from .laser_line_level import level_bound, level_truth
from .laser_line_rig import rig_bounds, rig_truth

__all__ = ["JUDGE"]


def _truth(capture: xr.Dataset) -> Mapping[str, Truth]:
    """The true column [px] and point [m]. Every lit surface of a row is a return of its own, that of the brightest pixel first.
    Slope and level of a surface that was drawn from a power law. The point in the gravity
    frame of a rig with inclinometers. The true rig, for calibrations."""
    names = ("column", "point", *(name for name in ("slope", "level") if f"truth_{name}" in capture))
    plain = {name: Truth.plain(np.asarray(capture[f"truth_{name}"].values, np.float64)) for name in names}
    return {**plain, **level_truth(capture), **rig_truth(capture)}


def _bound(capture: xr.Dataset) -> Mapping[str, Bound]:
    lines = laser_line_bounds(capture)
    return {**lines, **level_bound(capture, lines["point"]), **roughness_bounds(capture), **rig_bounds(capture)}


_CHAIN = "line-erf+triangulate-refractive"

JUDGE = Judge(
    truth=_truth,
    bound=_bound,
    calibrate=board_calibration,
    neighbours=("line-ml", "line-log-gaussian", "line-centroid"),
    scenes=("spotscan-wall",),
    feeders={"triangulation": "line-erf", "spectrum": _CHAIN, "gravity": _CHAIN},
    laws="beambench.benchmarks.laws.laser_line:LAWS",
    twin="beambench.benchmarks.twin.laser_line:TWIN",
    design="beambench.benchmarks.design.laser_line:DESIGNS",
    rungs="beambench.benchmarks.fidelity.laser_line:BENCH",
)
