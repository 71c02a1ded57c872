"""Breakdown in words and pictures: the table of breakdown.csv, and one picture per stress of the failure map."""

from __future__ import annotations

import base64
import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..folders.files import write_bytes, write_text
from .charts import finished, svg_of
from .numbers import rate
from .styles import Style, styles_of

__all__ = ["TABLE_HEAD", "breakdown_table", "curve_name", "page_section", "read_breakdown", "save_maps"]

TABLE_HEAD = (
    "estimator", "condition", "stress", "unit", "10 % fail at", "50 % fail at", "mode", "float32 / 64", "+1 DN",
)  # fmt: skip

_CELLS = Mapping[tuple[str, str, str], Sequence[tuple[float, float, float, float]]]


def read_breakdown(folder: Path) -> list[dict[str, Any]]:
    """The rows of breakdown.csv in the folder of a run; empty without such a file."""
    path = folder / "breakdown.csv"
    if not path.is_file():
        return []
    with open(path, newline="", encoding="utf-8") as file:
        rows: list[dict[str, Any]] = [dict(row) for row in csv.DictReader(file)]
    for row in rows:
        for name in ("level10", "lo", "hi", "level50", "lo50", "hi50", "float32_vs_64", "gain_1dn"):
            row[name] = float(row[name]) if row.get(name) else math.nan
    return rows


def _level(level: float, low: float, high: float) -> str:
    """`0.12 [0.11, 0.13]`; an open end where the range of levels is too small."""
    if all(map(math.isnan, (level, low, high))):
        return "–"
    if math.isnan(high) and math.isnan(level):
        return f"over {low:.3g}"
    if math.isnan(low) and math.isnan(level):
        return f"under {high:.3g}"
    shown = "–" if math.isnan(level) else f"{level:.3g}"
    ends = ["…" if math.isnan(end) else f"{end:.3g}" for end in (low, high)]
    return f"{shown} [{ends[0]}, {ends[1]}]"


def _change(value: float) -> str:
    return "–" if math.isnan(value) else "0" if value == 0 else f"{value:.2g}"


def breakdown_table(rows: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """The rows as text, in the columns of `TABLE_HEAD`; changes are in bounds."""
    return [
        [
            str(row["estimator"]), str(row.get("condition", "")), str(row["axis"]), str(row["unit"]),
            _level(row["level10"], row["lo"], row["hi"]), _level(row["level50"], row["lo50"], row["hi50"]),
            str(row["mode"]), _change(row["float32_vs_64"]), _change(row["gain_1dn"]),
        ]
        for row in rows
    ]  # fmt: skip


def page_section(folder: Path) -> dict[str, Any] | None:
    """Breakdown section of the page: heading, table and pictures; None where the run has no such table."""
    rows = read_breakdown(folder)
    maps = sorted((folder / "maps").glob("*.svg")) if (folder / "maps").is_dir() else []
    if not rows and not maps:
        return None
    pictures = [
        {"name": path.stem, "uri": "data:image/svg+xml;base64," + base64.b64encode(path.read_bytes()).decode()}
        for path in maps
    ]
    return {"head": TABLE_HEAD, "rows": breakdown_table(rows), "pictures": pictures}


def save_maps(
    folder: Path, maps: Sequence[Mapping[str, Any]], rows: Sequence[Mapping[str, Any]], cells: _CELLS
) -> list[Path]:
    """Write maps/<axis>.svg and .png for every stress: failure rate against level, or a heat map over two axes.

    Main arguments:
        maps: rows of failure_map.csv. rows: of breakdown.csv. cells: of the grids, by (estimator, axis, axis2), where the
        estimator is named as `curve_name` does it.
    """
    import vl_convert as vlc

    maps, rows = _named(maps), _named(rows)
    styles = styles_of(row["label"] for row in maps)  # as the page colours them
    place = folder / "maps"
    place.mkdir(exist_ok=True)
    written = []
    for axis, axis2 in dict.fromkeys((str(row["axis"]), str(row["axis2"])) for row in maps):
        group = [row for row in maps if (row["axis"], row["axis2"]) == (axis, axis2)]
        pooled = _pooled(group)
        if axis2 == "none":
            spec = _curves(pooled, [row for row in rows if row["axis"] == axis], styles)
        else:
            spec = _heat(pooled, {key[0]: found for key, found in cells.items() if key[1:] == (axis, axis2)})
        name = axis if axis2 == "none" else f"{axis}--{axis2}"
        path = place / f"{''.join(c if c.isalnum() or c in '._-' else '-' for c in name)}.svg"
        drawing = svg_of(spec)
        image: bytes = vlc.svg_to_png(drawing, scale=2.0)
        write_text(path, drawing)
        write_bytes(path.with_suffix(".png"), image)
        written.append(path)
    return written


def curve_name(estimator: str, condition: str) -> str:
    """Name of an estimator in pictures; a condition other than the default is added."""
    return estimator if condition in ("", "matched") else f"{estimator} ({condition})"


def _named(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows with the names of curves in place of the estimators', which stay as `label`."""
    return [
        {
            **row,
            "label": str(row["estimator"]),
            "estimator": curve_name(str(row["estimator"]), str(row.get("condition", ""))),
        }
        for row in rows
    ]


def _pooled(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """One row per estimator and point; with several scenes the row over all scenes."""
    several = any(row["scene"] == "all" for row in rows)
    return [dict(row) for row in rows if not several or row["scene"] == "all"]


def _title(axis: str, unit: str) -> str:
    return axis if unit == "1" else f"{axis}, {unit}"


def _scale(values: Sequence[float]) -> Any:
    import altair as alt

    from ..statistics.levels import is_log

    return alt.Scale(type="log" if is_log(values) else "linear", zero=False, nice=False)


def _axis(values: Sequence[float]) -> Any:
    """Plain numbers where they are short, otherwise powers of ten."""
    import altair as alt

    from ..statistics.levels import is_log

    largest = max(abs(value) for value in values)
    form = "~e" if largest >= 1e5 or largest < 1e-3 else "~g"
    if not is_log(values):
        return alt.Axis(format=form, tickCount=6)
    first, last = math.ceil(math.log10(min(values)) - 1e-9), math.floor(math.log10(max(values)) + 1e-9)
    decades = [10.0**k for k in range(first, last + 1)]
    return alt.Axis(format=form, values=decades) if len(decades) > 1 else alt.Axis(format=form)


def _curves(
    points: list[dict[str, Any]], rows: Sequence[Mapping[str, Any]], styles: Mapping[str, Style]
) -> dict[str, Any]:
    """Failure rate with its interval at every measured level, and the intervals of the 10 % and 50 % levels.

    Colour and mark are the estimator's; the curve of a condition other than the default is dashed.
    """
    import altair as alt

    names = {str(p["estimator"]): str(p["label"]) for p in points}
    labels = list(names)
    colours, shapes = ([styles[names[name]][part] for name in labels] for part in (0, 1))
    dashes = [[1, 0] if names[name] == name else [5, 3] for name in labels]
    legend = alt.Legend(title=None, orient="bottom", columns=3, labelLimit=220)
    colour = alt.Color("estimator:N", scale=alt.Scale(domain=labels, range=colours), legend=legend)
    shape = alt.Shape("estimator:N", scale=alt.Scale(domain=labels, range=shapes), legend=legend)
    dash = alt.StrokeDash("estimator:N", scale=alt.Scale(domain=labels, range=dashes), legend=legend)
    x = alt.X(
        "level:Q", title=_title(points[0]["axis"], points[0]["unit"]), scale=_scale([p["level"] for p in points]),
        axis=_axis([p["level"] for p in points]),
    )  # fmt: skip
    y = alt.Y("failure_rate:Q", title="failed", axis=alt.Axis(format="%"), scale=alt.Scale(domain=[0, 1]))
    plain = [{k: p[k] for k in ("estimator", "level", "failure_rate", "lo", "hi")} for p in points]
    base = alt.Chart(alt.InlineData(values=plain))
    layers: list[Any] = [
        base.mark_line(strokeWidth=1.4, opacity=0.7).encode(x=x, y=y, color=colour, strokeDash=dash),
        base.mark_rule(strokeWidth=1).encode(x=x, y=alt.Y("lo:Q"), y2="hi:Q", color=colour),
        base.mark_point(filled=True, size=45, opacity=1).encode(x=x, y=y, color=colour, shape=shape),
    ]
    edges = [
        {"estimator": str(row["estimator"]), "from": row[a], "to": row[b], "target": target}
        for row in rows
        for a, b, target in (("lo", "hi", 0.1), ("lo50", "hi50", 0.5))
        if not (math.isnan(row[a]) or math.isnan(row[b]))
    ]
    if edges:
        bars = alt.Chart(alt.InlineData(values=edges)).mark_rule(strokeWidth=5, opacity=0.45)
        layers.append(bars.encode(x=alt.X("from:Q"), x2="to:Q", y=alt.Y("target:Q"), color=colour))
    return finished(alt.layer(*layers).properties(width=520, height=300), page=False)


def _heat(points: list[dict[str, Any]], cells: Mapping[str, Sequence[tuple[float, ...]]]) -> dict[str, Any]:
    """One panel per estimator: cells coloured by the mean rate of their measured corners, and the measured points."""
    import altair as alt

    x_scale, y_scale = _scale([p["level"] for p in points]), _scale([p["level2"] for p in points])
    x_axis, y_axis = _axis([p["level"] for p in points]), _axis([p["level2"] for p in points])
    colour = alt.Color(
        "rate:Q", title="failed", scale=alt.Scale(scheme="viridis", domain=[0, 1]), legend=alt.Legend(format="%")
    )
    panels = []
    for label in dict.fromkeys(str(p["estimator"]) for p in points):
        mine = {(p["level"], p["level2"]): p["failure_rate"] for p in points if p["estimator"] == label}
        rectangles = [
            {"x": a, "x2": b, "y": c, "y2": d, "rate": sum(mine[s, t] for s in (a, b) for t in (c, d)) / 4}
            for a, b, c, d in cells[label]
        ]
        dots = [{"x": s, "y": t, "shown": rate(value)} for (s, t), value in mine.items()]
        x = alt.X("x:Q", title=_title(points[0]["axis"], points[0]["unit"]), scale=x_scale, axis=x_axis)
        y = alt.Y("y:Q", title=_title(points[0]["axis2"], points[0]["unit2"]), scale=y_scale, axis=y_axis)
        rect = alt.Chart(alt.InlineData(values=rectangles)).mark_rect(strokeWidth=0)
        dot = alt.Chart(alt.InlineData(values=dots)).mark_circle(size=8, color="#ffffff", opacity=0.8)
        layered = alt.layer(rect.encode(x=x, x2="x2:Q", y=y, y2="y2:Q", color=colour), dot.encode(x=x, y=y))
        panels.append(layered.properties(width=280, height=260, title=label))
    return finished(alt.concat(*panels, columns=3), page=False)
