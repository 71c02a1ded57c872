"""Pictures and tables of docs/laser-line.md, "Kusters 1992": python docs/laser_tank.py prints the tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import altair as alt
import numpy as np
import vl_convert as vlc

from beambench.benchmarks.report.pictures import png
from beambench.benchmarks.reproduce.error_budget import RANGES_M, budget
from beambench.benchmarks.reproduce.range_error_fits import fit_quadratic, fit_reciprocal_in_inverse
from beambench.benchmarks.reproduce.tank_errors import observed, predicted
from beambench.generator.generate import generate
from beambench.optics.pixel_step import quadratic_eq4_1, reciprocal_in_inverse
from beambench.scenes.load import load_scene

COLOURS = ["#000000", "#D55E00", "#0072B2", "#CC79A7", "#009E73"]


def frame(path: Path) -> None:
    """The frame of data set 2 by the root of its light, turned so that the line runs along the page."""
    capture = generate(load_scene("spotscan-tank"), seed=1, fidelity="direct", rtol=0.1, truth_electrons=True)
    shown = np.sqrt(np.maximum(capture["truth_electrons"].values[0].astype(float) - 5.0, 0.0))
    turned = np.kron(shown[:, 40:120].T[::-1], np.ones((2, 2)))
    path.write_bytes(png(turned, 0.0, float(np.sqrt(2e4)), ("#000000", "#ffffff")))


def chart(path: Path) -> None:
    """Predicted greatest error, mean |error| by two readouts, and two fits to that of whole pixels."""
    r = np.linspace(0.7, 4.1, 69)
    whole, mass = observed("line-peak").bins, observed("line-centroid").bins
    curves = {
        "predicted greatest error (Eq. 3.33)": (r, predicted(r)),
        "quadratic fit to whole pixels (Eq. 4.1)": (
            r, quadratic_eq4_1(r, fit_quadratic(whole.range_m, whole.mean)),
        ),
        "reciprocal fit in 1/r (Eq. 4.7, corrected)": (
            r, reciprocal_in_inverse(r, fit_reciprocal_in_inverse(whole.range_m, whole.mean)),
        ),
    }  # fmt: skip
    dots = {"mean error, whole pixels": whole, "mean error, centres of mass": mass}
    lines: list[dict[str, Any]] = [
        {"r": float(a), "e": 1e3 * float(b), "what": n}
        for n, (x, y) in curves.items()
        for a, b in zip(x, y, strict=True)
    ]
    points = [
        {"r": float(a), "e": 1e3 * float(b), "what": n}
        for n, v in dots.items()
        for a, b in zip(v.range_m, v.mean, strict=True)
    ]
    lines = [line for line in lines if float(line["e"]) > 0]  # a fit may be negative
    names = [*curves, *dots]
    legend = alt.Legend(title=None, orient="bottom", columns=1, labelLimit=400)
    colour = alt.Color("what:N", scale=alt.Scale(domain=names, range=COLOURS), legend=legend)

    def layer(values: list[dict[str, Any]]) -> Any:
        return alt.Chart(alt.InlineData(values=values))

    x = alt.X("r:Q", title="range from the laser, m")
    y = alt.Y("e:Q", title="range error, mm", scale=alt.Scale(type="log", domain=[0.3, 110]))
    whole_chart = alt.layer(
        layer(lines).mark_line(strokeWidth=1.8, clip=True).encode(x=x, y=y, color=colour),
        layer(points).mark_point(filled=True, size=45, opacity=1, clip=True).encode(x=x, y=y, color=colour),
    ).properties(width=430, height=260)
    path.write_bytes(vlc.vegalite_to_png(whole_chart.to_dict(), scale=1.5))


def tables() -> str:
    """Errors by range, and the budget, as Markdown."""
    lines = [
        "| range, m | predicted greatest | whole pixels: mean, rms | centres of mass: mean, rms |",
        "|---|---|---|---|",
    ]
    whole, mass = observed("line-peak").bins, observed("line-centroid").bins
    for wanted in (0.75, 1.05, 1.85, 2.35, 3.05, 3.45, 3.85):
        cells = [f"{wanted:.2f}", f"{1e3 * float(predicted(np.array(wanted))):.3g}"]
        for bins in (whole, mass):
            at = np.flatnonzero(np.abs(bins.range_m - wanted) < 1e-6)
            cells.append(f"{1e3 * bins.mean[at[0]]:.2g}, {1e3 * bins.rms[at[0]]:.2g}" if at.size else "too few")
        lines.append("| " + " | ".join(cells) + " |")
    lines += [
        "",
        "| source | assumed | " + " | ".join(f"{r:g} m" for r in RANGES_M) + " |",
        "|---" * (2 + len(RANGES_M)) + "|",
    ]
    for source in budget():
        sign = "+" if source.kind == "shift" else ""
        lines.append(
            f"| {source.name} | {source.assumed} | "
            + " | ".join(f"{1e3 * e:{sign}.{2 if abs(e) < 0.0995 else 3}g}" for e in source.error_m)
            + " |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    pictures = Path(__file__).parent / "pictures"
    frame(pictures / "laser-tank.png")
    chart(pictures / "laser-tank-errors.png")
    print(tables())
