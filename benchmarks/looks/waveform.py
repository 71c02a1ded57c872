"""The look of a waveform capture: its records, and one of them with its true echo."""

from __future__ import annotations

import numpy as np
import xarray as xr

from ...estimators.rig import read_rig
from ...optics.constants import C_M_PER_S
from ...scenes.errors import InputError
from .panel import TRUE, Array, Curve, Curves, Image, chosen, image, true_ranges, unit_of

__all__ = ["waveform_look"]

_NS = 1e9


def waveform_look(capture: xr.Dataset, element: int | None) -> list[Image | Curves]:
    """The record with most signal, or the asked one, with its true echoes; all records; the truth of every shot."""
    signal = capture["signal"].transpose("shot", "sample").values.astype(np.float64)
    time = capture["time"].values * _NS
    unit = unit_of(capture["signal"])
    shot = chosen(element, signal, "shot")
    lines = [Curve("signal", time, signal[shot], dots=len(time) <= 64)]
    low, high = float(np.nanmin(signal[shot])), float(np.nanmax(signal[shot]))
    for at in true_times(capture)[shot] * _NS:
        if np.isfinite(at):
            lines.append(Curve("true echo", np.array([at, at]), np.array([low, high]), TRUE))
    found: list[Image | Curves] = [Curves(f"shot {shot}", tuple(lines), "time, ns", f"signal, {unit}")]
    if len(signal) > 1:
        found.append(image("all shots", signal, unit, x="sample", y="shot"))
    return found + true_ranges(capture)


def true_times(capture: xr.Dataset) -> Array:
    """Times (shot, return) of the true echoes on the clock of the records, s: 2 n R/c less the start of the record; NaN where the
    rig does not declare the index."""
    names = [name for name in ("truth_returns", "truth_range") if name in capture.variables]
    shots = capture.sizes["shot"]
    try:
        index = read_rig(capture).number("medium.group_index", above=0)
    except InputError:
        return np.full((shots, 1), np.nan)
    ranges = capture[names[0]].values.reshape(shots, -1).astype(np.float64) if names else np.full((shots, 1), np.nan)
    start = capture["start"].values if "start" in capture.variables else np.zeros(shots)
    return np.asarray(2.0 * index * ranges / C_M_PER_S - start[:, None])
