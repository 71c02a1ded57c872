"""The chart of `estimators check`: error against CPU time of an estimator and the built-in ones of its stage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError
from ..folders.files import write_atomic
from ..laws.place import Place, Standing
from .charts import finished

__all__ = ["KINDS", "check_chart_path", "save_place", "text_chart"]

#: Endings of the file of a chart.
KINDS = (".png", ".html")
_WIDTH, _HEIGHT = 480, 320


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
    rows = [{"estimator": one.label, "error": one.rmse, "time": one.cpu_s, "own": one.own} for one in _shown(place)]
    title = f"{label} among the built-in estimators of its stage"
    base = alt.Chart(alt.InlineData(values=rows)).encode(
        x=alt.X("time:Q", scale=alt.Scale(type="log"), title="CPU time of an element [s]"),
        y=alt.Y("error:Q", scale=alt.Scale(type="log"), title=f"rms error of {place.quantity} [{place.unit}]"),
        tooltip=["estimator:N", "error:Q", "time:Q"],
    )
    own = alt.condition("datum.own", alt.value("#c2410c"), alt.value("#475569"))
    points = base.mark_point(filled=True, opacity=1.0).encode(
        color=own, size=alt.condition("datum.own", alt.value(140), alt.value(50)),
        shape=alt.condition("datum.own", alt.value("diamond"), alt.value("circle")),
    )  # fmt: skip
    texts = base.mark_text(align="left", dx=7, fontSize=10).encode(text="estimator:N", color=own)
    layers: list[Any] = [points, texts]
    if place.bound > 0:
        line = alt.Chart(alt.InlineData(values=[{"bound": place.bound, "what": "bound"}]))
        layers.append(line.mark_rule(strokeDash=[4, 3], color="#64748b").encode(y="bound:Q"))
    spec = finished(alt.layer(*layers).properties(width=_WIDTH, height=_HEIGHT, title=title), page=False)
    if path.suffix.lower() == ".png":
        data = vlc.svg_to_png(vlc.vegalite_to_svg(spec), scale=2.0)
    else:
        data = vlc.vegalite_to_html(spec, bundle=True).encode("utf-8")
    write_atomic(path, lambda file: _write(file, data))


def _write(path: Path, data: bytes) -> None:
    path.write_bytes(data)


def _shown(place: Place) -> list[Standing]:
    return [one for one in place.standings if one.status == "ok" and one.cpu_s > 0 and one.rmse > 0]


def _at(value: float, values: Sequence[float], size: int) -> int:
    """Cell of a value between the least and the greatest."""
    low, high = min(values), max(values)
    return 0 if high == low else round((value - low) / (high - low) * (size - 1))
