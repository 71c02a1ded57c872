"""Optical turbulence of sea water: the spectrum of Nikishov & Nikishov 2000, its structure function, and screens.

    Φ_n(κ) = (C₀ A²/4π) ε^{−1/3} (χ_T/w²) κ^{−11/3} [1 + C₁ (κη)^{2/3}] (w² e^{−A_T δ} + e^{−A_S δ} − 2w e^{−A_TS δ}),
    δ = (3/2) C₁² (κη)^{4/3} + C₁³ (κη)²,    A_i = C₀/(C₁² Pr_i),    1/Pr_TS = (1/Pr_T + 1/Pr_S)/2,

C₀ = .72, C₁ = 2.35, A = 2.6e-4 1/K, Pr_T = 7, Pr_S = 700: .388e-8, 1.863e-2, 1.9e-4, 9.41e-3 of the paper. χ_T [K²/s] and ε
[m²/s³] are the rates of dissipation, η = (ν³/ε)^{1/4} Kolmogorov's length, w < 0 the balance of temperature (−5) to salinity (→ 0).
Salt and heat are taken to mix alike, as the paper does. Each scalar g(x) satisfies the dissipation identity

    (2 C₀/Pr) ∫ x^{1/3} g(x) dx = 1,    g = [1 + C₁ x^{2/3}] e^{−A_i δ(x)},

exactly, which `dissipation` states. At fixed χ_T more stirring (ε) means weaker turbulence: Φ falls as ε^{−1/3}.

The spectrum of Yao et al. 2019 is left out: with the coefficients as we know them, g = [1 + 21.61 x^{.61} c^{.02} −
18.18 x^{.55} c^{.04}] e^{−174.9 x² c^{.96}}, c = .072^{4/3} β/Pr, `dissipation` is .898 for Pr = 7 and .813 for Pr = 700
instead of 1, and the paper itself could not be consulted.

Sources: V. V. Nikishov and V. I. Nikishov, Int. J. Fluid Mech. Res. 27:82, 2000; R. J. Hill, J. Fluid Mech. 88:541, 1978
(identity).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from scipy.special import j0, j1

from .embedding import ScreenPlan, structure_plan
from .strength import coherence_length_m, positive

__all__ = ["OceanicTurbulence", "dissipation", "nikishov_scalar", "oceanic_plan", "oceanic_r0_m", "oceanic_structure"]

Float = NDArray[np.float64]

OBUKHOV_CORRSIN, INNER = 0.72, 2.35
THERMAL_PER_K = 2.6e-4


@dataclass(frozen=True)
class OceanicTurbulence:
    """Sea water of one state of turbulence.

    Main arguments:
        dissipation_m2_per_s3: ε, 1e-10 … 1e-1. temperature_k2_per_s: χ_T, 1e-10 … 1e-4. balance: w, −5 ≤ w < 0.

    Other arguments:
        viscosity_m2_per_s: ν. prandtl, schmidt: Pr_T, Pr_S.

    Raises ValueError for values that are not positive or a w outside its range.
    """

    dissipation_m2_per_s3: float
    temperature_k2_per_s: float
    balance: float
    viscosity_m2_per_s: float = 1.0e-6
    prandtl: float = 7.0
    schmidt: float = 700.0

    def __post_init__(self) -> None:
        for name in ("dissipation_m2_per_s3", "temperature_k2_per_s", "viscosity_m2_per_s", "prandtl", "schmidt"):
            positive(getattr(self, name), name)
        if not -5.0 <= self.balance < 0.0:
            raise ValueError(f"balance must be −5 … 0 (0 excluded), not {self.balance!r}.")

    @property
    def inner_scale_m(self) -> float:
        """Kolmogorov's length η [m]."""
        return float((self.viscosity_m2_per_s**3 / self.dissipation_m2_per_s3) ** 0.25)

    @property
    def strength(self) -> float:
        """The factor of κ^{−11/3} at small κη and w → −∞: (C₀ A²/4π) ε^{−1/3} χ_T [m^{−2/3}]."""
        factor = OBUKHOV_CORRSIN * THERMAL_PER_K**2 / (4.0 * np.pi)
        return float(factor * self.dissipation_m2_per_s3 ** (-1.0 / 3.0) * self.temperature_k2_per_s)

    def shape(self, wave_number: ArrayLike) -> Float:
        """h(κη) [1]: Φ_n = strength · κ^{−11/3} · h."""
        w, x = self.balance, np.asarray(wave_number, np.float64)
        mixed = 2.0 / (1.0 / self.prandtl + 1.0 / self.schmidt)
        fall = [_fall(x, prandtl) for prandtl in (self.prandtl, self.schmidt, mixed)]
        return np.asarray((1.0 + INNER * x ** (2.0 / 3.0)) * (w**2 * fall[0] + fall[1] - 2.0 * w * fall[2]) / w**2)

    def spectrum(self, wave_number_per_m: ArrayLike) -> Float:
        """Φ_n(κ) [m³] of the index, κ [rad/m]."""
        kappa = np.asarray(wave_number_per_m, np.float64)
        return np.asarray(self.strength * kappa ** (-11.0 / 3.0) * self.shape(kappa * self.inner_scale_m))


def dissipation(shape: Callable[[float], float], prandtl: float, constant: float = OBUKHOV_CORRSIN) -> float:
    """(2β/Pr) ∫₀^∞ x^{1/3} g(x) dx, which is 1 for every scalar spectrum g(κη) that conserves the scalar's variance."""
    # x = e^t; the integrand has one hump.
    value = quad(
        lambda t: np.exp(4.0 / 3.0 * t) * shape(float(np.exp(t))), -30.0, 8.0, limit=400, epsabs=0.0, epsrel=1e-10
    )[0]
    return float(2.0 * constant / prandtl * value)


def nikishov_scalar(x: float, prandtl: float) -> float:
    """g(x) of one scalar with this Prandtl or Schmidt number: [1 + C₁ x^{2/3}] e^{−A δ(x)}."""
    return float((1.0 + INNER * x ** (2.0 / 3.0)) * _fall(np.float64(x), prandtl))


def oceanic_structure(
    water: OceanicTurbulence, separation_m: ArrayLike, path_m: float, wavelength_m: float, *, cycles: float = 60.0
) -> Float:
    """D(ρ) = 8π² k₀² L ∫ κ Φ_n (1 − J₀(κρ)) dκ [rad²] of a plane wave after a path L; the shape of `separation_m`.

    Main arguments:
        separation_m: ρ. path_m: L. wavelength_m: in vacuum.

    Other arguments:
        cycles: of J₀ that are integrated; beyond, 1 alone is kept. Their share of D is below 1e-7.
    """
    rho = np.asarray(separation_m, np.float64)
    k0 = 2.0 * np.pi / positive(wavelength_m, "wavelength_m")
    flat = np.ravel(np.abs(rho))
    values = np.array([_hankel(water, float(r), cycles) if r > 0 else 0.0 for r in flat])
    return np.asarray((8.0 * np.pi**2 * k0**2 * path_m * water.strength * values).reshape(rho.shape))


def oceanic_r0_m(water: OceanicTurbulence, path_m: float, wavelength_m: float) -> float:
    """The separation [m] at which D = 6.88388 rad²: r₀ of a spectrum that is no power law. ValueError beyond 1e-6 … 1e3 m."""
    return coherence_length_m(lambda r: oceanic_structure(water, r, path_m, wavelength_m), 1e-6, 1e3)


def oceanic_plan(
    water: OceanicTurbulence, path_m: float, wavelength_m: float, shape: tuple[int, int], spacing_m: float
) -> ScreenPlan:
    """Plan of phase screens of such water by intrinsic embedding; `clipped` reports power that had to be set to zero.

    D is tabulated at 24 separations per octave between a quarter of the spacing and the diagonal and interpolated by a cubic
    spline in log ρ and log D, to 1e-6. Grids far below the inner scale see smooth fields, whose embedding needs a larger torus.
    """
    reach = spacing_m * float(np.hypot(shape[0] - 1, shape[1] - 1))
    low, high = np.log(0.25 * positive(spacing_m, "spacing_m")), np.log(1.01 * max(reach, spacing_m))
    nodes = np.linspace(low, high, int(24 * (high - low) / np.log(2.0)) + 8)
    table = CubicSpline(nodes, np.log(oceanic_structure(water, np.exp(nodes), path_m, wavelength_m)))

    def structure(r: Float) -> Float:
        inside = np.maximum(r, np.exp(low))
        return np.where(r > 0, np.exp(table(np.log(inside))), 0.0)

    # The torus with the least clipped power; the smallest one is right for most waters.
    best: ScreenPlan | None = None
    for limit in (2.0, 3.0, 5.0):
        plan = structure_plan(structure, shape, spacing_m, limit=limit)
        if best is None or plan.clipped < best.clipped:
            best = plan
        if best.clipped < 1e-8:
            break
    assert best is not None
    return best


def _fall(x: ArrayLike, prandtl: float) -> Float:
    x = np.asarray(x, np.float64)
    delta = 1.5 * INNER**2 * x ** (4.0 / 3.0) + INNER**3 * x**2
    return np.asarray(np.exp(-OBUKHOV_CORRSIN / (INNER**2 * prandtl) * delta))


def _hankel(water: OceanicTurbulence, rho: float, cycles: float) -> float:
    """∫ κ^{−8/3} h(κη) (1 − J₀(κρ)) dκ: logarithmic panels to κρ = 2, panels of half a cycle up to `cycles`, then 1 alone; the
    first term of the series below the lowest panel, where the integral converges only as κ^{1/3}."""
    node, weight = np.polynomial.legendre.leggauss(12)
    edges = np.concatenate([2.0 * np.exp(np.linspace(-24.0, 0.0, 33)), 2.0 + np.pi * np.arange(1, int(2 * cycles) + 1)])
    half = 0.5 * np.diff(edges)[:, None]
    u = 0.5 * (edges[1:] + edges[:-1])[:, None] + half * node
    factor = np.where(u < 1e-3, 0.25 * u**2, 1.0 - j0(u))
    inner = (half * weight * u ** (-8.0 / 3.0) * water.shape(u * water.inner_scale_m / rho) * factor).sum()
    # Beyond: ∫ u^{−8/3} h du in log u, and the first term of the cut J₀.
    top = float(edges[-1])
    log_edges = np.log(top) + np.linspace(0.0, 16.0, 41)
    half = 0.5 * np.diff(log_edges)[:, None]
    v = np.exp(0.5 * (log_edges[1:] + log_edges[:-1])[:, None] + half * node)
    outer = (half * weight * v ** (-5.0 / 3.0) * water.shape(v * water.inner_scale_m / rho)).sum()
    edge = top ** (-8.0 / 3.0) * float(water.shape(top * water.inner_scale_m / rho)) * float(j1(top))
    start = 0.75 * edges[0] ** (1.0 / 3.0) * float(water.shape(0.0))
    return float((start + inner + outer + edge) * rho ** (5.0 / 3.0))
