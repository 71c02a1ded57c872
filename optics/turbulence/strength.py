"""How strong turbulence is: Fried's r₀, the Kolmogorov structure function, refractive-index structure along a path, Rytov's
variance.

    D(ρ) = 2 [24/5 Γ(6/5)]^{5/6} (ρ/r₀)^{5/3} = 6.88388 (ρ/r₀)^{5/3} rad²,    D(ρ) = 2.9144 k₀² ρ^{5/3} ∫ C_n²(z) w(z) dz.

k₀ = 2π/λ with λ the wavelength in vacuum, because the phase is k₀ ∫ δn dz; diffraction has λ/n. w = 1 for a plane wave,
(z/L)^{5/3} for a spherical wave from z = 0 that is received at L.

Sources: D. L. Fried, JOSA 56:1372, 1966; R. J. Noll, JOSA 66:207, 1976; L. C. Andrews and R. L. Phillips, Laser Beam Propagation
through Random Media, 2005, ch. 3, 6 and 8.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gamma

__all__ = [
    "FRIED", "KOLMOGOROV_INDEX", "PATH_FACTOR", "coherence_length_m", "kolmogorov_structure", "path_structure", "positive",
    "r0_from_cn2_m",
    "rytov_variance", "together_m",
]  # fmt: skip

Float = NDArray[np.float64]

#: D(r₀) of the phase [rad²]: 2 [24/5 Γ(6/5)]^{5/6} = 6.88388.
FRIED = float(2.0 * (24.0 / 5.0 * gamma(6.0 / 5.0)) ** (5.0 / 6.0))

#: Φ_n(κ) = 0.033005 C_n² κ^{−11/3}: Γ(8/3) sin(π/3)/(4π²).
KOLMOGOROV_INDEX = float(gamma(8.0 / 3.0) * np.sin(np.pi / 3.0) / (4.0 * np.pi**2))


def _path_factor() -> float:
    """2.9144 = 8π² · 0.033005 · ∫ x^{−8/3} (1 − J₀(x)) dx."""
    hankel = -(2.0 ** (-8.0 / 3.0)) * gamma(-5.0 / 6.0) / gamma(11.0 / 6.0)
    return float(8.0 * np.pi**2 * KOLMOGOROV_INDEX * hankel)


#: D = 2.9144 k₀² ρ^{5/3} ∫ C_n² dz.
PATH_FACTOR = _path_factor()


def kolmogorov_structure(separation_m: ArrayLike, r0_m: float) -> Float:
    """D(ρ) = 6.88388 (ρ/r₀)^{5/3} [rad²]: mean square difference of the phases of points `separation_m` apart."""
    return np.asarray(FRIED * (np.abs(np.asarray(separation_m, np.float64)) / positive(r0_m, "r0_m")) ** (5.0 / 3.0))


def path_structure(cn2_m: ArrayLike, thickness_m: ArrayLike, wavelength_m: float) -> Float:
    """∫ 2.9144 k₀² C_n² dz per layer [m^{−5/3}]: the factor of ρ^{5/3} in D. `cn2_m` [m^{−2/3}], `thickness_m` [m] of the
    layers."""
    k = 2.0 * np.pi / positive(wavelength_m, "wavelength_m")
    return np.asarray(PATH_FACTOR * k**2 * np.asarray(cn2_m, np.float64) * np.asarray(thickness_m, np.float64))


def r0_from_cn2_m(
    cn2_m: ArrayLike, thickness_m: ArrayLike, wavelength_m: float, *, distance_share: ArrayLike = 1.0
) -> float:
    """r₀ [m] of a path: (0.4233 k₀² Σ C_n² w Δz)^{−3/5}; infinite without turbulence.

    Main arguments:
        cn2_m, thickness_m (layers): C_n² [m^{−2/3}] and thickness [m]. wavelength_m: in vacuum.

    Other arguments:
        distance_share (layers): z/L of a spherical wave from its source to the sensor, so that w = (z/L)^{5/3}; 1 for a plane wave.

    Raises ValueError for a negative C_n² or thickness.
    """
    c, d = np.asarray(cn2_m, np.float64), np.asarray(thickness_m, np.float64)
    if (c < 0).any() or (d < 0).any():
        raise ValueError("cn2_m and thickness_m must not be negative.")
    weighted = path_structure(c, d, wavelength_m) * np.asarray(distance_share, np.float64) ** (5.0 / 3.0)
    total = float(weighted.sum())
    return float((FRIED / total) ** 0.6) if total > 0 else float(np.inf)


def together_m(r0_m: ArrayLike) -> float:
    """r₀ [m] of independent layers one behind the other: (Σ r₀^{−5/3})^{−3/5}, since structure functions add."""
    total = float((np.asarray(r0_m, np.float64) ** (-5.0 / 3.0)).sum())
    return float(total**-0.6) if total > 0 else float(np.inf)


def coherence_length_m(structure_function: object, low_m: float, high_m: float) -> float:
    """The r₀ [m] of any spectrum: the separation at which D = 6.88388 rad².

    `structure_function` maps metres to rad². Raises ValueError where the crossing does not lie in `low_m` … `high_m`.
    """
    from scipy.optimize import brentq

    if not callable(structure_function):
        raise TypeError("structure_function must be a function of a separation in metres.")

    def over(log_separation: float) -> float:
        return float(np.log(np.asarray(structure_function(np.exp(log_separation))) / FRIED))

    a, b = np.log(positive(low_m, "low_m")), np.log(positive(high_m, "high_m"))
    if over(a) > 0 or over(b) < 0:
        raise ValueError(f"D = {FRIED:.5f} rad² is not reached between low_m = {low_m!r} and high_m = {high_m!r}.")
    return float(np.exp(brentq(over, a, b, xtol=1e-12)))


def rytov_variance(cn2_m: float, path_m: float, wavelength_m: float, index: float = 1.0) -> float:
    """σ_R² = 1.23 C_n² k₀^{7/6} n^{−5/6} L^{11/6}: variance of log irradiance of a plane wave in weak, even turbulence.

    `cn2_m` [m^{−2/3}] of the index itself, `path_m` L, `wavelength_m` in vacuum, `index` n: the phase has k₀, diffraction k₀ n.
    Split-step propagation is needed where it exceeds about .05.
    """
    k = 2.0 * np.pi / positive(wavelength_m, "wavelength_m")
    factor = 1.2285  # 8π² · 0.033005 · ∫∫ κ^{-8/3} (1 − cos(κ² z/k)) dκ dz in closed form; tested by quadrature
    return float(factor * cn2_m * k ** (7.0 / 6.0) * index ** (-5.0 / 6.0) * path_m ** (11.0 / 6.0))


def positive(value: float, name: str) -> float:
    """The value, or ValueError where it is not positive and finite."""
    if not (value > 0 and np.isfinite(value)):
        raise ValueError(f"{name} must be positive and finite, not {value!r}.")
    return float(value)
