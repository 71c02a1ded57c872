"""Charts of failures against the level of a stress, as Vega-Lite specs: breakdown, one line per estimator."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ..statistics.levels import is_log
from .cell import Cell, common_noun
from .charts import chosen_opacity, finished, svg_of
from .data import by_quantity
from .layout import HEIGHT, WIDTH
from .styles import Style, styles_of
from .text import rate

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


def stress_spec(cells: list[Cell], *, page: bool, styles: Mapping[str, Style] | None = None) -> dict[str, Any]:
    """Share of failed elements (y) against stress level (x), one line per estimator; a crash counts as 100 %.

    `styles`: of the page; by default those of these cells.
    """
    chart = _panel(cells, page=page, styles=styles or styles_of(c.label for c in cells))
    return finished(chart.properties(width="container" if page else WIDTH, height=HEIGHT), page=page)


def _panel(cells: list[Cell], *, page: bool, styles: Mapping[str, Style]) -> Any:
    import altair as alt

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
    scale = alt.Scale(type="log", nice=False) if wide else alt.Undefined
    form = alt.Axis(format="~g", tickCount=6) if numeric else alt.Undefined
    colours = alt.Scale(domain=labels, range=[styles[label][0] for label in labels])
    shapes = alt.Scale(domain=labels, range=[styles[label][1] for label in labels])
    legend = None if page else alt.Legend(title=None, orient="bottom", columns=3, labelLimit=150)
    base = alt.Chart(alt.InlineData(values=rows)).encode(
        x=alt.X("level:Q" if numeric else "level:O", title=axis, scale=scale, axis=form),
        y=alt.Y("failed:Q", title=f"failed {noun}s", axis=alt.Axis(format="%"), scale=alt.Scale(domain=[0, 1])),
        color=alt.Color("label:N", scale=colours, legend=legend),
        opacity=chosen_opacity(page),
    )
    tips = [
        alt.Tooltip("label:N", title="estimator"),
        alt.Tooltip("level:Q" if numeric else "level:N", title=axis),
        alt.Tooltip("shown:N", title="failed"),
    ]
    dots = base.mark_point(size=60, filled=True, cursor="pointer")
    return alt.layer(
        base.mark_line(strokeWidth=1.6),
        dots.encode(shape=alt.Shape("label:N", scale=shapes, legend=legend), tooltip=tips),
    )


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def static_stresses(groups: Mapping[str, list[Cell]], styles: Mapping[str, Style]) -> str:
    """SVG text of all panels (title -> cells), for readers without scripts; "" without a panel."""
    import altair as alt

    if not groups:
        return ""
    charts = [
        _panel(cells, page=False, styles=styles).properties(width=WIDTH, height=HEIGHT, title=title)
        for title, cells in groups.items()
    ]
    joined = alt.concat(*charts, columns=3).resolve_scale(color="independent", shape="independent")
    return svg_of(finished(joined, page=False))
