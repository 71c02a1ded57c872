"""The chart of speed against accuracy as a Vega-Lite spec (by Altair), per scene; and the look that all charts share."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...scenes.plain_text import plain_text
from ..folders.files import write_atomic, write_text
from .cell import Cell, common_noun
from .data import unit_scale
from .front import SUSPECT
from .layout import HEIGHT, WIDTH, log_domain, log_ticks, place_labels
from .styles import Style, styles_of
from .text import number, rate, span

if TYPE_CHECKING:
    import altair as alt

__all__ = [
    "CHOSEN",
    "chosen_opacity",
    "finished",
    "panel_title",
    "panels_of",
    "save_charts",
    "speed_accuracy_spec",
    "svg_of",
]

FRONT, BOUND, DOUBT, GROUND = "#D55E00", "#8a8f98", "#b00020", "var(--card)"
#: Marks of the verdicts before the names, in charts and tables.
VERDICT_MARKS = {"front": "◆ ", "undecided": "◇ ", SUSPECT: "⚠ "}
#: Parameter of every chart of the page: the label of the chosen estimator, "" for all. The page's script sets it.
CHOSEN = "chosen"


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


def speed_accuracy_spec(cells: list[Cell], *, page: bool, styles: Mapping[str, Style] | None = None) -> dict[str, Any]:
    """One panel: CPU time per element (x) against full RMSE (y), both logarithmic; lower left is better.

    Colour and mark tell the estimator, a filled mark the first condition. `page`: use the width of the container and the
    colours of the page; otherwise fixed width, dark on white. `styles`: of the page; by default those of the panel.
    """
    chart = _panel(cells, page=page, styles=styles or styles_of(c.label for c in cells))
    chart = chart.properties(width="container" if page else WIDTH, height=HEIGHT)
    return finished(chart, page=page)


def chosen_opacity(page: bool, shown: float = 1.0) -> Any:
    """Opacity that fades all but the chosen estimator; constant outside the page."""
    import altair as alt

    if not page:
        return alt.value(shown)
    return alt.condition(f"{CHOSEN} === '' || datum.label === {CHOSEN}", alt.value(shown), alt.value(0.12))


def _panel(cells: list[Cell], *, page: bool, styles: Mapping[str, Style]) -> Any:
    import altair as alt

    factor, unit = unit_scale(cells[0])
    drawn = [c for c in cells if c.ok and c.cpu_per_element_s > 0 and c.rmse_full > 0]
    conditions = sorted({c.condition for c in cells}, key=lambda name: (name != "matched", name))
    drawn.sort(key=lambda c: conditions.index(c.condition))
    bounds = [c.bound * factor for c in drawn if c.bound > 0]
    points = _points(drawn, factor, unit, conditions, styles, GROUND if page else "#ffffff")
    cpus = [p[k] for p in points for k in ("cpu", "cpu_lo", "cpu_hi") if p[k]]
    errors = [p[k] for p in points for k in ("error", "error_lo", "error_hi") if p[k]] + bounds
    place_labels(points, cpus, errors)
    base = alt.Chart(alt.InlineData(values=points))
    noun = common_noun(cells)
    x = alt.X("cpu:Q", title=f"CPU time per {noun}, ns", scale=_log_scale(cpus), axis=_log_axis(cpus))
    y = alt.Y("error:Q", title=f"RMSE of all {noun}s, {unit}", scale=_log_scale(errors), axis=_log_axis(errors))
    tips = [alt.Tooltip(f"{k}:N", title=t) for k, t in _TIPS.items()]
    own: dict[str, Any] = {
        "shape": alt.Shape("shape:N", scale=None), "fill": alt.Fill("fill:N", scale=None),
        "stroke": alt.Stroke("colour:N", scale=None),
    }  # fmt: skip
    layers = _bound_layers(bounds)
    for position, condition in enumerate(conditions):
        front = [p for p in points if p["front"] and p["condition"] == condition]
        line = alt.Chart(alt.InlineData(values=front)).mark_line(
            interpolate="step-after", color=BOUND, strokeWidth=1.3, opacity=0.9 if position == 0 else 0.4
        )
        layers.append(line.encode(x=x, y=y))
    for ends, across in (({"x": alt.X("cpu_lo:Q"), "x2": "cpu_hi:Q", "y": y}, "cpu_lo"),
                         ({"x": x, "y": alt.Y("error_lo:Q"), "y2": "error_hi:Q"}, "error_lo")):  # fmt: skip
        rules = base.transform_filter(f"isValid(datum.{across})").mark_rule(strokeWidth=1.6)
        layers.append(rules.encode(stroke=own["stroke"], opacity=chosen_opacity(page, 0.75), **ends))
    layers.append(
        base.mark_point(size=95, strokeWidth=2, cursor="pointer").encode(
            x=x, y=y, opacity=chosen_opacity(page), tooltip=tips, **own
        )
    )
    opacity = chosen_opacity(page)
    layers += [text.encode(x=x, y=y, text="text:N", tooltip=tips, opacity=opacity) for text in _label_marks(base, page)]
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


def _label_marks(base: Any, page: bool) -> list[Any]:
    """Each label twice: the first, in the background colour, keeps lines from crossing the letters of the second."""
    import altair as alt

    ground = GROUND if page else "#ffffff"
    place: dict[str, Any] = {side: alt.ExprRef(f"datum.{side}") for side in ("align", "dx", "dy")}
    halo: dict[str, Any] = {"stroke": ground, "strokeWidth": 4, "strokeJoin": "round"}
    return [base.mark_text(fontSize=11, baseline="middle", cursor="pointer", **place, **extra) for extra in (halo, {})]


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


def _log_scale(values: list[float]) -> alt.Scale:
    import altair as alt

    return alt.Scale(type="log", domain=list(log_domain(values)), nice=False) if values else alt.Scale(type="log")


def _log_axis(values: list[float]) -> alt.Axis:
    import altair as alt

    return alt.Axis(format="~g", values=log_ticks(*log_domain(values)), labelFlush=False) if values else alt.Axis()


def save_charts(cells: list[Cell], png: Path, svg: Path, styles: Mapping[str, Style]) -> str:
    """Write the speed-accuracy chart of all panels as PNG (2 ×) and SVG; returns the SVG's text.

    Raises:
        InputError: the files cannot be written.
    """
    import altair as alt
    import vl_convert as vlc

    panels = panels_of(cells)
    charts = [
        _panel(group, page=False, styles=styles).properties(
            width=WIDTH, height=HEIGHT, title=panel_title(panel, panels)
        )
        for panel, group in panels.items()
    ]
    spec = finished(alt.concat(*charts, columns=3), page=False)
    drawing = svg_of(spec)
    image: bytes = vlc.svg_to_png(drawing, scale=2.0)
    write_atomic(png, lambda path: _write(path, image))
    write_text(svg, drawing)
    return drawing


def _write(path: Path, data: bytes) -> None:
    path.write_bytes(data)


def svg_of(spec: dict[str, Any]) -> str:
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


def finished(chart: Any, *, page: bool) -> dict[str, Any]:
    """The spec of a chart with fonts and colours set: those of the page, or dark on white."""
    import altair as alt

    ink = "currentColor" if page else "#1d2330"
    font = (
        "system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif" if page else "DejaVu Sans, Arial, sans-serif"
    )
    if page:
        chart = chart.add_params(alt.param(name=CHOSEN, value=""))
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
