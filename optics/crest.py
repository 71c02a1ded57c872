"""The crest of a bright line as printed: Kusters 1992, Eq. 3.1 to 3.19, zero crossings of a directional derivative.

Across a bright line the second directional derivative of the image I(x, y) is most negative. With S of Eq. 3.13,

    I_θθ = ½(I_xx + I_yy) + ½(I_xx − I_yy) cos2θ + I_xy sin2θ,        least for  cos2θ = −(I_xx − I_yy)/S,  sin2θ = −2I_xy/S,

and the line is where s·∇I, s = (cosθ, sinθ) with cosθ ≥ 0, passes through zero while I_θθ < 0. The scan garbles most of the
symbols; they are read by deriving each from the one before it. x runs along the rows (columns), y down the columns (rows).
Arrays of any equal shapes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "absolute_cosine_eq3_11", "absolute_sine_eq3_12", "across_eq3_15", "cos_twice_eq3_10", "cos_twice_eq3_7", "crest_slope_eq3_19",
    "directional_eq3_1", "directional_eq3_17", "extremal_eq3_4", "least_second_eq3_9", "radical_eq3_13", "second_eq3_2",
    "sin_twice_eq3_14", "sin_twice_eq3_6", "tan_twice_eq3_5",
]  # fmt: skip

Float = NDArray[np.float64]


def directional_eq3_1(x: ArrayLike, y: ArrayLike, angle_rad: ArrayLike) -> Float:
    """∂I/∂θ = cosθ I_x + sinθ I_y: the derivative in the direction θ from the x axis."""
    return np.asarray(np.cos(angle_rad) * np.asarray(x) + np.sin(angle_rad) * np.asarray(y))


def second_eq3_2(xx: ArrayLike, xy: ArrayLike, yy: ArrayLike, angle_rad: ArrayLike) -> Float:
    """∂²I/∂θ² = ½(I_xx + I_yy) + ½(I_xx − I_yy) cos2θ + I_xy sin2θ."""
    xx, yy, twice = np.asarray(xx), np.asarray(yy), 2.0 * np.asarray(angle_rad)
    return np.asarray(0.5 * (xx + yy) + 0.5 * (xx - yy) * np.cos(twice) + np.asarray(xy) * np.sin(twice))


def extremal_eq3_4(xx: ArrayLike, xy: ArrayLike, yy: ArrayLike, angle_rad: ArrayLike) -> Float:
    """−(I_xx − I_yy) sin2θ + 2I_xy cos2θ, the derivative of Eq. 3.2 by θ; zero where I_θθ is greatest or least (Eq. 3.3)."""
    twice = 2.0 * np.asarray(angle_rad)
    return np.asarray(-(np.asarray(xx) - np.asarray(yy)) * np.sin(twice) + 2.0 * np.asarray(xy) * np.cos(twice))


def tan_twice_eq3_5(xx: ArrayLike, xy: ArrayLike, yy: ArrayLike) -> Float:
    """tan2θ = 2I_xy/(I_xx − I_yy) of the extremal directions."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(2.0 * np.asarray(xy, np.float64) / (np.asarray(xx, np.float64) - np.asarray(yy)))


def radical_eq3_13(xx: ArrayLike, xy: ArrayLike, yy: ArrayLike) -> Float:
    """S = √((I_xx − I_yy)² + 4I_xy²) >= 0."""
    return np.asarray(np.hypot(np.asarray(xx, np.float64) - np.asarray(yy), 2.0 * np.asarray(xy, np.float64)))


def sin_twice_eq3_6(xx: ArrayLike, xy: ArrayLike, yy: ArrayLike, sign: int) -> Float:
    """sin2θ = ±2I_xy/S; `sign` +1 for the greatest second derivative, −1 for the least. NaN for S = 0: no direction stands out."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(sign * 2.0 * np.asarray(xy, np.float64) / radical_eq3_13(xx, xy, yy))


def cos_twice_eq3_7(xx: ArrayLike, xy: ArrayLike, yy: ArrayLike, sign: int) -> Float:
    """cos2θ = ±(I_xx − I_yy)/S, with the sign of Eq. 3.6."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(sign * (np.asarray(xx, np.float64) - np.asarray(yy)) / radical_eq3_13(xx, xy, yy))


def least_second_eq3_9(xx: ArrayLike, xy: ArrayLike, yy: ArrayLike) -> Float:
    """½[(I_xx + I_yy) − S], the most negative second directional derivative: the negative root of Eq. 3.8 and 3.9."""
    return np.asarray(0.5 * (np.asarray(xx) + np.asarray(yy) - radical_eq3_13(xx, xy, yy)))


def cos_twice_eq3_10(xx: ArrayLike, xy: ArrayLike, yy: ArrayLike) -> Float:
    """cos2θ = −(I_xx − I_yy)/S of the direction of that derivative."""
    return cos_twice_eq3_7(xx, xy, yy, -1)


def absolute_cosine_eq3_11(xx: ArrayLike, xy: ArrayLike, yy: ArrayLike) -> Float:
    """|cosθ| = √(½(1 + cos2θ)) = √(½(1 − (I_xx − I_yy)/S))."""
    return np.asarray(np.sqrt(np.maximum(0.5 * (1.0 + cos_twice_eq3_10(xx, xy, yy)), 0.0)))


def absolute_sine_eq3_12(xx: ArrayLike, xy: ArrayLike, yy: ArrayLike) -> Float:
    """|sinθ| = √(½(1 − cos2θ)) = √(½(1 + (I_xx − I_yy)/S))."""
    return np.asarray(np.sqrt(np.maximum(0.5 * (1.0 - cos_twice_eq3_10(xx, xy, yy)), 0.0)))


def sin_twice_eq3_14(xx: ArrayLike, xy: ArrayLike, yy: ArrayLike) -> Float:
    """sin2θ = 2 sinθ cosθ = −2I_xy/S: as cosθ >= 0 and S > 0, sinθ has the sign of −I_xy."""
    return sin_twice_eq3_6(xx, xy, yy, -1)


def across_eq3_15(xx: ArrayLike, xy: ArrayLike, yy: ArrayLike) -> Float:
    """s = (|cosθ|, −sign(I_xy) |sinθ|) (2, …): the unit vector across the line, cosθ >= 0. NaN for S = 0.

    For I_xy = 0 and I_yy < I_xx it is (0, ±1): either sign says the same.
    """
    sign = np.where(np.asarray(xy) > 0, -1.0, 1.0)
    return np.stack([absolute_cosine_eq3_11(xx, xy, yy), sign * absolute_sine_eq3_12(xx, xy, yy)])


def directional_eq3_17(x: ArrayLike, y: ArrayLike, across: Float) -> Float:
    """∂I/∂θ = s·∇I (Eq. 3.16 to 3.18) for the unit vector `across` (2, …)."""
    return np.asarray(across[0] * np.asarray(x) + across[1] * np.asarray(y))


def crest_slope_eq3_19(x: ArrayLike, y: ArrayLike, xx: ArrayLike, xy: ArrayLike, yy: ArrayLike) -> Float:
    """s·∇I with s of Eq. 3.15: the first derivative across the line, which passes through zero on it."""
    return directional_eq3_17(x, y, across_eq3_15(xx, xy, yy))
