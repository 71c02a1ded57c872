"""The look of a laser-line capture: a frame with the true line, a row of it, and the line of all frames."""

from __future__ import annotations

import numpy as np
import xarray as xr

from .panel import FIRST, TRUE, Curve, Curves, Image, chosen, image, mean_channel, unit_of

__all__ = ["laser_line_look"]

#: Columns to either side of the peak of a row.
_BESIDE = 24


def laser_line_look(capture: xr.Dataset, element: int | None) -> list[Image | Curves]:
    """The frame with most light, or the asked one; the row with most light; columns of the line in every frame."""
    counts = mean_channel(capture["counts"]).transpose("frame", "row", "col").values
    unit = unit_of(capture["counts"])
    frame = chosen(element, counts, "frame")
    rows = np.arange(counts.shape[1], dtype=float)
    truth = capture["truth_column"].values.astype(np.float64) if "truth_column" in capture.variables else None
    known = truth is not None and bool(np.isfinite(truth).any())
    lines = []
    if truth is not None and known:
        lines = [Curve("true line", truth[frame, :, n], rows, TRUE) for n in range(truth.shape[2])]
    found: list[Image | Curves] = [image(f"frame {frame}", counts[frame], unit, lines=lines)]
    row = int(np.argmax(np.nanmax(counts[frame], axis=1)))
    peak = int(np.argmax(counts[frame, row]))
    near = slice(max(peak - _BESIDE, 0), peak + _BESIDE + 1)
    section = counts[frame, row, near]
    curves = [Curve("counts", np.arange(counts.shape[2], dtype=float)[near], section, FIRST, dots=True)]
    if truth is not None and known:
        ends = np.array([section.min(), section.max()])
        curves += [
            Curve("true column", np.full(2, at), ends, TRUE) for at in truth[frame, row] if abs(at - peak) <= _BESIDE
        ]
    found.append(Curves(f"row {row} of frame {frame}", tuple(curves), "column", f"counts, {unit}"))
    if truth is not None and known and len(truth) > 1:
        found.append(image("true column of every frame", truth[:, :, 0], "px", x="row", y="frame"))
    return found
