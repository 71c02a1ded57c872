"""The chart of `estimators check`: error against CPU time of an estimator and the built-in ones of its stage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError
from ..folders.files import write_bytes
from ..laws.place import Place, Standing
from .charts import finished
from .layout import HEIGHT, log_domain, log_ticks, place_labels

__all__ = ["KINDS", "check_chart_path", "save_place", "text_chart"]

#: Endings of the file of a chart.
KINDS = (".png", ".html")
_WIDTH = 480
_FIT = (
    '<meta name="viewport" content="width=device-width, initial-scale=1">'
    "<style>#vega-chart { width: 100%; max-width: 900px; }</style>"
)


def check_chart_path(path: Path) -> None:
    """Refuse a file that is neither a picture nor a page. Raises InputError."""
    if path.suffix.lower() not in KINDS:
        raise InputError(
            "The chart is a picture or a page.", where="chart", value=str(path), allowed=" or ".join(KINDS)
        )


def text_chart(place: Place, *, width: int = 60, height: int = 14) -> list[str]:
    """The chart in lines of text, both axes logarithmic: * is the estimator, letters are the built-in ones in the order of their
    errors (a: the smallest). Of several at one place the first stands there."""
    shown = _shown(place)
    if not shown:
        return []
    cost, error = [math.log10(one.cpu_s) for one in shown], [math.log10(one.rmse) for one in shown]
    grid = [[" "] * width for _ in range(height)]
    letters = iter("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ")
    names = []
    marks = ["*" if one.own else next(letters) for one in shown]
    for one, mark, x, y in reversed(list(zip(shown, marks, cost, error, strict=True))):
        grid[_at(y, error, height)][_at(x, cost, width)] = mark
        names.append(f"{mark} {one.label}")
    left = [f"{10.0 ** max(error):.3g} {place.unit}", f"{10.0 ** min(error):.3g} {place.unit}"]
    wide = max(map(len, left))
    lines = []
    # The largest error is on top.
    for number, row in enumerate(reversed(grid)):
        label = left[0] if number == 0 else left[1] if number == height - 1 else ""
        lines.append(f"{label:>{wide}} |{''.join(row).rstrip()}")
    fast, slow = f"{10.0 ** min(cost):.2g} s", f"{10.0 ** max(cost):.2g} s CPU per element"
    lines.append(f"{'':{wide}} +{'-' * width}")
    lines.append(f"{'':{wide}}  {fast}{slow:>{max(width - len(fast), len(slow) + 1)}}")
    return [*lines, "  ".join(reversed(names))]


def save_place(place: Place, label: str, path: Path) -> None:
    """Write the chart as a picture (.png, 2 ×) or as a page that needs nothing else (.html). Raises InputError."""
    import altair as alt
    import vl_convert as vlc

    check_chart_path(path)
    page = path.suffix.lower() == ".html"
    title = f"{label} among the built-in estimators of its stage"
    size = {"width": "container" if page else _WIDTH, "height": HEIGHT, "title": title}
    spec = finished(alt.layer(*_layers(place)).properties(**size), page=False)
    if page:
        # The width of the window, and on a phone its true one.
        text = vlc.vegalite_to_html(spec, bundle=True)
        data = text.replace("<head>", f"<head>{_FIT}", 1).encode("utf-8")
    else:
        data = vlc.svg_to_png(vlc.vegalite_to_svg(spec), scale=2.0)
    write_bytes(path, data)


def _layers(place: Place) -> list[Any]:
    """Points, their names, placed so that none covers another, and the bound."""
    import altair as alt

    rows: list[dict[str, Any]] = [
        {
            "label": one.label,
            "text": one.label,
            "error": one.rmse,
            "cpu": 1e6 * one.cpu_s,
            "own": one.own,
            "front": one.own,
        }
        for one in _shown(place)
    ]
    cpus, errors = [row["cpu"] for row in rows] or [1.0], [row["error"] for row in rows] or [1.0]
    errors = errors + [place.bound] * (place.bound > 0)
    place_labels(rows, cpus, errors)
    (x0, x1), (y0, y1) = log_domain(cpus), log_domain(errors)
    base = alt.Chart(alt.InlineData(values=rows)).encode(
        x=alt.X("cpu:Q", title="CPU time of an element [µs]", scale=alt.Scale(type="log", domain=[x0, x1], nice=False),
                axis=alt.Axis(values=log_ticks(x0, x1), format="~g")),
        y=alt.Y("error:Q", title=f"rms error of {place.quantity} [{place.unit}]",
                scale=alt.Scale(type="log", domain=[y0, y1], nice=False),
                axis=alt.Axis(values=log_ticks(y0, y1), format="~g")),
        tooltip=["label:N", "error:Q", "cpu:Q"],
    )  # fmt: skip
    own = alt.condition("datum.own", alt.value("#c2410c"), alt.value("#475569"))
    points = base.mark_point(filled=True, opacity=1.0).encode(
        color=own, size=alt.condition("datum.own", alt.value(140), alt.value(50)),
        shape=alt.condition("datum.own", alt.value("diamond"), alt.value("circle")),
    )  # fmt: skip
    side: dict[str, Any] = {key: alt.expr(f"datum.{key}") for key in ("align", "dx", "dy")}
    texts = base.mark_text(baseline="middle", fontSize=10, **side).encode(text="text:N", color=own)
    layers: list[Any] = [points, texts]
    if place.bound > 0:
        line = alt.Chart(alt.InlineData(values=[{"error": place.bound}]))
        layers.append(line.mark_rule(strokeDash=[4, 3], color="#64748b").encode(y="error:Q"))
    return layers


def _shown(place: Place) -> list[Standing]:
    return [one for one in place.standings if one.status == "ok" and one.cpu_s > 0 and one.rmse > 0]


def _at(value: float, values: Sequence[float], size: int) -> int:
    """Cell of a value between the least and the greatest."""
    low, high = min(values), max(values)
    return 0 if high == low else round((value - low) / (high - low) * (size - 1))
