"""The certificate as one offline page: the verdict in a sentence, the clauses, small charts, and what it cannot show."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..report.charts import finished, quantitative, svg_of
from ..report.styles import PALETTE
from .certificate import Certificate
from .clause import Curve, Judged
from .verdict import ALPHA

__all__ = ["certificate_page", "interval_svg", "sentence"]

_REPORT = Path(__file__).parent.parent / "report" / "templates"
#: The interval's picture: half its width stands for so many tolerances.
_SPAN = 2.5


def certificate_page(certificate: Certificate, source: str, typed: Sequence[str]) -> str:
    """HTML of a certificate; names from files are escaped, and nothing is loaded over the network."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    charts = [
        {"title": curve.title, "svg": Markup(svg_of(_chart(curve)))} for curve in certificate.evidence.curves.values()
    ]
    return environment.get_template("certificate.html.j2").render(
        source=source,
        verdict=certificate.verdict,
        sentence=sentence(certificate),
        about=certificate.evidence.about,
        charts=charts,
        rows=[_shown(one) for one in certificate.clauses if one.measured],
        not_shown=[_shown(one) for one in certificate.clauses if not one.measured],
        alpha=f"{100 * ALPHA:g}",
        draws=len(certificate.evidence.twins),
        counts=[(word, certificate.count(word)) for word in ("pass", "fail", "cannot tell")],
        typed=" ".join(map(shlex.quote, typed)),
        css=Markup((_REPORT / "report.css").read_text(encoding="utf-8")),
    )


def sentence(certificate: Certificate) -> str:
    """The verdict in a sentence."""
    failed = [one.clause.title for one in certificate.clauses if one.verdict == "fail"]
    told, open_ = certificate.count("pass") + len(failed), certificate.count("cannot tell")
    if failed:
        return f"The twin does not agree with the rig in {len(failed)} of {told} clauses that were decided: {'; '.join(failed)}."
    if not told:
        return "Nothing could be decided: no interval was narrow enough for its tolerance."
    lacking = ", ".join(one.clause.title.partition(":")[0] for one in certificate.lacking)
    needed = f" What was required could not be decided: {lacking}." if lacking else ""
    undecided = ", ".join(
        one.clause.title.partition(":")[0]
        for one in certificate.clauses
        if one.verdict == "cannot tell" and one.measured
    )
    left = (
        f" {_clauses(open_)} could not be decided, since noise is too great for the tolerance: {undecided}."
        if open_
        else ""
    )
    none = certificate.not_shown
    unseen = f" {_clauses(none)} could not be measured in this recording." if none else ""
    return f"The twin agrees with the rig in all {told} clauses that were decided.{needed}{left}{unseen}"


def _clauses(count: int) -> str:
    return f"{count} other clause{'' if count == 1 else 's'}"


def number(value: float, digits: int = 4) -> str:
    """A number for people."""
    if not math.isfinite(value):
        return "–"
    return f"{value:.{digits}g}" if value == 0.0 or 1e-3 <= abs(value) < 1e5 else f"{value:.{digits - 1}e}"


def _shown(one: Judged) -> dict[str, Any]:
    from markupsafe import Markup

    clause = one.clause
    known = math.isfinite(one.low) and math.isfinite(one.high)
    unit = "" if clause.unit == "1" else f" {clause.unit}"
    interval = f"{number(one.low, 3)} … {number(one.high, 3)}{unit}" if known else "–"
    tolerance = f"± {number(one.tolerance, 3)}{unit} tolerated" if math.isfinite(one.tolerance) else "–"
    if known and clause.above:
        interval, tolerance = f"agreement of the two: {interval}", f"it must be above {number(one.tolerance, 3)}"
    return {
        "name": clause.name,
        "title": clause.title,
        "unit": clause.unit,
        "real": number(one.real),
        "twin": number(one.twin),
        "bound": "–" if clause.above else number(one.bound, 2),
        "interval": interval,
        "tolerance": tolerance,
        "verdict": one.verdict,
        "coverage": f"{100 * one.coverage:.1f}" if one.coverage < 1.0 else "",
        "slug": one.verdict.replace(" ", "-"),
        "remark": one.remark,
        "why": clause.why,
        "follows": clause.follows,
        "cannot": clause.cannot,
        "picture": Markup(interval_svg(one)) if known and not clause.above else "",
    }


def interval_svg(one: Judged) -> str:
    """The interval of the difference against the tolerance: the band is what is tolerated, the line the interval, the dot
    the value."""
    width, height = 150.0, 20.0
    scale = 0.5 * width / (_SPAN * one.tolerance)

    def x(value: float) -> float:
        return min(max(0.5 * width + scale * value, 3.0), width - 3.0)

    left, right, middle = x(one.low), x(one.high), x(0.5 * (one.low + one.high))
    colour = {"pass": "var(--pass)", "fail": "var(--fail)"}.get(one.verdict, "var(--soft)")
    band = f'<rect x="{x(-one.tolerance):.1f}" y="2" width="{2 * scale * one.tolerance:.1f}" height="16" fill="var(--band)"/>'
    zero = f'<line x1="{width / 2}" x2="{width / 2}" y1="1" y2="19" stroke="currentColor" stroke-opacity=".35"/>'
    line = f'<line x1="{left:.1f}" x2="{max(right, left + 1):.1f}" y1="10" y2="10" stroke="{colour}" stroke-width="3"/>'
    dot = f'<circle cx="{middle:.1f}" cy="10" r="3.6" fill="{colour}"/>'
    ends = "".join(
        f'<path d="M{x(value) - 4 * side:.1f} 5 l{5 * side} 5 l{-5 * side} 5" fill="none" stroke="{colour}" stroke-width="2"/>'
        for value, side in ((one.low, -1), (one.high, 1))
        if abs(value) > 0.98 * _SPAN * one.tolerance
    )
    label = f"difference {number(one.low, 3)} to {number(one.high, 3)}, tolerated ±{number(one.tolerance, 3)} {one.clause.unit}"
    size = f'viewBox="0 0 {width:g} {height:g}" width="{width:g}" height="{height:g}"'
    return f'<svg {size} role="img" aria-label="{label}">{band}{zero}{line}{dot}{ends}</svg>'


def _chart(curve: Curve) -> dict[str, Any]:
    points = [
        {"x": x, "y": y, "low": y - 2 * s, "high": y + 2 * s}
        for x, y, s in zip(curve.x, curve.real, curve.sigma, strict=True)
    ]
    line = [{"x": x, "y": y} for x, y in zip(curve.x, curve.twin, strict=True)]
    place = {"x": quantitative("x", curve.x_title) | {"scale": {"zero": False}}, "y": quantitative("y", curve.y_title)}
    bars = {"x": place["x"], "y": {"field": "low", "type": "quantitative"}, "y2": {"field": "high"}}
    spec = {
        "width": 330,
        "height": 210,
        "layer": [
            {
                "data": {"values": line},
                "mark": {"type": "line", "color": PALETTE[1], "strokeWidth": 2},
                "encoding": place,
            },
            {"data": {"values": points}, "mark": {"type": "rule", "color": PALETTE[0]}, "encoding": bars},
            {
                "data": {"values": points},
                "mark": {"type": "point", "filled": True, "color": PALETTE[0], "size": 22, "opacity": 1},
                "encoding": place,
            },
        ],
    }
    return finished(spec, page=True)
