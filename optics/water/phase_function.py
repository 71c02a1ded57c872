"""Quantities of a phase function: mean cosine, backscatter fraction, quantiles, and the shape for a given fraction."""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ..correlation.parts import Array
from .phase_forms import (
    FournierForand,
    HenyeyGreenstein,
    MolecularPhase,
    PhaseFunction,
    TabulatedPhase,
    phase_cdf,
)

__all__ = [
    "asymmetry", "backscatter_fraction", "fournier_forand_of_backscatter", "mean_square_angle", "phase_cells",
    "phase_from_spec", "phase_quantile",
]  # fmt: skip

_FINEST_RAD = 1e-9
_KINDS: dict[str, type[PhaseFunction]] = {
    kind.__name__: kind for kind in (HenyeyGreenstein, FournierForand, MolecularPhase, TabulatedPhase)
}


def phase_from_spec(spec: object) -> PhaseFunction:
    """The phase function with the class name and fields of `spec`. Raises TypeError for any other object."""
    kind = _KINDS.get(type(spec).__name__)
    if kind is None:
        raise TypeError(f"not a phase function: {spec!r}; phase functions: {', '.join(_KINDS)}")
    return kind(**{field.name: getattr(spec, field.name) for field in dataclasses.fields(kind)})


@lru_cache(maxsize=64)
def phase_cells(phase: PhaseFunction, cells: int = 6000, largest_rad: float = np.pi) -> tuple[Array, Array]:
    """A fine histogram of the scattering angle: (middle angles [rad], shares of light), `cells` cells even in ln ψ.

    The first cell begins at ψ = 0 and ends at 1e-9 rad; shares sum to F(largest_rad). The arrays are cached: do not
    modify them.
    """
    edge = np.geomspace(_FINEST_RAD, largest_rad, cells)
    cdf = phase_cdf(phase, edge)
    middle = np.concatenate([[0.5 * _FINEST_RAD], np.sqrt(edge[1:] * edge[:-1])])
    share = np.maximum(np.diff(cdf, prepend=0.0), 0.0)
    for a in (middle, share):
        a.setflags(write=False)
    return middle, share


def asymmetry(phase: PhaseFunction) -> float:
    """g = 2π ∫ β̃ cosψ sinψ dψ, the mean cosine of the scattering angle; −1 … 1.

    g = 1 − ∫ (1 − cosψ) dF = −1 + ∫₀^π F sinψ dψ by parts, which is smooth however sharp the forward peak is.
    """
    if isinstance(phase, HenyeyGreenstein):
        return phase.g
    node, weight = np.polynomial.legendre.leggauss(12)
    edge = np.concatenate([[0.0], np.geomspace(1e-7, np.pi, 400)])
    half = 0.5 * np.diff(edge)[:, None]
    psi = edge[:-1, None] + half * (node + 1.0)
    return float(-1.0 + np.sum(half * weight * phase_cdf(phase, psi) * np.sin(psi)))


def backscatter_fraction(phase: PhaseFunction) -> float:
    """B = b_b/b = 1 − F(π/2): the share of scattered light deflected by more than a right angle."""
    return float(1.0 - phase_cdf(phase, 0.5 * np.pi))


def mean_square_angle(phase: PhaseFunction, largest_rad: float = 0.5 * np.pi) -> float:
    """⟨ψ²⟩ [rad²] of the light deflected by less than `largest_rad`: ∫ψ² dF / F."""
    psi, share = phase_cells(phase, largest_rad=largest_rad)
    return float(np.sum(psi**2 * share) / np.sum(share))


def phase_quantile(phase: PhaseFunction, share: ArrayLike) -> Array:
    """ψ [rad] with F(ψ) = share, share in 0 … 1: the inverse distribution from which directions are sampled.

    Closed form for Henyey-Greenstein; else linear in ln ψ between the edges of 6000 cells (relative error of ψ < 1e-5);
    the light below the first edge, 1e-9 rad, is placed there.
    """
    u = np.asarray(share, dtype=np.float64)
    if isinstance(phase, HenyeyGreenstein):
        # with F = 2(1 + g)h/(w(w + 1 − g)) and w² = (1 − g)² + 4gh:  w = (1 − g²)/(1 + g − 2gF)
        g = phase.g
        if abs(g) < 1e-6:
            half = u - 3.0 * g * u * (1.0 - u)
        else:
            t = 1.0 + g - 2.0 * g * u
            half = (1.0 - g) ** 2 * u * (1.0 + g - g * u) / t**2
        return np.asarray(2.0 * np.arcsin(np.sqrt(np.clip(half, 0.0, 1.0))))
    edge = np.geomspace(_FINEST_RAD, np.pi, 6000)
    return np.exp(np.interp(u, phase_cdf(phase, edge), np.log(edge)))


def fournier_forand_of_backscatter(fraction: float) -> FournierForand:
    """The Fournier-Forand function with backscatter fraction B on the line n = 1.01 + .1542(μ − 3), μ = 3.02 … 4.6.

    The line is that of Mobley, Sundman and Boss (Appl. Opt. 41:1035, 2002); B = .0183 gives n = 1.10, μ = 3.58, their
    fit to Petzold's turbid waters. Raises ValueError outside the B that the line reaches.
    """
    from scipy.optimize import brentq

    def shape(mu: float) -> FournierForand:
        return FournierForand(1.01 + 0.1542 * (mu - 3.0), mu)

    low, high = 3.02, 4.6
    least, most = backscatter_fraction(shape(low)), backscatter_fraction(shape(high))
    if not least <= fraction <= most:
        raise ValueError(f"fraction (of backscatter) must lie between {least:.2g} and {most:.2g}, not {fraction!r}")
    root = brentq(lambda mu: backscatter_fraction(shape(mu)) - fraction, low, high, xtol=1e-12)
    return shape(float(root))
