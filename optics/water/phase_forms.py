"""Phase functions β̃(ψ) of scattering, 1/sr, normalised to ∫ β̃ dΩ = 1, and their closed-form distributions over angle.

Shapes are plain data; `phase_density` and `phase_cdf` take any of them. ψ is the scattering angle, 0 … π.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ..correlation.parts import Array

__all__ = [
    "FournierForand", "HenyeyGreenstein", "MolecularPhase", "PhaseFunction", "TabulatedPhase", "phase_cdf",
    "phase_density",
]  # fmt: skip


@dataclass(frozen=True)
class HenyeyGreenstein:
    """β̃ = (1 − g²)/(4π(1 + g² − 2g cosψ)^{3/2}), −1 < g < 1 the mean cosine (Henyey and Greenstein 1941).

    For natural water it is 2-8 times too low backward when g is fitted to the mean cosine.
    """

    g: float

    def __post_init__(self) -> None:
        if not -1.0 < self.g < 1.0:
            raise ValueError(f"g must lie between -1 and 1, not {self.g!r}")


@dataclass(frozen=True)
class FournierForand:
    """Fournier and Forand's phase function in the form of Fournier and Jonasz 1999 (Proc. SPIE 3761:62).

    `index` n: real refractive index of the particles relative to water, 1 < n < 1.5; `slope` μ: that of the Junge size
    distribution, 3 < μ < 5. With δ = 4 sin²(ψ/2)/(3(n − 1)²), ν = (3 − μ)/2 and δ_π = δ(π):

        4π β̃ = {ν(1 − δ) − (1 − δ^ν) + [δ(1 − δ^ν) − ν(1 − δ)]/sin²(ψ/2)}/((1 − δ)² δ^ν)
                + (1 − δ_π^ν)(3 cos²ψ − 1)/(4(δ_π − 1) δ_π^ν).

    β̃ ∝ ψ^{−2(1 + ν)} toward ψ = 0: singular there, but integrable.
    """

    index: float
    slope: float

    def __post_init__(self) -> None:
        if not 1.0 < self.index < 1.5:
            raise ValueError(f"index must lie between 1 and 1.5, not {self.index!r}")
        if not 3.0 < self.slope < 5.0:
            raise ValueError(f"slope (of the Junge distribution) must lie between 3 and 5, not {self.slope!r}")


@dataclass(frozen=True)
class MolecularPhase:
    """Density fluctuations of a pure liquid: β̃ = 3(1 + p cos²ψ)/(4π(3 + p)), p = (1 − d)/(1 + d) (Morel 1974).

    `depolarisation` d, 0 ≤ d < 1: 0.09 in pure water; 0 is Rayleigh's law.
    """

    depolarisation: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.depolarisation < 1.0:
            raise ValueError(f"depolarisation must be at least 0 and below 1, not {self.depolarisation!r}")

    @property
    def ratio(self) -> float:
        """p = (1 − d)/(1 + d)."""
        return (1.0 - self.depolarisation) / (1.0 + self.depolarisation)


@dataclass(frozen=True)
class TabulatedPhase:
    """Values at ascending angles up to π, a power law between neighbours (linear in log-log); scaled to ∫ β̃ dΩ = 1.

    Below the first angle β̃ ∝ ψ^{forward_slope}, forward_slope > −2 so that it can be integrated.
    """

    angle_rad: tuple[float, ...]
    value: tuple[float, ...]
    forward_slope: float

    def __post_init__(self) -> None:
        angle, value = np.asarray(self.angle_rad), np.asarray(self.value)
        if angle.ndim != 1 or angle.shape != value.shape or angle.size < 2:
            raise ValueError("angle_rad and value need the same length, at least 2")
        if not (angle[0] > 0.0 and np.all(np.diff(angle) > 0.0) and abs(angle[-1] - np.pi) < 1e-6):
            raise ValueError("angle_rad must ascend from above 0 to π")
        if not (np.all(value > 0.0) and np.all(np.isfinite(value))):
            raise ValueError("The values of a phase function must be positive.")
        if not self.forward_slope > -2.0:
            raise ValueError(f"forward_slope must be above -2, not {self.forward_slope!r}: the integral would diverge")


PhaseFunction = HenyeyGreenstein | FournierForand | MolecularPhase | TabulatedPhase


def phase_density(phase: PhaseFunction, angle_rad: ArrayLike) -> Array:
    """β̃(ψ), 1/sr, for ψ = `angle_rad` in 0 … π of any shape; infinite at ψ = 0 where the shape is singular."""
    psi = np.asarray(angle_rad, dtype=np.float64)
    if isinstance(phase, HenyeyGreenstein):
        # 1 + g² − 2g cosψ = (1 − g)² + 4g sin²(ψ/2), without cancellation at small angles
        base = (1.0 - phase.g) ** 2 + 4.0 * phase.g * np.sin(0.5 * psi) ** 2
        return np.asarray((1.0 - phase.g**2) / (4.0 * np.pi * base**1.5))
    if isinstance(phase, MolecularPhase):
        return np.asarray(3.0 * (1.0 + phase.ratio * np.cos(psi) ** 2) / (4.0 * np.pi * (3.0 + phase.ratio)))
    if isinstance(phase, FournierForand):
        return _fournier_forand(phase, psi)
    log_angle, log_value, _ = _table(phase)
    with np.errstate(divide="ignore"):
        x = np.log(psi)
    below = log_value[0] + phase.forward_slope * (x - log_angle[0])
    return np.exp(np.where(x < log_angle[0], below, np.interp(x, log_angle, log_value)))


def phase_cdf(phase: PhaseFunction, angle_rad: ArrayLike) -> Array:
    """F(ψ) = 2π ∫₀^ψ β̃ sinψ' dψ': the share of scattered light deflected by less than ψ; F(π) = 1."""
    psi = np.asarray(angle_rad, dtype=np.float64)
    half = np.sin(0.5 * psi) ** 2
    if isinstance(phase, HenyeyGreenstein):
        g = phase.g
        if abs(g) < 1e-6:
            return np.asarray(half + 3.0 * g * half * (1.0 - half))
        # (1 − g²)/2g · [1/(1 − g) − 1/√D], written without its cancellation at small ψ
        root = np.sqrt((1.0 - g) ** 2 + 4.0 * g * half)
        return np.asarray(2.0 * (1.0 + g) * half / (root * (root + (1.0 - g))))
    if isinstance(phase, MolecularPhase):
        p = phase.ratio
        return np.asarray(half * (3.0 + p * (3.0 - 6.0 * half + 4.0 * half**2)) / (3.0 + p))
    if isinstance(phase, FournierForand):
        return _fournier_forand_cdf(phase, psi)
    return _table_cdf(phase, psi)


def _delta(phase: FournierForand, half: Array) -> Array:
    return np.asarray(4.0 / (3.0 * (phase.index - 1.0) ** 2) * half)


def _fournier_forand(phase: FournierForand, psi: Array) -> Array:
    half = np.sin(0.5 * psi) ** 2
    delta = _delta(phase, half)
    nu = 0.5 * (3.0 - phase.slope)
    with np.errstate(divide="ignore", invalid="ignore"):
        power = delta**nu
        first = nu * (1.0 - delta) - (1.0 - power)
        second = delta * (1.0 - power) - nu * (1.0 - delta)
        plain = (first + second / half) / ((1.0 - delta) ** 2 * power)
    # Near δ = 1 both brackets cancel to second order: a Taylor series is used there.
    e = delta - 1.0
    first_series = nu * (nu - 1) * (0.5 + (nu - 2) * e / 6 * (1 + (nu - 3) * e / 4 * (1 + (nu - 4) * e / 5)))
    second_series = -(nu + 1) * nu * (0.5 + (nu - 1) * e / 6 * (1 + (nu - 2) * e / 4 * (1 + (nu - 3) * e / 5)))
    with np.errstate(divide="ignore", invalid="ignore"):
        series = (first_series + second_series / half) / power
    back = _back_term(phase) * (3.0 * np.cos(psi) ** 2 - 1.0)
    value = (np.where(np.abs(e) < 1e-3, series, plain) + 0.25 * back) / (4.0 * np.pi)
    return np.where(psi == 0.0, np.inf, value)


def _back_term(phase: FournierForand) -> float:
    top = float(_delta(phase, np.asarray(1.0)))
    power = top ** (0.5 * (3.0 - phase.slope))
    return float((1.0 - power) / ((top - 1.0) * power))


def _fournier_forand_cdf(phase: FournierForand, psi: Array) -> Array:
    """Fournier and Jonasz's integral: [1 − δ^{ν+1} − (1 − δ^ν) sin²(ψ/2)]/((1 − δ)δ^ν) + back term · cosψ sin²ψ/8."""
    half = np.sin(0.5 * psi) ** 2
    delta = _delta(phase, half)
    nu = 0.5 * (3.0 - phase.slope)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = delta**-nu
        plain = (inverse - delta - (inverse - 1.0) * half) / (1.0 - delta)
    e = delta - 1.0
    # (1 − δ^m)/(1 − δ) = m(1 + (m − 1)e/2(1 + (m − 2)e/3(1 + …))) near δ = 1
    m = nu + 1.0
    one = m * (1 + (m - 1) * e / 2 * (1 + (m - 2) * e / 3 * (1 + (m - 3) * e / 4)))
    two = nu * (1 + (nu - 1) * e / 2 * (1 + (nu - 2) * e / 3 * (1 + (nu - 3) * e / 4)))
    with np.errstate(divide="ignore", invalid="ignore"):
        series = (one - two * half) * inverse
    back = 0.125 * _back_term(phase) * np.cos(psi) * np.sin(psi) ** 2
    return np.where(psi == 0.0, 0.0, np.where(np.abs(e) < 1e-3, series, plain) + back)


_NODE, _WEIGHT = np.polynomial.legendre.leggauss(10)


@lru_cache(maxsize=32)
def _table(phase: TabulatedPhase) -> tuple[Array, Array, Array]:
    """ln ψ, ln β̃ (normalised) at the table's angles, and F there."""
    log_angle = np.log(np.asarray(phase.angle_rad))
    log_value = np.log(np.asarray(phase.value))
    # below the first angle sinψ ≈ ψ(1 − ψ²/6)
    first = phase.angle_rad[0]
    m = phase.forward_slope + 2.0
    start = 2.0 * np.pi * phase.value[0] * first**2 * (1.0 / m - first**2 / (6.0 * (m + 2.0)))
    half = 0.5 * np.diff(log_angle)[:, None]
    x = log_angle[:-1, None] + half * (_NODE + 1.0)
    y = np.interp(x, log_angle, log_value)
    cell = np.sum(half * _WEIGHT * np.exp(y + x) * np.sin(np.exp(x)), axis=1) * 2.0 * np.pi
    cdf = start + np.concatenate([[0.0], np.cumsum(cell)])
    return log_angle, log_value - np.log(cdf[-1]), np.asarray(cdf / cdf[-1])


def _table_cdf(phase: TabulatedPhase, psi: Array) -> Array:
    log_angle, log_value, cdf = _table(phase)
    flat = np.minimum(psi.ravel(), np.pi)
    with np.errstate(divide="ignore"):
        x = np.log(flat)
    i = np.clip(np.searchsorted(log_angle, x, side="right") - 1, 0, log_angle.size - 2)
    half = 0.5 * np.maximum(x - log_angle[i], 0.0)[:, None]
    node = log_angle[i][:, None] + half * (_NODE + 1.0)
    y = np.interp(node, log_angle, log_value)
    inside = cdf[i] + 2.0 * np.pi * np.sum(half * _WEIGHT * np.exp(y + node) * np.sin(np.exp(node)), axis=1)
    m = phase.forward_slope + 2.0
    first = np.exp(log_angle[0])
    below = cdf[0] * (flat / first) ** m
    return np.asarray(np.where(x < log_angle[0], below, np.minimum(inside, 1.0)).reshape(psi.shape))
