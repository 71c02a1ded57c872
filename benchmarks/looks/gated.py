"""The look of a gated capture: slices from near to far, the truth, and one pixel against delay."""

from __future__ import annotations

import numpy as np
import xarray as xr

from .panel import TRUE, Curve, Curves, Image, chosen, image, mean_channel, unit_of

__all__ = ["gated_look"]

_NS = 1e9


def gated_look(capture: xr.Dataset, element: int | None) -> list[Image | Curves]:
    """Three slices on one scale, at which a quarter, half and three quarters of the light have passed, or the asked slice; the
    truth; the pixel with most light against delay."""
    counts = mean_channel(capture["counts"]).transpose("slice", "row", "col").values
    delay = capture["delay"].values * _NS
    unit = unit_of(capture["counts"])
    order = np.argsort(delay, kind="stable")
    if element is None:
        light = np.nansum(counts - np.nanmin(counts, axis=0), axis=(1, 2))[order]
        passed = np.cumsum(light) / max(float(light.sum()), 1e-300)
        shown = [int(order[min(int(np.searchsorted(passed, share)), len(order) - 1)]) for share in (0.25, 0.5, 0.75)]
    else:
        shown = [chosen(element, counts, "slice")]
    found: list[Image | Curves] = [
        image(f"slice {number}, {delay[number]:.2f} ns", counts[number], unit, like=counts[shown])
        for number in dict.fromkeys(shown)
    ]
    truth = capture["truth_range"] if "truth_range" in capture.variables else None
    if truth is not None and np.isfinite(truth.values).any():
        found.append(image("true range", truth.values, unit_of(truth)))
    row, col = np.unravel_index(int(np.argmax(np.nansum(counts - np.nanmin(counts, axis=0), axis=0))), counts.shape[1:])
    line = Curve("counts", delay[order], counts[order, row, col], dots=len(order) <= 200)
    mark = Curve("slices shown", delay[shown], counts[shown, row, col], TRUE, strokes=False)
    found.append(Curves(f"pixel {row}, {col}", (line, mark), "delay, ns", f"counts, {unit}"))
    return found
