"""The picture of a design: bounds of all designs, and the chosen one over the curve of its modality."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..folders.files import write_bytes
from ..report.charts import finished

if TYPE_CHECKING:
    from .result import Designed

__all__ = ["save_design"]

_CHOSEN, _OTHER, _OWN = "#c2410c", "#94a3b8", "#1d4ed8"


def save_design(found: Designed, path: Path) -> None:
    """Write the picture as PNG, 2 ×. Raises InputError."""
    import altair as alt
    import vl_convert as vlc

    chart = alt.vconcat(_bounds(found), _curve(found)).resolve_scale(color="independent")
    data = vlc.svg_to_png(vlc.vegalite_to_svg(finished(chart, page=False)), scale=2.0)
    write_bytes(path, data)


def _bounds(found: Designed) -> Any:
    import altair as alt

    rows = [
        {
            "design": one.name, "bound": found.factor * one.bound,
            "kind": "chosen" if one is found.best else "the scene's own" if one is found.own
            else "allowed" if one.allowed else "not allowed",
        }
        for one in found.options
        if math.isfinite(one.bound)
    ]  # fmt: skip
    colour = alt.Scale(
        domain=["chosen", "the scene's own", "allowed", "not allowed"], range=[_CHOSEN, _OWN, "#475569", _OTHER]
    )
    base = alt.Chart(alt.InlineData(values=rows)).encode(
        x=alt.X(
            "bound:Q",
            scale=alt.Scale(type="log", nice=False, padding=20),
            title=f"rms bound of {found.quantity} [{found.unit}]",
        ),
        y=alt.Y("design:N", sort=None, title=None, axis=alt.Axis(labelLimit=260)),
        color=alt.Color("kind:N", scale=colour, title=None),
    )
    points = base.mark_point(filled=True, size=70, opacity=1.0).encode(
        shape=alt.Shape("kind:N", scale=alt.Scale(
            domain=["chosen", "the scene's own", "allowed", "not allowed"], range=["diamond", "square", "circle", "cross"],
        ), legend=None),
    )  # fmt: skip
    title = f"{found.scene}: {found.gain:.2f} times below the scene's own design"
    return points.properties(width=460, height=14 * len(rows) + 20, title=title)


def _curve(found: Designed) -> Any:
    import altair as alt

    curve = found.curve
    line = alt.Chart(
        alt.InlineData(values=[{"x": float(x), "y": float(y)} for x, y in zip(curve.x, curve.y, strict=True)])
    )
    layers: list[Any] = [
        line.mark_line(color="#0f172a").encode(
            x=alt.X("x:Q", title=curve.x_title, scale=alt.Scale(zero=False)), y=alt.Y("y:Q", title=curve.y_title)
        )
    ]
    for name, places in curve.marks.items():
        own = name == found.own.name
        marks = [{"x": float(place), "design": name} for place in places]
        rule = alt.Chart(alt.InlineData(values=marks)).mark_tick(
            color=_OWN if own else _CHOSEN, thickness=1.5, size=14 if own else 26
        )
        layers.append(rule.encode(x="x:Q", y=alt.value(212 if own else 190)))
    return alt.layer(*layers).properties(width=460, height=220)
