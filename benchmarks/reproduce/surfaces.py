"""Figure 2: the reflection model against angle for four surfaces."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics.reflection.chua import FIGURE_2_SURFACES, chua_printed
from .rows import Row, judge_settings

__all__ = ["figure_2_curves", "figure_2_rows", "peak_angle"]

_ANGLES_DEG = np.arange(0.0, 90.0, 1.0)
#: Slopes for which the statement is checked: the text gives neither values nor limits.
SLOPES = (0.1, 0.2, 0.3, 0.5, 0.7, 0.9)


def peak_angle(slope: float) -> float:
    """Angle at which the specular term of Eq. 4 is greatest, rad: 0 for s ≤ 1/√3, else atan √(3s² − 1).

    With u = tan²θ the term is (1 + u)³ exp(−u/s²), whose logarithm has the slope 3/(1 + u) − 1/s².
    """
    return math.atan(math.sqrt(max(3.0 * slope**2 - 1.0, 0.0)))


def _falls(value: NDArray[np.float64]) -> bool:
    return int(np.argmax(value)) == 0 and bool(np.all(np.diff(value) <= 0.0))  # a narrow lobe falls to 0 before 90°


def figure_2_curves() -> list[dict[str, Any]]:
    """Points of the chart: surface, angle in degrees, Eq. 4."""
    cos = np.cos(np.radians(_ANGLES_DEG))
    return [
        {"surface": name, "angle": float(angle), "value": float(value)}
        for name, surface in FIGURE_2_SURFACES.items()
        for angle, value in zip(_ANGLES_DEG, chua_printed(cos, **surface), strict=True)
    ]


def figure_2_rows() -> list[Row]:
    """The row of Figure 2."""
    cos = np.cos(np.radians(_ANGLES_DEG))
    falls = {
        (name, slope): _falls(chua_printed(cos, **(surface | {"slope": slope})))
        for name, surface in FIGURE_2_SURFACES.items()
        for slope in (surface["slope"], *SLOPES)
    }
    rising = sorted({slope for (_, slope), fall in falls.items() if not fall})
    return [
        Row("Figure 2", "slope s up to which the specular term of Eq. 4 is greatest at θ = 0", "1", math.nan,
            1.0 / math.sqrt(3.0), math.nan, judge_settings(falls.values()),
            "the text: the amplitude is maximum at θ = 0 and decreases. It does so for the diffuse term, and for the specular "
            f"one up to s = 1/√3; beyond, 1/cos⁶θ wins: of our slopes, {', '.join(f'{s:g}' for s in rising)} fail with some "
            f"ratio K_S/K_D (for s = .7 the peak lies at {math.degrees(peak_angle(0.7)):.0f}°). The document gives no s",
            "K_S/K_D; s; m"),
    ]  # fmt: skip
