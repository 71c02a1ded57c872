"""Roughness of surfaces whose power spectrum is a power law of spatial frequency.

Conventions. f is in cycles/m. S(f) is the one-sided density of the heights along a straight profile, ∫_0^∞ S df their variance,
in m²/(cycle/m) = m³. Along every profile of an isotropic surface with the two-sided density Ψ(k) = B k^−(γ+1), k² = f² + g²,

    S(f) = 2 ∫ Ψ(√(f² + g²)) dg = 2 B √π Γ(γ/2)/Γ((γ + 1)/2) f^−γ = A f^−γ.

Sources: D. R. Jackson and M. D. Richardson, High-Frequency Seafloor Acoustics, 2007, ch. 6 (spectra of seafloors); G. Matheron,
Advances in Applied Probability 5:439, 1973 (intrinsic random functions and their generalised covariances).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import betainc, gamma

__all__ = [
    "band_variance", "intrinsic_covariance", "profile_density", "profile_factor", "structure_function", "surface_density_factor",
]  # fmt: skip

Float = npt.NDArray[np.float64]

#: Nearer to a slope of 3 the covariance is that at this distance: its two terms cancel there, and digits with them.
_NEAREST = 1e-4


def profile_factor(slope: float) -> float:
    """S(f) f^γ/B = 2 √π Γ(γ/2)/Γ((γ + 1)/2): from the surface's density to that of its profiles."""
    return float(2.0 * np.sqrt(np.pi) * gamma(slope / 2.0) / gamma((slope + 1.0) / 2.0))


def surface_density_factor(slope: float, rms_m: float, outer_m: float, inner_m: float) -> float:
    """B [m^(3−γ)] of Ψ(k) = B k^−(γ+1) between k = 1/outer_m and 1/inner_m, for heights of `rms_m`; γ > 1.

    rms² = ∫ Ψ 2πk dk = 2πB (outer^(γ−1) − inner^(γ−1))/(γ − 1).
    """
    return float(rms_m**2 * (slope - 1.0) / (2.0 * np.pi * (outer_m ** (slope - 1.0) - inner_m ** (slope - 1.0))))


def profile_density(f: npt.ArrayLike, slope: float, rms_m: float, outer_m: float, inner_m: float) -> Float:
    """S(f) [m³] at f [cycles/m] > 0 along profiles of a surface that is a power law between its outer and inner scale.

    ∫ over g of the band alone is a difference of incomplete beta functions I(½, γ/2): S = A f^−γ [I(1 − (f·inner)²) − I(1 −
    (f·outer)²)], arguments below 0 being 0. Between the scales S falls below A f^−γ as f nears 1/inner: by 3 % at a quarter.
    """
    at = np.asarray(f, np.float64)
    part = [betainc(0.5, slope / 2.0, np.clip(1.0 - (at * scale) ** 2, 0.0, 1.0)) for scale in (inner_m, outer_m)]
    level = profile_factor(slope) * surface_density_factor(slope, rms_m, outer_m, inner_m)
    return np.asarray(level * at**-slope * (part[0] - part[1]))


def band_variance(level: float, slope: float, low: float, high: float) -> float:
    """∫ A f^−γ df from `low` to `high` [cycles/m], in m²: the variance of a band, γ ≠ 1."""
    return float(level * (low ** (1.0 - slope) - high ** (1.0 - slope)) / (slope - 1.0))


def structure_function(lag_m: npt.ArrayLike, level: float, slope: float) -> Float:
    """D(x) = ⟨(h(s + x) − h(s))²⟩ [m²] of S = A f^−γ at all frequencies, 1 < γ < 3: −A (2πx)^(γ−1)/(Γ(γ) cos(πγ/2)) · π."""
    x = np.abs(np.asarray(lag_m, np.float64))
    return np.asarray(
        -level * np.pi * (2.0 * np.pi * x) ** (slope - 1.0) / (gamma(slope) * np.cos(0.5 * np.pi * slope))
    )


def intrinsic_covariance(lag_m: npt.ArrayLike, slope: float, scale_m: float, aperture_m: float = 0.0) -> Float:
    """Generalised covariance K(x) [m^(γ−1)] of S = f^−γ at all frequencies, 1 < γ < 5.

        K(x) = π (2π)^(γ−1)/(2 Γ(γ) cos(πγ/2)) (|x|^(γ−1) − scale^(γ−3) x²)

    Main arguments:
        scale_m: any length, such as that of the profile: K is defined but for constants and x², and this one is finite at γ = 3.
    Other arguments:
        aperture_m: length over which each height is an average; 0 for heights at points.

    Σ_ij w_i w_j K(s_i − s_j) is the variance of Σ w_i h(s_i) for weights with Σ w_i = Σ w_i s_i = 0 (to γ = 3 Σ w_i = 0 is enough);
    for other weights it has no meaning. Raises ValueError for a slope beyond the limits.
    """
    if not 1.0 < slope < 5.0:
        raise ValueError(f"a generalised covariance of order 1 needs 1 < slope < 5, not {slope!r}")
    if abs(slope - 3.0) < _NEAREST:
        slope = 3.0 + _NEAREST
    u, power = np.abs(np.asarray(lag_m, np.float64)) / scale_m, slope - 1.0
    if aperture_m > 0.0:
        # The mean of |x + t|^p over the triangle of two apertures; that of x² differs from x² by a constant.
        a = aperture_m / scale_m
        parts = (u + a) ** (power + 2.0) - 2.0 * u ** (power + 2.0) + np.abs(u - a) ** (power + 2.0)
        raised = parts / (a * a * (power + 1.0) * (power + 2.0)) - a * a / 6.0
    else:
        raised = u**power
    factor = np.pi * (2.0 * np.pi) ** power / (2.0 * gamma(slope) * np.cos(0.5 * np.pi * slope))
    return np.asarray(factor * scale_m**power * (raised - u * u))
