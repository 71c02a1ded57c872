"""A sheet of laser light: a fan from one point, Gaussian across. Pure functions of geometry.

Irradiance on a plane square to the ray, at distance r from the source, fan angle φ and distance u from the middle plane:

    E(r, φ, u) = P · p(φ)/r · g(u; σ(r)) · exp(−c r),    ∫p dφ = 1,  ∫g du = 1,

σ = W/4 with W the full width at 1/e² of the peak, W(r)² = W₀² + (Θ (r − r₀))²: W₀ and r₀ are the waist's width and place, Θ the
full angle of divergence far away. Exact for thin sheets (u ≪ r).

Source: A. E. Siegman, Lasers, 1986, ch. 17 (Gaussian beams); Kusters 1992, sec. 3.3.2 (full angle 2.2 mrad in air).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erf, ndtr

__all__ = ["Sheet", "angle_inside", "gaussian_mean", "meeting"]

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sheet:
    """The geometry of a sheet.

    Main arguments:
        source (3): the point that the fan leaves from [m]. frame (3, 3): columns are the unit vectors across the sheet (its
            normal), along the fan, and the middle ray.
        waist_m: W₀. waist_at_m: r₀, distance of the waist from the source. divergence_rad: Θ in the medium.
        fan_half_angle_rad: of the fan in the medium; edge of "flat-top", 1/e² of "gaussian". fan_profile: one of these.
    """

    source: Float
    frame: Float
    waist_m: float
    waist_at_m: float
    divergence_rad: float
    fan_half_angle_rad: float
    fan_profile: str

    @property
    def normal(self) -> Float:
        """Unit vector across the sheet (3)."""
        return self.frame[:, 0]

    def offset(self, point: Float) -> Float:
        """Signed distance u [m] of points (3, …) from the middle plane."""
        return np.asarray(np.tensordot(self.normal, point, axes=1) - self.normal @ self.source)

    def range(self, point: Float) -> Float:
        """Distance r [m] of points (3, …) from the source."""
        return np.asarray(np.sqrt(sum((point[i] - self.source[i]) ** 2 for i in range(3))))

    def fan_angle(self, point: Float) -> Float:
        """Angle φ [rad] of points (3, …) from the middle ray, within the sheet."""
        local = [sum(self.frame[i, k] * (point[i] - self.source[i]) for i in range(3)) for k in (1, 2)]
        return np.asarray(np.arctan2(local[0], local[1]))

    def sigma(self, range_m: ArrayLike) -> Float:
        """σ(r) [m], a quarter of the full 1/e² width."""
        away = self.divergence_rad * (np.asarray(range_m, np.float64) - self.waist_at_m)
        return np.asarray(0.25 * np.hypot(self.waist_m, away))

    def fan_density(self, angle_rad: ArrayLike) -> Float:
        """p(φ) [1/rad]: the share of the power per angle of the fan."""
        phi, half = np.asarray(angle_rad, np.float64), self.fan_half_angle_rad
        if self.fan_profile == "flat-top":
            return np.where(np.abs(phi) <= half, 0.5 / half, 0.0)
        # exp(−2(φ/h)²) over |φ| <= π/2, of unit integral.
        whole = half * np.sqrt(np.pi / 2) * erf(np.sqrt(2.0) * 0.5 * np.pi / half)
        return np.where(np.abs(phi) <= 0.5 * np.pi, np.exp(-2.0 * (phi / half) ** 2) / whole, 0.0)


def angle_inside(angle_rad: float, index_ratio: float) -> float:
    """Angle in a medium of a ray at `angle_rad` in air, before a window square to the beam: sinθ = sinθ_air/n."""
    return float(np.arcsin(np.sin(angle_rad) / index_ratio))


def gaussian_mean(low: ArrayLike, high: ArrayLike, sigma: ArrayLike) -> Float:
    """Mean of the unit-area Gaussian g(u; σ) [1/m] over low … high [m]: (Φ(high/σ) − Φ(low/σ))/(high − low).

    Its value in the middle where the two ends coincide (a surface along the sheet).
    """
    a, b = np.asarray(low, np.float64), np.asarray(high, np.float64)
    s = np.asarray(sigma, np.float64)
    flip = np.where(a + b > 0, -1.0, 1.0)  # the difference in the lower tail, where it keeps its digits
    one, two = np.minimum(flip * a, flip * b) / s, np.maximum(flip * a, flip * b) / s
    span = two - one
    thin = span < 1e-6
    middle = 0.5 * (one + two)
    value = np.exp(-0.5 * middle * middle) / np.sqrt(2.0 * np.pi)
    return np.asarray(np.where(thin, value, (ndtr(two) - ndtr(one)) / np.where(thin, 1.0, span)) / s)


def meeting(origin: Float, direction: Float, normal: Float, through: Float) -> Float:
    """Points (3, …) where rays meet the plane through a point (3) or points (3, …); NaN where they are parallel to it.

    `origin`, `direction` (3, …); `normal` (3) or (3, …). Points behind the ray's origin are given too.
    """
    shape = (3,) + (1,) * (direction.ndim - 1)
    n = normal.reshape(shape) if normal.ndim == 1 else normal
    p = through.reshape(shape) if through.ndim == 1 else through
    facing = (n * direction).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.where(facing != 0, (n * (p - origin)).sum(axis=0) / facing, np.nan)
    return np.asarray(origin + direction * distance)
