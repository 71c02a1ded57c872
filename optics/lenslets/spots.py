"""Spots of square lenslets at their focus: pixel-integrated sinc² of each alone, in closed form.

At z = f a lenslet of side a gives exactly its Fraunhofer pattern: for a plane wave of slope s the irradiance is

    (a²/λf)² sinc²(a(X − f s_x)/λf) sinc²(a(Y − f s_y)/λf),    sinc t = sin(πt)/(πt),

and the light between X₁ and X₂ is a difference of S(t) = Si(2πt)/π − sin²(πt)/(π² t), S(±∞) = ±½. A positive slope moves the
spot to larger columns and rows.

Source: J. W. Goodman, Introduction to Fourier Optics, 2005, sec. 4.4 and 5.2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import sici

__all__ = [
    "isolated_image", "pixel_share_slopes", "pixel_shares", "sinc2_integral", "slope_of_displacement", "spot_displacement_m",
    "spot_width_m",
]  # fmt: skip

Float = NDArray[np.float64]


def spot_width_m(wavelength_m: float, focal_length_m: float, side_m: float) -> float:
    """λf/a [m]: distance from the peak of a spot to its first dark line."""
    return wavelength_m * focal_length_m / side_m


def spot_displacement_m(slope_rad: ArrayLike, focal_length_m: float) -> Float:
    """Δ = f s [m] of the spot's centre of gravity for a mean slope s of the wave (small angles); the same shape as `slope_rad`."""
    return np.asarray(focal_length_m * np.asarray(slope_rad, np.float64))


def slope_of_displacement(displacement_m: ArrayLike, focal_length_m: float) -> Float:
    """s = Δ/f [rad]: the inverse of `spot_displacement_m`."""
    return np.asarray(np.asarray(displacement_m, np.float64) / focal_length_m)


def sinc2_integral(t: ArrayLike) -> Float:
    """S(t) = ∫₀ᵗ sinc²(u) du = Si(2πt)/π − sin²(πt)/(π² t); odd, S(∞) = ½."""
    x = np.asarray(t, np.float64)
    safe = np.where(x == 0.0, 1.0, x)
    return np.where(x == 0.0, 0.0, sici(2.0 * np.pi * safe)[0] / np.pi - np.sin(np.pi * safe) ** 2 / (np.pi**2 * safe))


def pixel_shares(centre_px: ArrayLike, width_px: float, count: int) -> Float:
    """Share of a spot's light in each of `count` pixels along one axis, as (spots, count).

    Main arguments:
        centre_px (spots): place of the spot, pixel centres at whole numbers. width_px: λf/a in pixels.

    Rows and columns are independent: a pixel has the product of both shares. A line of endless length has the sum 1.
    """
    return np.asarray(np.diff(sinc2_integral(_edges(centre_px, width_px, count)), axis=1))


def pixel_share_slopes(centre_px: ArrayLike, width_px: float, count: int) -> Float:
    """d(share)/d(centre) [1/px] as (spots, count): the derivative of `pixel_shares`."""
    return np.asarray(-np.diff(np.sinc(_edges(centre_px, width_px, count)) ** 2, axis=1) / width_px)


def isolated_image(
    col_px: ArrayLike, row_px: ArrayLike, light: ArrayLike, width_px: float, shape: tuple[int, int]
) -> Float:
    """Σ light · share(row) ⊗ share(col) as (rows, cols), in the unit of `light`: each lenslet alone, no interference.

    Main arguments:
        col_px, row_px (spots): places. light (spots): of each spot over the endless plane. width_px: λf/a in pixels.
        shape: rows, columns of the image. Spots may lie outside.
    """
    x = pixel_shares(col_px, width_px, shape[1])
    y = pixel_shares(row_px, width_px, shape[0])
    return np.asarray((y * np.ravel(np.asarray(light, np.float64))[:, None]).T @ x)


def _edges(centre_px: ArrayLike, width_px: float, count: int) -> Float:
    if not (width_px > 0 and np.isfinite(width_px)):
        raise ValueError(f"width_px must be positive and finite, not {width_px!r}.")
    centre = np.ravel(np.asarray(centre_px, np.float64))
    return np.asarray((np.arange(count + 1) - 0.5 - centre[:, None]) / width_px)
