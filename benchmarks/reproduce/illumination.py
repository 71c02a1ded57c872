"""Eq. 12 and Figure 6: radial and orthogonal distance under a diverging beam."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...optics import illumination as law
from .rows import Row, judge_settings

__all__ = ["PRINTED_ANGLES", "depth_error", "figure_6_curves", "illumination_rows"]

_HALF_ANGLE = 0.35
#: Half angles φ, rad: the text says "from a few mille-radians to radian".
PRINTED_ANGLES = (0.003, 0.1, 0.35, 1.0)


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


def depth_error(half_angle_rad: float) -> float:
    """Largest relative error of r = r'·λ with the angle of Eq. 12 instead of that of Eq. 7 and 11, cosθ = r/r'."""
    x = np.linspace(0.0, 1.0, 2001)
    true = law.diverging_angle_true(x, 0.0, 1.0, 0.0, half_angle_rad)
    linear = law.diverging_angle_eq12(x, 0.0, 1.0, 0.0, half_angle_rad)
    return float(np.max(np.abs(np.cos(linear) / np.cos(true) - 1.0)))


def illumination_rows() -> list[Row]:
    """Rows of Eq. 12 and Figure 6."""
    errors = {angle: depth_error(angle) for angle in PRINTED_ANGLES}
    falls = [
        bool(np.all(np.diff([p["value"] for p in figure_6_curves() if p["profile"] == name]) < 0.0))
        for name in ("gaussian", "flat-top")
    ]
    return [
        Row("Eq. 12", "largest relative error of the orthogonal distance by Eq. 10 with Eq. 12, φ = 1 rad", "1", math.nan,
            errors[PRINTED_ANGLES[-1]], 1e-3, judge_settings(error <= 1e-3 for error in errors.values()),
            "by Eq. 7 and 11 the tangent of the angle, not the angle, is linear in the radius. The text gives φ as «a few "
            "mille-radians to radian»: " + ", ".join(f"{error:.1g} for {angle:g} rad" for angle, error in errors.items())
            + "; negligible (below 1e-3) or not, depending on φ", "φ"),
        Row("Figure 6", "light on a flat wall at the corner over that at the centre, Gaussian beam", "1", math.nan,
            figure_6_curves()[60]["value"], math.nan, judge_settings(falls),
            "falls from the centre both for a Gaussian and for a flat-top beam (cos³θ); the figure has no numbers",
            "profile; half angle"),
    ]  # fmt: skip
