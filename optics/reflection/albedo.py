"""Hemispherical albedo of any response by quadrature, and the energy check."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from .angles import Angles, Array, angles

__all__ = ["albedo_limit", "conserves_energy", "hemispherical_albedo"]


@lru_cache(maxsize=16)
def _legendre(order: int) -> tuple[Array, Array]:
    """Gauss-Legendre nodes and weights on [0, 1]."""
    x, w = np.polynomial.legendre.leggauss(order)
    return 0.5 * (x + 1.0), 0.5 * w


def hemispherical_albedo(
    response: Callable[[Angles], Array],
    theta_i: ArrayLike,
    *,
    polar_nodes: int = 16,
    azimuth_nodes: int = 48,
    finest_lobe_rad: float = 1e-4,
) -> Array:
    """Share of the light that arrives at θi [rad, 0 <= θi < π/2] and leaves again: ∫ response·cosθo dωo / cosθi.

    Main arguments: `response` maps Angles to f·cosθi [1/sr] of an isotropic surface; `theta_i` of any shape, which the
    result has too.
    Other arguments: nodes per panel and half circle; the narrowest lobe to resolve.

    Polar coordinates about the mirror direction, where lobes are: panels that double in width from `finest_lobe_rad`,
    broken where a circle first meets the horizon; the azimuth ends exactly at the horizon. Gauss-Legendre in both.
    Raises ValueError for an incidence outside [0, π/2).
    """
    theta = np.asarray(theta_i, dtype=np.float64)
    if np.any((theta < 0.0) | (theta >= 0.5 * np.pi)):
        raise ValueError("incidence must lie in [0, π/2)")
    out = [_albedo_at(response, float(t), polar_nodes, azimuth_nodes, finest_lobe_rad) for t in theta.ravel()]
    return np.asarray(out, dtype=np.float64).reshape(theta.shape)


def _albedo_at(
    response: Callable[[Angles], Array], theta: float, polar_nodes: int, azimuth_nodes: int, finest: float
) -> float:
    x, wx = _legendre(polar_nodes)
    y, wy = _legendre(azimuth_nodes)
    touch, end = 0.5 * np.pi - theta, 0.5 * np.pi + theta
    doubling = finest * 2.0 ** np.arange(np.ceil(np.log2(end / finest)))
    # Panels also halve towards the touch point: there the visible arc shrinks as a square root.
    halving = touch + theta * 2.0 ** -np.arange(1.0, 12.0)
    edges = np.unique(np.concatenate(([0.0, touch, end], doubling[doubling < end], halving[halving < end])))
    width = np.diff(edges)
    gamma = (edges[:-1, None] + width[:, None] * x).ravel()
    weight = (width[:, None] * wx).ravel() * np.sin(gamma)
    ct, st = np.cos(theta), np.sin(theta)
    cg, sg = np.cos(gamma), np.sin(gamma)
    # The eye is above the surface while cosγ cosθ + sinγ sinθ cosψ > 0; ψ = 0 points to the normal.
    reach = np.arccos(np.clip(-cg * ct / np.maximum(sg * st, 1e-300), -1.0, 1.0))
    psi = reach[:, None] * y
    wi = np.array([-st, 0.0, ct])
    mirror, toward = np.array([st, 0.0, ct]), np.array([-ct, 0.0, st])
    side = np.array([0.0, 1.0, 0.0])
    wo = (
        cg[:, None, None] * mirror
        + (sg[:, None] * np.cos(psi))[..., None] * toward
        + (sg[:, None] * np.sin(psi))[..., None] * side
    )
    a = angles(np.array([0.0, 0.0, 1.0]), wi, wo)
    inner = (response(a) * np.maximum(a.cos_o, 0.0)) @ wy * reach
    return float(2.0 * np.sum(weight * inner) / ct)


def albedo_limit(
    response: Callable[[Angles], Array], *, largest_theta_rad: float = 1.553343, samples: int = 33
) -> tuple[float, float]:
    """The largest hemispherical albedo over incidences 0 … `largest_theta_rad` (89° by default), and its θi [rad].

    Samples are even in tanθ/(1 + tanθ), so both the normal and grazing are covered. Stated to a limit angle because
    some laws (Guo et al. 2017, Eq. 4, with m < 1 or s > 0, read as radiance) exceed any bound at 90°.
    """
    top = np.tan(largest_theta_rad)
    share = np.linspace(0.0, top / (1.0 + top), samples)
    theta = np.arctan(share / (1.0 - share))
    value = hemispherical_albedo(response, np.minimum(theta, largest_theta_rad))
    k = int(np.argmax(value))
    return float(value[k]), float(theta[k])


def conserves_energy(response: Callable[[Angles], Array], *, tolerance: float = 1e-4) -> bool:
    """True where no incidence up to 89° returns more light than arrives, within the quadrature's `tolerance`."""
    return albedo_limit(response)[0] <= 1.0 + tolerance
