"""Panels as samples of colour, for a terminal that shows no pictures: few rows and columns, no letters."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..report.pictures import lut
from .panel import LONGEST, Array, Curve, Curves, Image

__all__ = ["samples_of"]

Colours = npt.NDArray[np.uint8]

_STEPS = 128
#: Ground of curves, and of what an image does not have.
_GROUND = (24, 24, 28)


def samples_of(panel: Image | Curves, rows: int, cols: int) -> Colours:
    """A panel as colours (row, col, 3), at most `rows` × `cols`; lines over an image stay one sample wide."""
    return _image(panel, rows, cols) if isinstance(panel, Image) else _curves(panel, rows, cols)


def _image(panel: Image, rows: int, cols: int) -> Colours:
    height, width = panel.values.shape
    down, across = height / rows, width / cols
    if 1.0 / LONGEST <= width / height <= LONGEST:
        down = across = max(down, across)
    row, col = (
        np.minimum((np.arange(max(1, round(size / step))) + 0.5) * step, size - 1).astype(int)
        for size, step in ((height, down), (width, across))
    )
    values = panel.values[np.ix_(row, col)]
    known = np.isfinite(values)
    share = np.clip((np.where(known, values, panel.low) - panel.low) / (panel.high - panel.low), 0.0, 1.0)
    drawn: Colours = lut(panel.anchors, _STEPS)[np.rint(share * (_STEPS - 1)).astype(int)]
    drawn[~known] = _GROUND
    for line in panel.lines:
        _draw(drawn, line, (line.x + 0.5) / across - 0.5, (line.y + 0.5) / down - 0.5)
    return drawn


def _curves(panel: Curves, rows: int, cols: int) -> Colours:
    drawn = np.full((rows, cols, 3), _GROUND, np.uint8)
    x, y = (np.concatenate([getattr(line, name) for line in panel.lines]) for name in ("x", "y"))
    if not (np.isfinite(x) & np.isfinite(y)).any():
        return drawn
    (left, right), (low, high) = ((float(np.nanmin(v)), float(np.nanmax(v))) for v in (x, y))
    for line in panel.lines:
        across = (line.x - left) / ((right - left) or 1.0) * (cols - 1)
        _draw(drawn, line, across, (high - line.y) / ((high - low) or 1.0) * (rows - 1))
    return drawn


def _draw(drawn: Colours, line: Curve, x: Array, y: Array) -> None:
    """Strokes through samples (x, y), by points half a sample apart."""
    colour = [int(line.colour[n : n + 2], 16) for n in (1, 3, 5)]
    if len(x) > 1 and line.strokes:
        ends = np.isfinite(x[:-1] + x[1:] + y[:-1] + y[1:])
        steps = np.where(ends, np.maximum(abs(np.diff(x)), abs(np.diff(y))), 0.0)
        many = 2 * int(np.ceil(min(float(steps.max(initial=0.0)), float(sum(drawn.shape[:2]))))) + 1
        share = np.linspace(0.0, 1.0, many)
        x, y = ((v[:-1, None] + share * np.diff(v)[:, None])[ends].reshape(-1) for v in (x, y))
    good = np.isfinite(x) & np.isfinite(y)
    col, row = np.rint(x[good]).astype(int), np.rint(y[good]).astype(int)
    inside = (row >= 0) & (row < drawn.shape[0]) & (col >= 0) & (col < drawn.shape[1])
    drawn[row[inside], col[inside]] = colour
