"""The gated sensor of wave slopes as printed: Guo et al. 2017, Eq. 26 to 30, 33 and 34. Eq. 31 and 32: `optics.deconvolution`."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..zernike import zernike

__all__ = [
    "centroid_x_eq28", "centroid_y_eq29", "dynamic_range_eq34", "range_eq26", "sensitivity_eq33", "slope_eq27", "wavefront_eq30",
]  # fmt: skip

Float = NDArray[np.float64]


def range_eq26(travel_time_s: ArrayLike, speed_m_per_s: float) -> Float:
    """r = v t₀/2 [m]. The text calls r the speed; v is meant, and for a pulse it is c over the *group* index."""
    return np.asarray(0.5 * speed_m_per_s * np.asarray(travel_time_s, np.float64))


def slope_eq27(displacement_m: ArrayLike, focal_length_m: float) -> Float:
    """∂W/∂x = Δx/f [rad], W in metres of optical path: the mean slope over the lenslet."""
    return np.asarray(np.asarray(displacement_m, np.float64) / focal_length_m)


def centroid_x_eq28(intensity: ArrayLike, x: ArrayLike, alpha: float = 1.0) -> Float:
    """X_c = Σ x_i I_ij^α/Σ I_ij^α (…), in the unit of `x`: intensity-power centroid of windows `intensity` (…, M, L), rows first.

    NaN where the sum is not positive: a dark window has no centre.
    """
    return _centroid(np.asarray(intensity, np.float64), np.asarray(x, np.float64)[None, :], alpha)


def centroid_y_eq29(intensity: ArrayLike, y: ArrayLike, alpha: float = 1.0) -> Float:
    """Y_c = Σ y_j I_ij^α/Σ I_ij^α (…), in the unit of `y`; as `centroid_x_eq28`."""
    return _centroid(np.asarray(intensity, np.float64), np.asarray(y, np.float64)[:, None], alpha)


def wavefront_eq30(coefficients: ArrayLike, noll: Iterable[int], x: ArrayLike, y: ArrayLike) -> Float:
    """W(x, y) = Σ C_k Z_k(x, y) (…) in the unit of the coefficients; x, y in radii of the pupil.

    The print numbers the modes from 0 without naming an order and prints C_k under a sum over i; here k are Noll's indices.
    """
    return np.asarray(np.tensordot(np.asarray(coefficients, np.float64), zernike(list(noll), x, y), axes=1))


def sensitivity_eq33(pixel_m: float, focal_length_m: float) -> float:
    """θ_min = P/f [rad], 2.657 mrad in the print: the angle of one pixel. Centroids resolve a small part of it."""
    return pixel_m / focal_length_m


def dynamic_range_eq34(pitch_m: float, focal_length_m: float) -> float:
    """θ_max = D/(2f) [rad], 11.194 mrad in the print: the slope that moves a spot's centre to the edge of its cell."""
    return pitch_m / (2.0 * focal_length_m)


def _centroid(intensity: Float, place: Float, alpha: float) -> Float:
    if (intensity < 0).any():
        raise ValueError("The intensity must not be negative: its power is not defined there. Clip it first.")
    # Scaled by the brightest pixel: high powers neither overflow nor vanish.
    top = intensity.max(axis=(-2, -1), keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = np.where(top > 0, intensity / np.where(top > 0, top, 1.0), 0.0) ** alpha
        weight = np.where(intensity > 0, weight, 0.0)
        return np.asarray((weight * place).sum(axis=(-2, -1)) / weight.sum(axis=(-2, -1)))
