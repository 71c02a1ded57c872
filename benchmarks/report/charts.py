"""The chart of speed against accuracy as a Vega-Lite spec, per scene; and the look that all charts share.

Charts are written as plain specs: Altair copies a chart's parts at every step, which takes minutes where a page has a hundred
charts. `altair.Chart.from_dict` takes every one of them, and checks it (`tests/test_report_charts.py`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ...scenes.plain_text import plain_text
from .cell import Cell, common_noun
from .data import unit_scale
from .front import SUSPECT
from .layout import HEIGHT, WIDTH, log_domain, log_ticks, place_labels
from .numbers import number, rate, span
from .styles import Style, styles_of

__all__ = [
    "CHOSEN", "STILLS", "Spec", "chosen_opacity", "finished", "panel_title", "panels_of", "quantitative",
    "speed_accuracy_spec", "still_spec", "svg_of",
]  # fmt: skip

FRONT, BOUND, DOUBT, GROUND = "#D55E00", "#8a8f98", "#b00020", "var(--card)"
#: Marks of the verdicts before the names, in charts and tables.
VERDICT_MARKS = {"front": "◆ ", "undecided": "◇ ", SUSPECT: "⚠ "}
#: Parameter of every chart of the page: the label of the chosen estimator, "" for all. The page's script sets it.
CHOSEN = "chosen"


#: Panels that the page shows without scripts, and those of speed-accuracy.png and .svg.
STILLS = 12
#: The grammar of the specs.
SCHEMA = "https://vega.github.io/schema/vega-lite/v6.4.1.json"

#: A spec of Vega-Lite, or a part of one.
Spec = dict[str, Any]
Panel = tuple[str, str, str, str]


def panels_of(cells: list[Cell]) -> dict[Panel, list[Cell]]:
    """Cells by panel: scene, stage, quantity, unit."""
    panels: dict[Panel, list[Cell]] = {}
    for cell in cells:
        panels.setdefault((cell.scene, cell.stage, cell.quantity, cell.unit), []).append(cell)
    return panels


def panel_title(panel: Panel, panels: dict[Panel, list[Cell]]) -> str:
    """The scene, with stage and quantity where the page has more than one."""
    several = len({(p[1], p[2]) for p in panels}) > 1
    words = dict.fromkeys(word for word in panel[1:3] if word)  # a stage may be called as its quantity
    return f"{panel[0]}: {' '.join(words)}" if several and words else panel[0]


def speed_accuracy_spec(cells: list[Cell], *, page: bool, styles: Mapping[str, Style] | None = None) -> Spec:
    """One panel: CPU time per element (x) against full RMSE (y), both logarithmic; lower left is better.

    Colour and mark tell the estimator, a filled mark the first condition. `page`: use the width of the container and the
    colours of the page; otherwise fixed width, dark on white. `styles`: of the page; by default those of the panel.
    """
    chart = _panel(cells, page=page, styles=styles or styles_of(c.label for c in cells))
    return finished(chart | {"width": "container" if page else WIDTH, "height": HEIGHT}, page=page)


def chosen_opacity(page: bool, shown: float = 1.0) -> Spec:
    """Opacity that fades all but the chosen estimator; constant outside the page."""
    if not page:
        return {"value": shown}
    test = f"{CHOSEN} === '' || datum.label === {CHOSEN}"
    return {"condition": {"test": test, "value": shown}, "value": 0.12}


def _panel(cells: list[Cell], *, page: bool, styles: Mapping[str, Style]) -> Spec:
    factor, unit = unit_scale(cells[0])
    drawn = [c for c in cells if c.ok and c.cpu_per_element_s > 0 and c.rmse_full > 0]
    conditions = sorted({c.condition for c in cells}, key=lambda name: (name != "matched", name))
    drawn.sort(key=lambda c: conditions.index(c.condition))
    bounds = [c.bound * factor for c in drawn if c.bound > 0]
    points = _points(drawn, factor, unit, conditions, styles, GROUND if page else "#ffffff")
    cpus = [p[k] for p in points for k in ("cpu", "cpu_lo", "cpu_hi") if p[k]]
    errors = [p[k] for p in points for k in ("error", "error_lo", "error_hi") if p[k]] + bounds
    place_labels(points, cpus, errors)
    noun = common_noun(cells)
    place = {
        "x": quantitative("cpu", f"CPU time per {noun}, ns") | _log(cpus),
        "y": quantitative("error", f"RMSE of all {noun}s, {unit}") | _log(errors),
    }
    tips = [{"field": k, "type": "nominal", "title": t} for k, t in _TIPS.items()]
    own = {key: {"field": field, "type": "nominal", "scale": None}
           for key, field in (("shape", "shape"), ("fill", "fill"), ("stroke", "colour"))}  # fmt: skip
    layers = _bound_layers(bounds)
    for position, condition in enumerate(conditions):
        line = {"type": "line", "interpolate": "step-after", "color": BOUND, "strokeWidth": 1.3}
        front = {"and": ["datum.front", {"field": "condition", "equal": condition}]}
        layers.append({
            "transform": [{"filter": front}], "mark": line | {"opacity": 0.9 if position == 0 else 0.4}, "encoding": place
        })  # fmt: skip
    for side, across in (("x", "cpu"), ("y", "error")):
        ends = place | {side: {"field": f"{across}_lo", "type": "quantitative"}, f"{side}2": {"field": f"{across}_hi"}}
        layers.append({
            "transform": [{"filter": f"isValid(datum.{across}_lo)"}], "mark": {"type": "rule", "strokeWidth": 1.6},
            "encoding": ends | {"stroke": own["stroke"], "opacity": chosen_opacity(page, 0.75)},
        })  # fmt: skip
    told = place | {"opacity": chosen_opacity(page), "tooltip": tips}
    point = {"type": "point", "size": 95, "strokeWidth": 2, "cursor": "pointer"}
    layers.append({"mark": point, "encoding": told | own})
    text = {"text": {"field": "text", "type": "nominal"}}
    layers += [{"mark": mark, "encoding": told | text} for mark in _label_marks(page)]
    return {"data": {"values": points}, "layer": layers}


def quantitative(field: str, title: str | None) -> Spec:
    """A channel with numbers of a field."""
    return {"field": field, "type": "quantitative", "title": title}


def _bound_layers(bounds: list[float]) -> list[Spec]:
    """The dashed line of the bound with its name; none without a bound."""
    if not bounds:
        return []
    data = {"values": [{"bound": sorted(bounds)[len(bounds) // 2], "text": "bound"}]}
    at: Spec = {"y": {"field": "bound", "type": "quantitative"}}
    rule = {"type": "rule", "strokeDash": [5, 4], "color": BOUND, "strokeWidth": 1.2}
    text = {"type": "text", "align": "left", "baseline": "bottom", "dx": 4, "dy": -3, "fontSize": 10,
            "fontStyle": "italic", "color": BOUND}  # fmt: skip
    named = at | {"x": {"value": 0}, "text": {"field": "text", "type": "nominal"}}
    return [{"data": data, "mark": rule, "encoding": at}, {"data": data, "mark": text, "encoding": named}]


def _label_marks(page: bool) -> list[Spec]:
    """Each label twice: the first, in the background colour, keeps lines from crossing the letters of the second."""
    place: Spec = {side: {"expr": f"datum.{side}"} for side in ("align", "dx", "dy")}
    mark = {"type": "text", "fontSize": 11, "baseline": "middle", "cursor": "pointer"} | place
    halo = {"stroke": GROUND if page else "#ffffff", "strokeWidth": 4, "strokeJoin": "round"}
    return [mark | halo, mark]


_TIPS = {
    "label": "estimator",
    "condition": "condition",
    "shown_error": "RMSE, all",
    "shown_rmse": "RMSE, valid ones",
    "shown_bound": "bound",
    "shown_coverage": "coverage",
    "shown_failed": "failed",
    "shown_cpu": "CPU time of one",
    "shown_verdict": "verdict",
}


def _points(
    cells: list[Cell], factor: float, unit: str, conditions: list[str], styles: Mapping[str, Style], ground: str
) -> list[dict[str, Any]]:
    points: list[dict[str, Any]] = [
        {
            "cpu": c.cpu_per_element_s * 1e9,
            "error": c.rmse_full * factor,
            "front": c.front,
            "verdict": c.verdict,
            "cpu_lo": _or_none(c.cpu_lo * 1e9),
            "cpu_hi": _or_none(c.cpu_hi * 1e9),
            "error_lo": _or_none(c.error_lo * factor),
            "error_hi": _or_none(c.error_hi * factor),
            "label": c.label,
            "condition": c.condition,
            "scene": c.scene,
            "colour": DOUBT if c.verdict == SUSPECT else styles[c.label][0],
            "shape": styles[c.label][1],
            "fill": styles[c.label][0] if c.condition == conditions[0] else ground,
            "text": VERDICT_MARKS.get(c.verdict, "")
            + c.label
            + (f" ({rate(c.coverage)})" if c.coverage < 0.99 else "")
            + (", beyond its bound" if c.suspect else ""),
            "shown_error": f"{number(c.rmse_full * factor)}{span(c.error_lo * factor, c.error_hi * factor)} {unit}",
            "shown_rmse": f"{number(c.rmse * factor)} {unit}",
            "shown_bound": f"{number(c.bound * factor)} {unit} ({c.bound_kind or 'none'})",
            "shown_coverage": rate(c.coverage),
            "shown_failed": rate(c.failure_rate),
            "shown_cpu": f"{number(c.cpu_per_element_s * 1e9)}{span(c.cpu_lo * 1e9, c.cpu_hi * 1e9)} ns",
            "shown_verdict": c.verdict,
        }
        for c in cells
    ]
    return points


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) and value > 0 else None


def _log(values: list[float]) -> Spec:
    """Scale and axis of a channel with these values, both logarithmic."""
    if not values:
        return {"scale": {"type": "log"}}
    lo, hi = log_domain(values)
    axis = {"format": "~g", "values": log_ticks(lo, hi), "labelFlush": False}
    return {"scale": {"type": "log", "domain": [lo, hi], "nice": False}, "axis": axis}


def still_spec(cells: list[Cell], styles: Mapping[str, Style]) -> Spec:
    """The finished speed-accuracy chart of the first `STILLS` panels.

    Nobody reads a picture of ninety charts, and to draw it takes longer than the rest of the page.
    """
    panels = panels_of(cells)
    size = {"width": WIDTH, "height": HEIGHT}
    charts = [
        _panel(group, page=False, styles=styles) | size | {"title": panel_title(panel, panels)}
        for panel, group in list(panels.items())[:STILLS]
    ]
    return finished({"concat": charts, "columns": 3}, page=False)


def svg_of(spec: Spec) -> str:
    """The SVG of a finished chart. Names of strangers may hold characters that XML does not have; a zero byte ended the process."""
    import vl_convert as vlc

    svg: str = vlc.vegalite_to_svg(_plain(spec))
    return svg


def _plain(value: Any) -> Any:
    if isinstance(value, str):
        return plain_text(value)
    if isinstance(value, Mapping):
        return {plain_text(str(name)): _plain(one) for name, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


def finished(chart: Any, *, page: bool) -> Spec:
    """The complete spec of a chart, with fonts and colours: those of the page, or dark on white.

    `chart`: a Vega-Lite spec, or a chart of Altair.
    """
    spec: Spec = chart if isinstance(chart, dict) else chart.to_dict()
    ink = "currentColor" if page else "#1d2330"
    font = (
        "system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif" if page else "DejaVu Sans, Arial, sans-serif"
    )
    axis = dict.fromkeys(("labelColor", "titleColor", "tickColor", "domainColor", "gridColor"), ink) | {
        "gridOpacity": 0.1, "domainOpacity": 0.4, "tickOpacity": 0.4, "labelOpacity": 0.8, "titleFontWeight": "normal",
        "titleOpacity": 0.9, "labelFontSize": 11, "titleFontSize": 12,
    }  # fmt: skip
    config = {
        "background": "transparent" if page else "#ffffff", "font": font, "view": {"stroke": None}, "axis": axis,
        "legend": {"labelColor": ink, "titleColor": ink, "labelFontSize": 11},
        "title": {"color": ink, "fontSize": 13, "anchor": "start", "fontWeight": 600}, "text": {"color": ink},
    }  # fmt: skip
    chosen = {"params": [*spec.get("params", []), {"name": CHOSEN, "value": ""}]} if page else {}
    made: Spec = _finite(spec | chosen | {"$schema": SCHEMA, "config": config})
    return made


def _finite(value: Any) -> Any:
    """The same data with null for numbers that are none: a share of no elements is shown as a gap."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
