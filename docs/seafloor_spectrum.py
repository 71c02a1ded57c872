"""Tables and picture of docs/seafloor-spectrum.md: python docs/seafloor_spectrum.py [RUN_FOLDER of laser-line-spectrum]."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from beambench.benchmarks.reproduce.spectra import (
    CONDITIONS,
    METHODS,
    PROFILES,
    SLOPES,
    reading,
    survey_of,
    tank_profiles,
)
from beambench.benchmarks.written.laser_line_profiles import drawn_selection
from beambench.estimators.laser_line.periodograms import document_spectra, split_gaussian, tapered_spectra
from beambench.estimators.laser_line.profiles import resampled
from beambench.estimators.laser_line.spectrum import POINTS

SURVEYS = {"reml": 4}
COLOURS = ["#000000", "#0072B2", "#D55E00", "#009E73"]


def slopes() -> str:
    """Mean error of a slope by method, condition and slope, and the rms of errors over stated errors, as Markdown."""
    lines = [
        "| method | survey | " + " | ".join(f"{slope:g}" for slope in SLOPES) + " |",
        "|---" * (2 + len(SLOPES)) + "|",
    ]
    for method in METHODS:
        for condition in CONDITIONS:
            made = [reading(method, slope, condition, SURVEYS.get(method, 8)) for slope in SLOPES]
            cells = [f"{mean:+.2f} ± {spread:.2f} ({z:.1f})" for mean, spread, _, z in made]
            lines.append(f"| `{method}` | {condition} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def run_table(run: Path) -> str:
    """Error, stated error's z and time of every chain of a run, as Markdown."""
    scores = pd.read_csv(run / "scores.csv")
    lines = ["| scene | chain | slope − true | z | level − true, dB | bound of the slope | CPU s |", "|---" * 7 + "|"]
    for (scene, name), rows in scores.groupby(["scene", "estimator"], sort=False):
        slope, level = (rows[rows["quantity"] == key].iloc[0] for key in ("slope", "level"))
        chain = str(name).replace("+triangulate-refractive", "+…")
        lines.append(
            f"| `{scene}` | `{chain}` | {slope['bias']:+.3f} | {slope['z_rms']:.1f} | {level['bias']:+.2f} "
            f"| {slope['bound']:.3f} | {slope['cpu_s']:.2g} |"
        )
    return "\n".join(lines)


def _points() -> list[dict[str, Any]]:
    survey = survey_of(2.5)
    even = resampled(drawn_selection(survey, PROFILES, POINTS, 1), POINTS)
    taper = split_gaussian(POINTS, 0.25, 2.5)
    hann = np.sin(np.pi * (np.arange(POINTS) + 0.5) / POINTS) ** 2
    tank = resampled(tank_profiles(PROFILES, noise_m=1e-4), POINTS)
    own, other = document_spectra(even, taper), tapered_spectra(even, hann[None])
    round_ = document_spectra(tank, taper)
    law = survey.level_m3 * (own.frequency / 10.0) ** -survey.slope
    curves = {
        "the surface: S = A/f^2.5": (own.frequency, law), "the document's procedure": (own.frequency, own.power.mean(axis=0)),
        "Hann, one-sided": (other.frequency, other.power.mean(axis=0)), "the tank": (round_.frequency, round_.power.mean(axis=0)),
    }  # fmt: skip
    return [
        {"f": float(f), "s": float(s), "curve": name}
        for name, (at, power) in curves.items()
        for f, s in zip(at, power, strict=True)
    ]


def picture(path: Path) -> None:
    """Averaged spectra of 50 profiles of one survey beside the law that they were drawn from, and that of the tank."""
    import altair as alt
    import vl_convert as vlc

    points = _points()
    names = list(dict.fromkeys(point["curve"] for point in points))
    chart = alt.Chart(alt.InlineData(values=points)).mark_line(strokeWidth=1.8).encode(
        x=alt.X("f:Q", scale=alt.Scale(type="log"), title="spatial frequency, cycles/m"),
        y=alt.Y("s:Q", scale=alt.Scale(type="log"), title="power spectral density, m³", axis=alt.Axis(format=".0e")),
        color=alt.Color(
            "curve:N", scale=alt.Scale(domain=names, range=COLOURS), legend=alt.Legend(title=None, orient="bottom", columns=2)
        ),
    ).properties(width=430, height=300).configure(background="#ffffff")  # fmt: skip
    path.write_bytes(vlc.vegalite_to_png(chart.to_dict(), scale=1.0))


if __name__ == "__main__":
    picture(Path(__file__).parent / "pictures" / "seafloor-spectrum.png")
    print(slopes())
    if len(sys.argv) > 1:
        print(run_table(Path(sys.argv[1])))
