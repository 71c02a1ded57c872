"""Range error from one pixel to the next as printed: Kusters 1992, Eq. 4.1 to 4.7.

A ray to the laser's plane makes the angle φ with the baseline b, so that the range is r = b tanφ; a pixel turns it by Δφ. Eq. 4.7
is printed as 1/(a₀ + a₁r + a₂r²). It does not follow from Eq. 4.6: for small opposite angles π/2 − φ = b/r that one is

    Δr = b Δφ/((b/r)(b/r − Δφ)) = r² Δφ/(b − r Δφ),        1/Δr = b/(Δφ r²) − 1/r,

whose reciprocal is quadratic in 1/r, not in r. Both are given; `reciprocal_in_inverse` is the one that follows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "opposite_eq4_5", "quadratic_eq4_1", "range_eq4_2", "reciprocal_eq4_7", "reciprocal_in_inverse", "small_angle_eq4_6",
    "step_eq4_3", "step_eq4_4",
]  # fmt: skip

Float = NDArray[np.float64]


def quadratic_eq4_1(range_m: ArrayLike, a: ArrayLike) -> Float:
    """e = a₀ + a₁ r + a₂ r² [m]."""
    r, (a0, a1, a2) = np.asarray(range_m, np.float64), np.asarray(a, np.float64)
    return np.asarray(a0 + a1 * r + a2 * r * r)


def range_eq4_2(baseline_m: float, angle_rad: ArrayLike) -> Float:
    """r = b tanφ [m]."""
    return np.asarray(baseline_m * np.tan(angle_rad))


def step_eq4_3(baseline_m: float, angle_rad: ArrayLike, step_rad: ArrayLike) -> Float:
    """Δr = b (tan(φ + Δφ) − tanφ) [m]."""
    return range_eq4_2(baseline_m, np.asarray(angle_rad) + step_rad) - range_eq4_2(baseline_m, angle_rad)


def step_eq4_4(baseline_m: float, angle_rad: ArrayLike, step_rad: ArrayLike) -> Float:
    """Δr = b sinΔφ/(cosφ cos(φ + Δφ)) [m]."""
    phi, step = np.asarray(angle_rad, np.float64), np.asarray(step_rad, np.float64)
    return np.asarray(baseline_m * np.sin(step) / (np.cos(phi) * np.cos(phi + step)))


def opposite_eq4_5(baseline_m: float, angle_rad: ArrayLike, step_rad: ArrayLike) -> Float:
    """Δr = b sinΔφ/(sin(π/2 − φ) sin(π/2 − φ − Δφ)) [m]."""
    phi, step = np.asarray(angle_rad, np.float64), np.asarray(step_rad, np.float64)
    opposite = 0.5 * np.pi - phi
    return np.asarray(baseline_m * np.sin(step) / (np.sin(opposite) * np.sin(opposite - step)))


def small_angle_eq4_6(baseline_m: float, angle_rad: ArrayLike, step_rad: ArrayLike) -> Float:
    """Δr = b Δφ/((π/2 − φ)(π/2 − φ − Δφ)) [m], within 1 % where π/2 − φ is below .17."""
    phi, step = np.asarray(angle_rad, np.float64), np.asarray(step_rad, np.float64)
    opposite = 0.5 * np.pi - phi
    return np.asarray(baseline_m * step / (opposite * (opposite - step)))


def reciprocal_eq4_7(range_m: ArrayLike, a: ArrayLike) -> Float:
    """e = 1/(a₀ + a₁ r + a₂ r²) [m], as printed."""
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / quadratic_eq4_1(range_m, a))


def reciprocal_in_inverse(range_m: ArrayLike, a: ArrayLike) -> Float:
    """e = 1/(a₀ + a₁/r + a₂/r²) [m], as it follows from Eq. 4.6: there a₀ = 0, a₁ = −1, a₂ = b/Δφ."""
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / quadratic_eq4_1(1.0 / np.asarray(range_m, np.float64), a))
