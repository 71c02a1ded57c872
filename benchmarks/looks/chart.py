"""Panels as a chart: a Vega-Lite spec with images inside it, in the look of the report's charts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..report.charts import Spec, finished, quantitative
from ..report.layout import HEIGHT, WIDTH
from ..report.pictures import data_uri, png
from .panel import LONGEST, Curve, Curves, Image

__all__ = ["COLUMNS", "chart_of", "panel_spec"]

#: Panels beside each other, samples of a curve that are drawn, and samples of an image's longer side.
COLUMNS = 3
_MOST_SAMPLES = 4000
_SIDE = 640


def chart_of(panels: Sequence[Image | Curves | Spec], title: str) -> Spec:
    """The spec of all panels; a dictionary among them is a finished part of a chart."""
    parts = [panel if isinstance(panel, dict) else panel_spec(panel) for panel in panels]
    apart = {"scale": dict.fromkeys(("x", "y", "color", "stroke"), "independent")}
    return finished(
        {"title": {"text": title, "offset": 14}, "concat": parts, "columns": COLUMNS, "resolve": apart}, page=False
    )


def panel_spec(panel: Image | Curves) -> Spec:
    """The spec of one panel."""
    return _image(panel) if isinstance(panel, Image) else _curves(panel)


def _image(panel: Image) -> Spec:
    rows, cols = panel.values.shape
    ratio = cols / rows
    true = 1.0 / LONGEST <= ratio <= LONGEST
    width, height = (min(WIDTH, HEIGHT * ratio), min(HEIGHT, WIDTH / ratio)) if true else (WIDTH, HEIGHT)
    picture = data_uri(png(_enlarged(panel.values), panel.low, panel.high, panel.anchors, side=_SIDE))
    x = quantitative("x", panel.x) | {"scale": {"domain": [-0.5, cols - 0.5], "nice": False, "zero": False}}
    y = quantitative("y", panel.y) | {
        "scale": {"domain": [-0.5, rows - 0.5], "nice": False, "zero": False, "reverse": True}
    }
    across, down = ({"axis": {"grid": False, "values": _ticks(size), "format": "d"}} for size in (cols, rows))
    colour = {
        "field": "value", "type": "quantitative",
        "scale": {"domain": [panel.low, panel.high], "range": list(panel.anchors), "interpolate": "rgb"},
        "legend": {"title": panel.unit, "gradientLength": round(height * 0.8), "gradientOpacity": 1.0},
    }  # fmt: skip
    layers: list[Spec] = [
        {
            "data": {"values": [{"x": (cols - 1) / 2, "y": (rows - 1) / 2, "url": picture}]},
            "mark": {"type": "image", "width": width, "height": height, "aspect": False, "smooth": False},
            "encoding": {"x": x | across, "y": y | down, "url": {"field": "url", "type": "nominal"}},
        },
        {  # a point of no size, for the bar of colours
            "data": {"values": [{"x": 0, "y": 0, "value": panel.low}]},
            "mark": {"type": "point", "size": 0},
            "encoding": {"x": x, "y": y, "color": colour},
        },
    ]
    for line in panel.lines:
        layers += _line(line, x, y, None)
    return {"title": _titled(panel), "width": round(width), "height": round(height), "layer": layers}


def _ticks(size: int) -> list[int]:
    """Numbers of at most nine columns or rows, a round step apart."""
    step = next(s * 10**power for power in range(12) for s in (1, 2, 5) if size <= 9 * s * 10**power)
    return list(range(0, size, step))


def _titled(panel: Image) -> str | Spec:
    names = list(dict.fromkeys(line.name for line in panel.lines))
    return (
        {"text": panel.title, "subtitle": " and ".join(names), "subtitleColor": panel.lines[0].colour}
        if names
        else panel.title
    )


def _enlarged(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Every sample several times, so that drawing programs that smooth do not blur small images."""
    factor = max(1, _SIDE // (2 * max(values.shape)))
    return np.repeat(np.repeat(values, factor, axis=0), factor, axis=1)


def _curves(panel: Curves) -> Spec:
    x, y = (quantitative(name, title) | {"scale": {"zero": False}} for name, title in (("x", panel.x), ("y", panel.y)))
    names = list(dict.fromkeys(line.name for line in panel.lines))
    colours = {line.name: line.colour for line in panel.lines}
    legend = {
        "field": "name", "type": "nominal", "sort": names,
        "scale": {"domain": names, "range": [colours[name] for name in names]},
        "legend": {"title": None, "orient": "top"} if len(names) > 1 else None,
    }  # fmt: skip
    layers = [layer for line in panel.lines for layer in _line(line, x, y, legend)]
    return {"title": panel.title, "width": WIDTH, "height": HEIGHT, "layer": layers}


def _line(line: Curve, x: Spec, y: Spec, colour: Spec | None) -> list[Spec]:
    """A curve as strokes, each with a number of its own; dots on its samples."""
    step = max(1, -(-len(line.x) // _MOST_SAMPLES)) if not np.isnan(line.x).any() else 1
    known = np.isfinite(line.x) & np.isfinite(line.y)
    stroke = np.cumsum(~known)
    values = [
        {"x": float(a), "y": float(b), "stroke": int(s), "name": line.name, "order": n}
        for n, (a, b, s, good) in enumerate(
            zip(line.x[::step], line.y[::step], stroke[::step], known[::step], strict=True)
        )
        if good
    ]
    encoding: Spec = {
        "x": x,
        "y": y,
        "detail": {"field": "stroke", "type": "nominal"},
        "order": {"field": "order", "type": "quantitative"},
    }
    encoding["color"] = colour if colour is not None else {"value": line.colour}
    if not line.strokes:
        dot = {"type": "point", "size": 50, "filled": True, "opacity": 1.0}
        return [{"data": {"values": values}, "mark": dot, "encoding": encoding}]
    point = {"size": 14, "filled": True} if line.dots else False
    mark: Spec = {"type": "line", "strokeWidth": 1.5, "point": point, "clip": True}
    return [{"data": {"values": values}, "mark": mark, "encoding": encoding}]
