"""Eq. 7-13 and Figure 6: radial and orthogonal distance under a diverging beam."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...optics import illumination as law
from .rows import Row, judge_exact, judge_trend

__all__ = ["figure_6_curves", "illumination_rows"]

_HALF_ANGLE = 0.35
_RANGE_M = 5.0


def figure_6_curves() -> list[dict[str, Any]]:
    """Points of the chart: profile, radius over the corner's radius, fluence on a flat wall over that at the centre."""
    share = np.linspace(0.0, 1.0, 61)
    theta = np.arctan(share * math.tan(_HALF_ANGLE))
    points = []
    for name in ("gaussian", "flat-top"):
        beam = law.beam_intensity(name, theta, 1.0001 * _HALF_ANGLE)  # type: ignore[arg-type]
        wall = beam / beam[0] * np.cos(theta) ** 3  # 1/r² and foreshortening
        points += [{"profile": name, "radius": float(s), "value": float(v)} for s, v in zip(share, wall, strict=True)]
    return points


def illumination_rows() -> list[Row]:
    """Rows of Eq. 7-13 and Figure 6."""
    edge = _RANGE_M * math.tan(_HALF_ANGLE)
    radial = float(law.radial_distance_eq7(edge, 0.0, _RANGE_M))
    exact = _RANGE_M / math.cos(_HALF_ANGLE)
    ratio = float(law.distortion_ratio_eq11(_RANGE_M, radial))
    back = float(law.orthogonal_distance_eq10(radial, ratio))
    point = float(law.distorted_point_eq9(3.0, 1.0, 0.5))
    x = np.linspace(0.0, 1.0, 2001)
    gap = law.diverging_angle_true(x, 0.0, 1.0, 0.0, _HALF_ANGLE) - law.diverging_angle_eq12(
        x, 0.0, 1.0, 0.0, _HALF_ANGLE
    )
    worst = float(np.max(gap))
    thirteen = float(law.distortion_ratio_eq13(0.5, 0.0, 1.0, 0.0, _HALF_ANGLE, 1.0))
    # Depth error if the orthogonal distance is taken as r'·λ with the angle of Eq. 12 instead of the true one.
    true = law.diverging_angle_true(x, 0.0, 1.0, 0.0, _HALF_ANGLE)
    depth = _RANGE_M / np.cos(true) * np.cos(law.diverging_angle_eq12(x, 0.0, 1.0, 0.0, _HALF_ANGLE)) - _RANGE_M
    falls = all(
        bool(np.all(np.diff([p["value"] for p in figure_6_curves() if p["profile"] == name]) < 0.0))
        for name in ("gaussian", "flat-top")
    )
    return [
        Row("Eq. 7", "r' at 5 m and .35 rad over r/cosθ, less 1", "1", 0.0, radial / exact - 1.0, 1e-12,
            judge_exact(0.0, radial / exact - 1.0, 1e-12), "Pythagoras"),
        Row("Eq. 8", "error of r' = r at 5 m and .35 rad", "m", math.nan, radial - _RANGE_M, math.nan, "by-construction",
            "the relative error is ½(ρ/r)²; at the half angle of our rig it is a third of a metre, not negligible against "
            "depths of .4 m", "range; half angle"),
        Row("Eq. 9", "r^d for r^u = 3, e = 1, λ = .5", "1", math.nan, point, math.nan, "by-construction",
            "a definition: scaling about a centre", "r^u; e; λ"),
        Row("Eq. 10", "r = λ r' with λ of Eq. 11, less 5 m", "m", 0.0, back - _RANGE_M, 1e-9,
            judge_exact(0.0, back - _RANGE_M, 1e-9), "Eq. 9 about the centre 0: λ converts radial to orthogonal distance "
            "as a factor on the radial distance, not a divisor of it (Eq. 24 divides)"),
        Row("Eq. 11", "λ less cosθ at .35 rad", "1", 0.0, ratio - math.cos(_HALF_ANGLE), 1e-12,
            judge_exact(0.0, ratio - math.cos(_HALF_ANGLE), 1e-12), "exact for a pinhole"),
        Row("Eq. 12", "largest angle missing in the linear form, φ = .35 rad", "rad", math.nan, worst, math.nan,
            "by-construction",
            f"a pinhole gives θ = atan(ρ/ρ_max·tanφ); 2φ³/(9√3) = {2 * _HALF_ANGLE**3 / (9 * math.sqrt(3)):.5f}", "φ"),
        Row("Eq. 12", "largest error of depth at 5 m that follows from it", "m", math.nan,
            float(np.max(np.abs(depth))), math.nan, "by-construction", "with λ = cosθ multiplied; φ = .35 rad, k = 1",
            "range; φ; k"),
        Row("Eq. 13", "λ half way to the corner, φ = .35 rad, k = 1", "1", math.nan, thirteen, math.nan, "undetermined",
            "the formula is missing in the available text and is inferred from Eq. 24; its exponent k is not given", "φ; k"),
        Row("Figure 6", "light on a flat wall at the corner over that at the centre, Gaussian beam", "1", math.nan,
            figure_6_curves()[60]["value"], math.nan, judge_trend(falls),
            "falls from the centre both for a Gaussian and for a flat-top beam (cos³θ); the figure has no numbers",
            "profile; half angle"),
    ]  # fmt: skip
