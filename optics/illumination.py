"""The diverging laser beam: radiant intensity against angle, and Eq. 7-13 of Guo et al. 2017 (inhomogeneous illumination).

Intensities are per unit of emitted energy, ∫ I dΩ = 1 over the forward hemisphere, in 1/sr: a pulse of energy E gives
the fluence E·I(θ)/r² J/m² on a facing surface at distance r.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from .correlation.parts import Array

__all__ = [
    "beam_axis", "beam_intensity", "beam_rotation", "distorted_point_eq9", "distortion_ratio_eq11", "distortion_ratio_eq13",
    "diverging_angle_eq12", "diverging_angle_true", "flat_top_intensity", "gaussian_intensity", "measured_intensity",
    "off_axis_angle", "orthogonal_distance_eq10", "orthogonal_suffices_eq8", "radial_distance_eq7",
]  # fmt: skip

_RIGHT_ANGLE = 0.5 * np.pi


def _half_angle(value: float) -> float:
    if not 0.0 < value <= _RIGHT_ANGLE:
        raise ValueError(f"half_angle_rad must be above 0 and at most π/2, not {value!r}")
    return float(value)


def gaussian_intensity(theta_rad: ArrayLike, half_angle_rad: float) -> Array:
    """I(θ) = I₀ exp(−2θ²/w²) for θ ≤ π/2, 1/sr; 1/e² of its peak at the half angle w [rad].

    Main arguments:
        theta_rad: angle from the beam's axis, any shape.
        half_angle_rad: 1/e² half angle; 0 < w ≤ π/2, else ValueError.
    """
    w = _half_angle(half_angle_rad)
    theta = np.abs(np.asarray(theta_rad, dtype=np.float64))
    return np.where(theta <= _RIGHT_ANGLE, _gaussian_peak(w) * np.exp(-2.0 * (theta / w) ** 2), 0.0)


@lru_cache(maxsize=256)
def _gaussian_peak(w: float) -> float:
    """1/∫ exp(−2θ²/w²) 2π sinθ dθ, by 128 Gauss-Legendre nodes out to where the integrand is below 1e-25."""
    top = min(_RIGHT_ANGLE, 5.5 * w)
    node, weight = np.polynomial.legendre.leggauss(128)
    theta = 0.5 * top * (node + 1.0)
    return float(1.0 / (0.5 * top * np.sum(weight * np.exp(-2.0 * (theta / w) ** 2) * 2.0 * np.pi * np.sin(theta))))


def flat_top_intensity(theta_rad: ArrayLike, half_angle_rad: float) -> Array:
    """I(θ) = 1/(2π(1 − cos w)) for θ ≤ w, else 0, 1/sr. Raises ValueError unless 0 < w ≤ π/2."""
    w = _half_angle(half_angle_rad)
    theta = np.abs(np.asarray(theta_rad, dtype=np.float64))
    # 1 − cos w = 2 sin²(w/2), without cancellation for narrow beams
    return np.where(theta <= w, 1.0 / (4.0 * np.pi * np.sin(0.5 * w) ** 2), 0.0)


def measured_intensity(theta_rad: ArrayLike, half_angle_rad: float, radial_value: ArrayLike) -> Array:
    """I(θ) from values on an even grid of angles 0 … w, linear between, zero beyond; scaled to ∫I dΩ = 1, 1/sr.

    Raises ValueError for fewer than 2 values, negative ones, or all zero.
    """
    w = _half_angle(half_angle_rad)
    value = np.asarray(radial_value, dtype=np.float64)
    if value.ndim != 1 or value.size < 2 or not np.all(value >= 0.0) or not np.sum(value) > 0.0:
        raise ValueError("radial_value needs at least two values, none of them negative and not all zero")
    scale = _measured_scale(w, tuple(value.tolist()))
    theta = np.abs(np.asarray(theta_rad, dtype=np.float64))
    return np.asarray(scale * np.interp(theta, np.linspace(0.0, w, value.size), value, right=0.0), dtype=np.float64)


@lru_cache(maxsize=64)
def _measured_scale(w: float, value: tuple[float, ...]) -> float:
    """1/∫ value(θ) 2π sinθ dθ, eight Gauss-Legendre nodes per cell (exact to rounding for a line times a sine)."""
    node, weight = np.polynomial.legendre.leggauss(8)
    grid = np.linspace(0.0, w, len(value))
    half = 0.5 * (grid[1] - grid[0])
    theta = (grid[:-1, None] + half) + half * node
    line = np.interp(theta, grid, np.asarray(value))
    return float(1.0 / (half * np.sum(weight * line * 2.0 * np.pi * np.sin(theta))))


def beam_intensity(
    profile: Literal["gaussian", "flat-top", "measured"],
    theta_rad: ArrayLike,
    half_angle_rad: float,
    radial_value: ArrayLike | None = None,
) -> Array:
    """I(θ) of the named profile, 1/sr: `gaussian_intensity`, `flat_top_intensity` or `measured_intensity`.

    Raises ValueError for an unknown name, or where "measured" has no values.
    """
    if profile == "gaussian":
        return gaussian_intensity(theta_rad, half_angle_rad)
    if profile == "flat-top":
        return flat_top_intensity(theta_rad, half_angle_rad)
    if profile == "measured":
        if radial_value is None:
            raise ValueError('profile "measured" needs radial_value')
        return measured_intensity(theta_rad, half_angle_rad, radial_value)
    raise ValueError(f'profile must be "gaussian", "flat-top" or "measured", not {profile!r}')


def beam_axis(offset_rad: tuple[float, float]) -> Array:
    """Unit vector (3,) of a beam rotated from +z by offset_rad = (a, b): (sin a cos b, sin b, cos a cos b).

    Azimuth a to the right, then elevation b downward, as in a pan-tilt mount: b is the angle from the x-z plane. In a
    pinhole image the centre of illumination lies at f·tan a to the right of the axis and f·tan b/cos a below it.
    """
    a, b = offset_rad
    return np.array([np.sin(a) * np.cos(b), np.sin(b), np.cos(a) * np.cos(b)])


def beam_rotation(offset_rad: tuple[float, float]) -> Array:
    """Rotation (3, 3) that takes +z to `beam_axis(offset_rad)`: about x by −b, then about y by a."""
    a, b = offset_rad
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(b), np.sin(b)], [0.0, -np.sin(b), np.cos(b)]])
    about_y = np.array([[np.cos(a), 0.0, np.sin(a)], [0.0, 1.0, 0.0], [-np.sin(a), 0.0, np.cos(a)]])
    return np.asarray(about_y @ about_x)


def off_axis_angle(direction: ArrayLike, axis: ArrayLike) -> Array:
    """Angle between direction (…, 3) and axis (3,), rad: atan2(|d × a|, d·a), accurate near 0; any lengths."""
    d, a = np.asarray(direction, dtype=np.float64), np.asarray(axis, dtype=np.float64)
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(d, a), axis=-1), np.sum(d * a, axis=-1)), dtype=np.float64)


def radial_distance_eq7(x_m: ArrayLike, y_m: ArrayLike, orthogonal_m: ArrayLike) -> Array:
    """Eq. 7: r' = √(x² + y² + r²), radial distance of a point at lateral offset x, y and orthogonal distance r."""
    return np.asarray(np.hypot(np.hypot(x_m, y_m), orthogonal_m), dtype=np.float64)


def orthogonal_suffices_eq8(x_m: ArrayLike, y_m: ArrayLike, orthogonal_m: ArrayLike, rtol: float) -> np.ndarray:
    """Eq. 8, r' = r for x = y = 0 or r ≫ x, y: True where r'/r − 1 ≤ rtol.

    r'/r − 1 = ½(ρ/r)² to lowest order: 1e-3 at ρ = r/22.
    """
    r = np.asarray(orthogonal_m, dtype=np.float64)
    return np.asarray(radial_distance_eq7(x_m, y_m, r) - r <= rtol * r)


def distorted_point_eq9(undistorted: ArrayLike, centre: ArrayLike, ratio: ArrayLike) -> Array:
    """Eq. 9: r^d = e + λ(r^u − e)."""
    e = np.asarray(centre, dtype=np.float64)
    return np.asarray(e + np.asarray(ratio) * (np.asarray(undistorted) - e), dtype=np.float64)


def orthogonal_distance_eq10(radial_m: ArrayLike, ratio: ArrayLike) -> Array:
    """Eq. 10: r = λ r' (Eq. 9 about the centre e = 0)."""
    return distorted_point_eq9(radial_m, 0.0, ratio)


def distortion_ratio_eq11(orthogonal_m: ArrayLike, radial_m: ArrayLike) -> Array:
    """Eq. 11: λ = r/r' = cosθ."""
    return np.asarray(np.asarray(orthogonal_m, dtype=np.float64) / np.asarray(radial_m, dtype=np.float64))


def diverging_angle_eq12(
    x: ArrayLike, y: ArrayLike, x_max: float, y_max: float, half_angle_rad: float, exponent: float = 1.0
) -> Array:
    """Eq. 12 as printed: θ = (ρ/ρ_max)·φ, rad, with ρ = √(x² + y²) from the centre and ρ_max that of the corner.

    `exponent` k is that of Eq. 23 and 24, (ρ/ρ_max)^k φ. In a pinhole image tanθ, not θ, is proportional to ρ:
    see `diverging_angle_true`. The printed angle is too small by 2φ³/(9√3) at most, for k = 1 and small φ.
    """
    return np.asarray((np.hypot(x, y) / np.hypot(x_max, y_max)) ** exponent * half_angle_rad, dtype=np.float64)


def diverging_angle_true(x: ArrayLike, y: ArrayLike, x_max: float, y_max: float, half_angle_rad: float) -> Array:
    """θ = atan((ρ/ρ_max)·tanφ), rad: angle of a pixel in an undistorted image whose corner lies at the angle φ."""
    return np.asarray(np.arctan(np.hypot(x, y) / np.hypot(x_max, y_max) * np.tan(half_angle_rad)), dtype=np.float64)


def distortion_ratio_eq13(
    x: ArrayLike, y: ArrayLike, x_max: float, y_max: float, half_angle_rad: float, exponent: float
) -> Array:
    """Eq. 13: λ = cos[(ρ/ρ_max)^k φ].

    The formula is missing in the scan of the report; this is the factor by which its Eq. 23 and 24 divide.
    """
    return np.cos(diverging_angle_eq12(x, y, x_max, y_max, half_angle_rad, exponent))
