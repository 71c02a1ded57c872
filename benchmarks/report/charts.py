"""The report's charts as Vega-Lite specs (by Altair): speed against accuracy per scene, failures against stress."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..folders.files import write_atomic, write_text
from .data import Cell, unit_scale
from .front import SUSPECT
from .layout import HEIGHT, WIDTH, log_domain, log_ticks, place_labels
from .text import number, rate, span

if TYPE_CHECKING:
    import altair as alt

__all__ = ["panel_title", "panels_of", "save_charts", "speed_accuracy_spec", "stress_groups", "stress_spec"]

#: Okabe and Ito (2008), without black and yellow: distinguishable by the colour-blind, on white and on dark.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
FRONT, OTHER, BOUND, GROUND = "#D55E00", "#5b8db8", "#8a8f98", "var(--card)"
VERDICTS = ("front", "undecided", "dominated")
SHAPES = ("circle", "triangle-up", "square", "diamond", "cross", "triangle-down")


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


def speed_accuracy_spec(cells: list[Cell], *, page: bool) -> dict[str, Any]:
    """One panel: CPU time per element (x) against full RMSE (y), both logarithmic; lower left is better.

    `page`: use the width of the container and the colours of the page; otherwise fixed width, dark on white.
    """

    chart = _panel(cells, page=page)
    chart = chart.properties(width="container" if page else WIDTH, height=HEIGHT)
    return finished(chart, page=page)


def _panel(cells: list[Cell], *, page: bool) -> Any:
    import altair as alt

    factor, unit = unit_scale(cells[0])
    drawn = [c for c in cells if c.ok and c.cpu_per_element_s > 0 and c.rmse_full > 0]
    conditions = sorted({c.condition for c in cells}, key=lambda name: (name != "matched", name))
    drawn.sort(key=lambda c: conditions.index(c.condition))
    bounds = [c.bound * factor for c in drawn if c.bound > 0]
    points = _points(drawn, factor, unit)
    cpus = [p[k] for p in points for k in ("cpu", "cpu_lo", "cpu_hi") if p[k]]
    errors = [p[k] for p in points for k in ("error", "error_lo", "error_hi") if p[k]] + bounds
    place_labels(points, cpus, errors)
    data = alt.InlineData(values=points)
    noun = cells[0].noun
    x = alt.X("cpu:Q", title=f"CPU time per {noun}, ns", scale=_log_scale(cpus), axis=_log_axis(cpus))
    y = alt.Y(
        "error:Q",
        title=f"RMSE of all {noun}s, {unit}",
        scale=_log_scale(errors),
        axis=_log_axis(errors),
    )
    tips = [alt.Tooltip(f"{k}:N", title=t) for k, t in _TIPS.items()]
    shape = alt.Shape(
        "condition:N",
        scale=alt.Scale(domain=conditions, range=list(SHAPES[: len(conditions)])),
        legend=alt.Legend(title=None, orient="top", symbolFillColor=OTHER, symbolStrokeWidth=0)
        if len(conditions) > 1
        else None,
    )
    ground = GROUND if page else "#ffffff"
    # The text of the page explains the marks.
    legend = None if page else alt.Legend(title=None, orient="top", symbolStrokeWidth=2)
    doubt = any(c.verdict == SUSPECT for c in drawn)
    domain = [*VERDICTS, *([SUSPECT] if doubt else [])]
    fills, strokes = ([FRONT, inner, OTHER, "#b00020"][: len(domain)] for inner in (ground, FRONT))
    fill = alt.Fill("verdict:N", scale=alt.Scale(domain=domain, range=fills), legend=legend)
    stroke = alt.Stroke("verdict:N", scale=alt.Scale(domain=domain, range=strokes), legend=legend)
    layers = _bound_layers(bounds)
    for position, condition in enumerate(conditions):
        front = [p for p in points if p["front"] and p["condition"] == condition]
        line = alt.Chart(alt.InlineData(values=front)).mark_line(
            interpolate="step-after", color=FRONT, strokeWidth=1.3, opacity=0.65 if position == 0 else 0.25
        )
        layers.append(line.encode(x=x, y=y))
    base = alt.Chart(data)
    for ends, across in (({"x": alt.X("cpu_lo:Q"), "x2": "cpu_hi:Q", "y": y}, "cpu_lo"),
                         ({"x": x, "y": alt.Y("error_lo:Q"), "y2": "error_hi:Q"}, "error_lo")):  # fmt: skip
        rules = base.transform_filter(f"isValid(datum.{across})").mark_rule(strokeWidth=1.6, opacity=0.75)
        layers.append(rules.encode(stroke=stroke, **ends))
    layers.append(
        base.mark_point(size=95, opacity=1, strokeWidth=2).encode(
            x=x, y=y, fill=fill, stroke=stroke, shape=shape, tooltip=tips
        )
    )
    layers += [text.encode(x=x, y=y, text="text:N", tooltip=tips) for text in _label_marks(base, ground)]
    return alt.layer(*layers)


def _bound_layers(bounds: list[float]) -> list[Any]:
    """The dashed line of the bound with its name; none without a bound."""
    import altair as alt

    if not bounds:
        return []
    rule = alt.InlineData(values=[{"bound": sorted(bounds)[len(bounds) // 2], "text": "bound"}])
    at = alt.Y("bound:Q")
    return [
        alt.Chart(rule).mark_rule(strokeDash=[5, 4], color=BOUND, strokeWidth=1.2).encode(y=at),
        alt.Chart(rule)
        .mark_text(align="left", baseline="bottom", dx=4, dy=-3, fontSize=10, fontStyle="italic", color=BOUND)
        .encode(y=at, x=alt.value(0), text="text:N"),
    ]


def _label_marks(base: Any, ground: str) -> list[Any]:
    """Each label twice: the first, in the background colour, keeps lines from crossing the letters of the second."""
    import altair as alt

    place: dict[str, Any] = {side: alt.ExprRef(f"datum.{side}") for side in ("align", "dx", "dy")}
    halo: dict[str, Any] = {"stroke": ground, "strokeWidth": 4, "strokeJoin": "round"}
    return [base.mark_text(fontSize=11, baseline="middle", **place, **extra) for extra in (halo, {})]


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


def _points(cells: list[Cell], factor: float, unit: str) -> list[dict[str, Any]]:
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
            "text": c.label
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


def _log_scale(values: list[float]) -> alt.Scale:
    import altair as alt

    return alt.Scale(type="log", domain=list(log_domain(values)), nice=False) if values else alt.Scale(type="log")


def _log_axis(values: list[float]) -> alt.Axis:
    import altair as alt

    return alt.Axis(format="~g", values=log_ticks(*log_domain(values)), labelFlush=False) if values else alt.Axis()


def stress_groups(cells: list[Cell]) -> dict[tuple[str, str, str], list[Cell]]:
    """Stressed cells by (scene, condition, axis), where an axis has at least two levels."""
    groups: dict[tuple[str, str, str], list[Cell]] = {}
    for cell in cells:
        if cell.stressed and not cell.stress2 and not cell.mixed:
            groups.setdefault((cell.scene, cell.condition, cell.stress), []).append(cell)
    return {key: group for key, group in groups.items() if len({c.level for c in group}) > 1}


def stress_spec(cells: list[Cell], *, page: bool) -> dict[str, Any]:
    """Share of failed elements (y) against stress level (x), one line per estimator; a crash counts as 100 %."""
    import altair as alt

    labels = list(dict.fromkeys(c.label for c in cells))
    numeric = all(_is_number(c.level) for c in cells)
    cells = [c for c in cells if not c.skipped]
    rows = [
        {
            "level": float(c.level) if numeric else c.level,
            "failed": c.failure_rate if c.ok else 1.0,
            "label": c.label,
            "shown": rate(c.failure_rate) if c.ok else c.status,
        }
        for c in cells
    ]
    colours = [PALETTE[i % len(PALETTE)] for i in range(len(labels))]
    shapes = [SHAPES[(i + i // len(PALETTE)) % len(SHAPES)] for i in range(len(labels))]
    legend = alt.Legend(title=None, orient="bottom", columns=3, labelLimit=150)
    chart = (
        alt.Chart(alt.InlineData(values=rows))
        .mark_line(point=alt.OverlayMarkDef(size=60, filled=True), strokeWidth=1.6)
        .encode(
            x=alt.X("level:Q" if numeric else "level:O", title=cells[0].stress),
            y=alt.Y(
                "failed:Q", title=f"failed {cells[0].noun}s", axis=alt.Axis(format="%"), scale=alt.Scale(domain=[0, 1])
            ),
            color=alt.Color("label:N", scale=alt.Scale(domain=labels, range=colours), legend=legend),
            shape=alt.Shape("label:N", scale=alt.Scale(domain=labels, range=shapes), legend=legend),
            tooltip=[
                alt.Tooltip("label:N", title="estimator"),
                alt.Tooltip("level:Q" if numeric else "level:N", title=cells[0].stress),
                alt.Tooltip("shown:N", title="failed"),
            ],
        )
        .properties(width="container" if page else WIDTH, height=HEIGHT)
    )
    return finished(chart, page=page)


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def save_charts(cells: list[Cell], png: Path, svg: Path) -> str:
    """Write the speed-accuracy chart of all panels as PNG (2 ×) and SVG; returns the SVG's text.

    Raises:
        InputError: the files cannot be written.
    """
    import altair as alt
    import vl_convert as vlc

    panels = panels_of(cells)
    charts = [
        _panel(group, page=False).properties(width=WIDTH, height=HEIGHT, title=panel_title(panel, panels))
        for panel, group in panels.items()
    ]
    spec = finished(alt.concat(*charts, columns=3).resolve_scale(shape="independent"), page=False)
    drawing: str = vlc.vegalite_to_svg(spec)
    image: bytes = vlc.svg_to_png(drawing, scale=2.0)
    write_atomic(png, lambda path: _write(path, image))
    write_text(svg, drawing)
    return drawing


def _write(path: Path, data: bytes) -> None:
    path.write_bytes(data)


def finished(chart: Any, *, page: bool) -> dict[str, Any]:
    """The spec of a chart with fonts and colours set: those of the page, or dark on white."""
    ink = "currentColor" if page else "#1d2330"
    font = (
        "system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif" if page else "DejaVu Sans, Arial, sans-serif"
    )
    chart = chart.configure(background="transparent" if page else "#ffffff", font=font)
    chart = chart.configure_view(stroke=None)
    chart = chart.configure_axis(
        labelColor=ink,
        titleColor=ink,
        tickColor=ink,
        domainColor=ink,
        gridColor=ink,
        gridOpacity=0.1,
        domainOpacity=0.4,
        tickOpacity=0.4,
        labelOpacity=0.8,
        titleFontWeight="normal",
        titleOpacity=0.9,
        labelFontSize=11,
        titleFontSize=12,
    )
    chart = chart.configure_legend(labelColor=ink, titleColor=ink, labelFontSize=11)
    chart = chart.configure_title(color=ink, fontSize=13, anchor="start", fontWeight=600)
    chart = chart.configure_text(color=ink)
    spec: dict[str, Any] = _finite(chart.to_dict())
    return spec


def _finite(value: Any) -> Any:
    """The same data with null for numbers that are none: a share of no elements is shown as a gap."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
