"""Multiple scattering: the exact mean square displacement of light after a given path."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..correlation.parts import Array

__all__ = ["mean_square_distance", "transport_length"]


def transport_length(scattering_per_m: float, asymmetry: float) -> float:
    """ℓ = 1/(b(1 − g)), m: the transport mean free path; infinite without scattering."""
    turning = scattering_per_m * (1.0 - asymmetry)
    return float(np.inf) if turning == 0.0 else 1.0 / turning


def mean_square_distance(path_m: ArrayLike, scattering_per_m: float, asymmetry: float) -> Array:
    """⟨R²⟩(s) = 2ℓ²(s/ℓ − 1 + e^{−s/ℓ}), m²: mean square distance from the start after a path s in unbounded medium.

    Exact for any phase function of mean cosine g: directions correlate as ⟨d(0)·d(s)⟩ = e^{−s/ℓ}. Tends to s² for
    short and 2ℓs for long paths. Absorption does not change it (all paths of one length lose the same share).
    """
    s = np.asarray(path_m, dtype=np.float64)
    length = transport_length(scattering_per_m, asymmetry)
    if np.isinf(length):
        return s**2
    x = s / length
    series = x**2 * (1.0 - x / 3.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0)))
    return np.asarray(length**2 * np.where(x < 1e-3, series, 2.0 * (x + np.expm1(-x))))
