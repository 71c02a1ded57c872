"""The chart of error against cost: every rung and scene at the strictest limit, by medium."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..statistics.front import front

__all__ = ["chart_points", "write_chart"]

#: Errors below this are drawn at this value, so that intervals that end at zero fit a logarithmic axis.
_FLOOR = 3e-4
#: The CPU time of a single run is assumed accurate within this factor.
_COST_FACTOR = 1.25
_COLOURS = {"direct": "#c2410c", "scatter": "#2563eb", "full": "#15803d"}
_MEDIA = ("air", "faint", "clear", "coastal", "harbour")


def chart_points(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One point for each scene and rung at the strictest limit measured, with its verdict among the rungs of the scene:
    "front", "dominated" or "undecided"."""
    fractions = [row for row in rows if str(row["rtol"]) != "noise"]
    finest = min((float(row["rtol"]) for row in fractions), default=0.0)
    scenes: dict[str, list[dict[str, Any]]] = {}
    for row in fractions:
        if float(row["rtol"]) == finest:
            scenes.setdefault(row["scene"], []).append(row)
    points = []
    for name, mine in scenes.items():
        cost, error = [row["cpu_s"] for row in mine], [row["rel_error"] for row in mine]
        verdicts = front(
            cost, [c / _COST_FACTOR for c in cost], [c * _COST_FACTOR for c in cost], error,
            [min(row["lo"], row["rel_error"]) for row in mine], [max(row["hi"], row["rel_error"]) for row in mine],
        )  # fmt: skip
        for row, place in zip(mine, verdicts, strict=True):
            points.append(
                {
                    "medium": name.split("-")[0], "scene": name, "rung": row["rung"], "cost": row["cpu_s"],
                    "error": max(row["rel_error"], _FLOOR), "low": max(row["lo"], _FLOOR), "high": max(row["hi"], _FLOOR),
                    "place": place,
                }
            )  # fmt: skip
    return points


def write_chart(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Write the chart; both axes are logarithmic, bars are 95 % intervals of the error due to noise of the references."""
    import altair as alt
    import pandas as pd

    points = chart_points(rows)
    if not points:
        return
    media = [m for m in _MEDIA if any(p["medium"] == m for p in points)]
    costs = [p["cost"] for p in points]
    x = alt.X("cost:Q", title="CPU time [s]", axis=alt.Axis(values=[1e-3, 1e-2, 1e-1, 1, 10, 100], format="~g"))
    x = x.scale(type="log", domain=[0.7 * min(costs), 1.4 * max(costs)], nice=False)
    axis = alt.Axis(values=[1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 3e-1, 1], format="~%")
    y = alt.Y("error:Q", title="relative error ε of the stack", axis=axis).scale(
        type="log", domain=[_FLOOR, 1.2], clamp=True
    )
    colour = alt.Color("rung:N", title="rung").scale(domain=list(_COLOURS), range=list(_COLOURS.values()))
    shape = alt.Shape("place:N", title="among the scene's rungs").scale(
        domain=["front", "undecided", "dominated"], range=["circle", "triangle-up", "cross"]
    )
    panels = []
    for number, medium in enumerate(media):
        mine = [p for p in points if p["medium"] == medium]
        base = alt.Chart(pd.DataFrame(mine))
        bars = (
            base.mark_rule(opacity=0.5)
            .encode(x=x, y=y, y2="high:Q", color=colour)
            .transform_calculate(error="datum.low")
        )
        dots = base.mark_point(filled=True, size=55, opacity=0.85).encode(x=x, y=y, color=colour, shape=shape)
        if number:
            bars, dots = (c.encode(y=y.title(None)) for c in (bars, dots))
        panels.append((bars + dots).properties(width=200, height=260, title=medium))
    chart = alt.hconcat(*panels).configure_view(stroke="#ccc").configure_axis(gridColor="#eee", labelFontSize=11)
    chart.save(str(path))
