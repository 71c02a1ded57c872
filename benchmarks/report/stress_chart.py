"""Charts of failures against the level of a stress, as Vega-Lite specs: breakdown, one line per estimator."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ..statistics.levels import is_log
from .cell import Cell, common_noun
from .charts import Spec, chosen_opacity, finished, quantitative, svg_of
from .data import by_quantity
from .layout import HEIGHT, WIDTH
from .numbers import rate
from .styles import Style, styles_of

__all__ = ["static_stresses", "stress_groups", "stress_spec"]


def stress_groups(cells: list[Cell]) -> dict[tuple[str, str, str], list[Cell]]:
    """Stressed cells by (scene, condition, axis), where an axis has at least two levels; by quantity too, which the axis then
    names, where there are several: one line is of one kind of element."""
    groups: dict[tuple[str, str, str], list[Cell]] = {}
    own = [cell for cell in cells if cell.stressed and not cell.stress2 and not cell.mixed]
    for name, group in by_quantity(own).items():
        several = len({cell.quantity for cell in own if cell.scene == group[0].scene}) > 1
        for cell in group:
            axis = f"{cell.stress}, {name}" if several else cell.stress
            groups.setdefault((cell.scene, cell.condition, axis), []).append(cell)
    return {key: group for key, group in groups.items() if len({c.level for c in group}) > 1}


def stress_spec(cells: list[Cell], *, page: bool, styles: Mapping[str, Style] | None = None) -> Spec:
    """Share of failed elements (y) against stress level (x), one line per estimator; a crash counts as 100 %.

    `styles`: of the page; by default those of these cells.
    """
    chart = _panel(cells, page=page, styles=styles or styles_of(c.label for c in cells))
    return finished(chart | {"width": "container" if page else WIDTH, "height": HEIGHT}, page=page)


def _panel(cells: list[Cell], *, page: bool, styles: Mapping[str, Style]) -> Spec:
    axis, noun = cells[0].stress, common_noun(cells)
    numeric = all(_is_number(c.level) for c in cells)
    cells = [c for c in cells if not c.skipped]
    labels = list(dict.fromkeys(c.label for c in cells))
    rows = [
        {
            "level": float(c.level) if numeric else c.level,
            "failed": c.failure_rate if c.ok else 1.0,
            "label": c.label,
            "scene": c.scene,
            "shown": rate(c.failure_rate) if c.ok else c.status,
        }
        for c in cells
    ]
    wide = numeric and is_log([float(row["level"]) for row in rows])
    level: Spec = {"field": "level", "type": "quantitative" if numeric else "ordinal", "title": axis}
    level |= {"scale": {"type": "log", "nice": False}} if wide else {}
    level |= {"axis": {"format": "~g", "tickCount": 6}} if numeric else {}
    legend = None if page else {"title": None, "orient": "bottom", "columns": 3, "labelLimit": 150}
    looks = {
        name: {"field": "label", "type": "nominal", "legend": legend,
               "scale": {"domain": labels, "range": [styles[label][k] for label in labels]}}
        for k, name in enumerate(("color", "shape"))
    }  # fmt: skip
    failed = quantitative("failed", f"failed {noun}s") | {"axis": {"format": "%"}, "scale": {"domain": [0, 1]}}
    place = {"x": level, "y": failed, "color": looks["color"], "opacity": chosen_opacity(page)}
    tips = [
        {"field": "label", "type": "nominal", "title": "estimator"},
        {"field": "level", "type": "quantitative" if numeric else "nominal", "title": axis},
        {"field": "shown", "type": "nominal", "title": "failed"},
    ]
    dots = {"type": "point", "size": 60, "filled": True, "cursor": "pointer"}
    layers = [
        {"mark": {"type": "line", "strokeWidth": 1.6}, "encoding": place},
        {"mark": dots, "encoding": place | {"shape": looks["shape"], "tooltip": tips}},
    ]
    return {"data": {"values": rows}, "layer": layers}


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def static_stresses(groups: Mapping[str, list[Cell]], styles: Mapping[str, Style]) -> str:
    """SVG text of all panels (title -> cells), for readers without scripts; "" without a panel."""
    if not groups:
        return ""
    size = {"width": WIDTH, "height": HEIGHT}
    charts = [_panel(cells, page=False, styles=styles) | size | {"title": title} for title, cells in groups.items()]
    apart = {"scale": dict.fromkeys(("color", "shape"), "independent")}
    joined = {"concat": charts, "columns": 3, "resolve": apart}
    return svg_of(finished(joined, page=False))
