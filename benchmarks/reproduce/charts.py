"""Charts of the page: Figures 2, 3, 4, 6, 7 and Table 1, by Altair and vl-convert."""

from __future__ import annotations

from typing import Any

__all__ = ["chart_svgs"]

#: Okabe and Ito (2008): distinguishable by the colour-blind.
_COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00"]
_WIDTH, _HEIGHT = 430, 260


def chart_svgs() -> dict[str, str]:
    """SVG text by item."""
    import vl_convert as vlc

    charts = {
        "Figure 2": _figure_2(), "Figure 3": _figure_3(), "Figure 4": _figure_4(), "Figure 6": _figure_6(),
        "Figure 7": _figure_7(), "Table 1": _table_1(),
    }  # fmt: skip
    return {item: vlc.vegalite_to_svg(_finished(chart)) for item, chart in charts.items()}


def _data(points: list[dict[str, Any]]) -> Any:
    import altair as alt

    return alt.Chart(alt.InlineData(values=points))


def _colour(name: str, points: list[dict[str, Any]]) -> Any:
    import altair as alt

    domain = list(dict.fromkeys(p[name] for p in points))
    legend = alt.Legend(title=None, orient="bottom", columns=2, labelLimit=320)
    return alt.Color(f"{name}:N", scale=alt.Scale(domain=domain, range=_COLOURS[: len(domain)]), legend=legend)


def _figure_2() -> Any:
    import altair as alt

    from .surfaces import figure_2_curves

    points = figure_2_curves()
    return _data(points).mark_line(strokeWidth=1.8).encode(
        x=alt.X("angle:Q", title="angle of incidence, degrees"), y=alt.Y("value:Q", title="Eq. 4, K_S + K_D = 1"),
        color=_colour("surface", points),
    )  # fmt: skip


def _figure_3() -> Any:
    import altair as alt

    from .reflection import figure_3_points

    points = figure_3_points()
    x = alt.X("surface:N", title=None, sort=None, axis=alt.Axis(labelAngle=0))
    bars = _data(points).mark_bar(size=46, color=_COLOURS[0], opacity=0.85).encode(
        x=x, y=alt.Y("error:Q", title="mean |range error| of 30, mm"))  # fmt: skip
    ticks = _data(points).mark_tick(color=_COLOURS[1], thickness=3, width=60).encode(x=x, y="expected:Q")
    return alt.layer(bars, ticks)


def _figure_4() -> Any:
    import altair as alt

    from .reflection import figure_4_points

    points = figure_4_points()
    x = alt.X("angle:Q", title="angle of incidence, degrees")
    colour = _colour("surface", points)
    dots = _data(points).mark_point(filled=True, size=60, opacity=1).encode(
        x=x, y=alt.Y("error:Q", title="mean |range error| of 30, mm", scale=alt.Scale(type="log")), color=colour)  # fmt: skip
    return alt.layer(
        _data(points).mark_line(strokeWidth=1.2, opacity=0.6).encode(x=x, y="expected:Q", color=colour), dots
    )


def _figure_6() -> Any:
    import altair as alt

    from .illumination import figure_6_curves

    points = figure_6_curves()
    return _data(points).mark_line(strokeWidth=1.8).encode(
        x=alt.X("radius:Q", title="radius in the image over the corner's"),
        y=alt.Y("value:Q", title="light on a flat wall over that at the centre"), color=_colour("profile", points),
    )  # fmt: skip


def _figure_7() -> Any:
    import altair as alt

    from .deviation import figure_7_points

    points = figure_7_points()
    x = alt.X("angle:Q", title="angle of incidence, degrees")
    scale = alt.Scale(type="symlog", constant=1, domain=[-300, 6000])
    y = alt.Y("deviation:Q", title="deviation from 5 m, mm (symlog)", scale=scale,
              axis=alt.Axis(values=[-100, -10, 0, 10, 100, 1000, 5000]))  # fmt: skip
    colour = _colour("kind", points)
    line = _data(points).mark_line(strokeWidth=1.2, opacity=0.6).encode(x=x, y=y, color=colour)
    return alt.layer(line, _data(points).mark_point(filled=True, size=60, opacity=1).encode(x=x, y=y, color=colour))


def _table_1() -> Any:
    import altair as alt

    from .table_1 import table_1_points

    points = table_1_points()
    y = alt.Y("reading:N", title=None, sort=None, axis=alt.Axis(labelLimit=260))
    scale = alt.Scale(type="symlog", constant=1, domain=[0, 160])
    x = alt.X("low:Q", title="|depth error|, % of the depth (symlog)", scale=scale,
              axis=alt.Axis(values=[0, 1, 2, 5, 10, 20, 50, 100]))  # fmt: skip
    parts = []
    for name in ("Object 1", "Object 2"):
        mine = _data([p for p in points if p["object"] == name])
        bars = mine.mark_bar(height=9, color=_COLOURS[0], opacity=0.45).encode(x=x, x2="high:Q", y=y)
        middle = mine.mark_tick(color=_COLOURS[0], thickness=2.5, height=13).encode(x="median:Q", y=y)
        printed = mine.mark_point(filled=True, color=_COLOURS[1], shape="diamond", size=80, opacity=1)
        chart = alt.layer(bars, middle, printed.encode(x="published:Q", y=y))
        parts.append(chart.properties(width=_WIDTH, height=190, title=name))
    return alt.vconcat(*parts)


def _finished(chart: Any) -> dict[str, Any]:
    import altair as alt

    if not isinstance(chart, alt.VConcatChart):
        chart = chart.properties(width=_WIDTH, height=_HEIGHT)
    chart = chart.configure(background="#ffffff", font="DejaVu Sans, Arial, sans-serif").configure_view(stroke=None)
    chart = chart.configure_axis(gridOpacity=0.35, labelFontSize=11, titleFontSize=12, titleFontWeight="normal")
    spec: dict[str, Any] = chart.to_dict()
    return spec
