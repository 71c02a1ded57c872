"""Fits of range error against range by Kusters 1992: Eq. 4.1, Eq. 4.7 as printed, and Eq. 4.7 as it follows from Eq. 4.6."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["fit_quadratic", "fit_reciprocal", "fit_reciprocal_in_inverse"]

Float = NDArray[np.float64]


def _least_squares(x: Float, y: Float) -> Float:
    """a of y = a₀ + a₁x + a₂x²."""
    return np.asarray(np.linalg.lstsq(np.stack([np.ones_like(x), x, x * x], axis=1), y, rcond=None)[0])


def fit_quadratic(range_m: Float, error_m: Float) -> Float:
    """a of Eq. 4.1, least squares of e."""
    return _least_squares(range_m, error_m)


def fit_reciprocal(range_m: Float, error_m: Float) -> Float:
    """a of Eq. 4.7 as printed, least squares of 1/e in r, as the document does ("by taking the reciprocal")."""
    return _least_squares(range_m, 1.0 / error_m)


def fit_reciprocal_in_inverse(range_m: Float, error_m: Float) -> Float:
    """a of the form that follows from Eq. 4.6, least squares of 1/e in 1/r."""
    return _least_squares(1.0 / range_m, 1.0 / error_m)
