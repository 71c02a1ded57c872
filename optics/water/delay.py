"""Delay of forward-scattered light: the extra path length of light that a medium deflects forward.

Light that reaches a point at range r from a lamp, deflected once by ψ, left the lamp at the angle α to the straight line.
The two parts of its path are r₁ = r sin(ψ − α)/sinψ and r₂ = r sinα/sinψ, so that it is longer than r by

    δ = r [cos(ψ/2 − α)/cos(ψ/2) − 1]      (small angles: r t(1 − t)ψ²/2, t = r₁/r),

and a beam that is uniform within the half angle w gives, relative to its unscattered light,

    dλ = 2π b r β̃(ψ) e^{−cδ} cos(ψ − α) dα dψ,      0 < α < min(ψ, w),

exactly; the cosine is that of the irradiance of a matt target. Over several deflections the delays add (azimuths are
random: cross terms vanish on average), so that light deflected at least once has the compound Poisson distribution
Σ λⁿ/n! g*ⁿ/(e^λ − 1). By reciprocity the same holds on the return path, w the half angle of the lit part of the view.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..correlation.parts import Array
from .phase_forms import PhaseFunction, phase_density

__all__ = ["SHARES", "DelayNodes", "delay_nodes", "halo_ratio", "single_turn_delay"]

#: Light deflected at least once, sorted by delay, is summarised in groups of these shares.
SHARES = np.array([0.5, 0.2, 0.12, 0.08, 0.05, 0.03, 0.02])
_ALPHA, _PSI = 48, 256
_CELLS = 1 << 13
_SMALLEST_RAD = 1e-5
_LARGEST_RAD = 0.75 * np.pi


@dataclass(frozen=True, eq=False)
class DelayNodes:
    """Mean extra path `delay_m` and its standard deviation `spread_m` of the groups `SHARES` (n, groups), at `range_m` (n)."""

    range_m: Array
    delay_m: Array
    spread_m: Array

    def at(self, range_m: Array) -> tuple[Array, Array]:
        """(extra path, its standard deviation) (…, groups) in m at any ranges."""
        r = np.asarray(range_m, dtype=np.float64)
        delay, spread = (
            np.stack([np.interp(r, self.range_m, column) for column in table.T], axis=-1)
            for table in (self.delay_m, self.spread_m)
        )
        return delay, spread


@lru_cache(maxsize=4)
def _gauss_nodes(count: int) -> tuple[Array, Array]:
    return np.polynomial.legendre.leggauss(count)


@lru_cache(maxsize=64)
def single_turn_delay(
    phase: PhaseFunction, scattering_per_m: float, attenuation_per_m: float, range_m: float, half_angle_rad: float
) -> tuple[Array, Array]:
    """(extra paths δ [m], light dλ relative to the unscattered light) of single deflections: samples of their distribution."""
    psi_edge = np.geomspace(_SMALLEST_RAD, _LARGEST_RAD, _PSI + 1)
    psi = np.sqrt(psi_edge[1:] * psi_edge[:-1])
    node, weight = _gauss_nodes(_ALPHA)
    largest = np.minimum(psi, half_angle_rad)[:, None]
    alpha = 0.5 * largest * (node + 1.0)
    d_alpha = 0.5 * largest * weight
    turn = psi[:, None]
    longer = range_m * (np.cos(0.5 * turn - alpha) / np.cos(0.5 * turn) - 1.0)
    light = 2.0 * np.pi * scattering_per_m * range_m * phase_density(phase, psi)[:, None] * np.diff(psi_edge)[:, None]
    light = light * d_alpha * np.exp(-attenuation_per_m * longer) * np.maximum(np.cos(turn - alpha), 0.0)
    return np.maximum(longer, 0.0).ravel(), light.ravel()


def halo_ratio(
    phase: PhaseFunction, scattering_per_m: float, attenuation_per_m: float, range_m: float, half_angle_rad: float
) -> float:
    """(e^λ − 1)/(e^λ₀ − 1): light deflected at least once over its small-angle approximation, on the axis of a uniform beam.

    λ is the sum over `single_turn_delay`; λ₀ = 2π b r ∫ β̃ min(1, w/ψ) sinψ dψ neglects the extra path and the slant at
    the target. 1 where all deflections are small, .95-.99 in real water.
    """
    exact = float(single_turn_delay(phase, scattering_per_m, attenuation_per_m, range_m, half_angle_rad)[1].sum())
    edge = np.geomspace(_SMALLEST_RAD, 0.5 * np.pi, 4 * _PSI + 1)
    psi = np.sqrt(edge[1:] * edge[:-1])
    inside = phase_density(phase, psi) * np.minimum(1.0, half_angle_rad / psi) * np.sin(psi) * np.diff(edge)
    return float(np.expm1(exact) / np.expm1(2.0 * np.pi * scattering_per_m * range_m * float(inside.sum())))


def delay_nodes(
    phase: PhaseFunction, scattering_per_m: float, attenuation_per_m: float, range_m: tuple[float, float],
    half_angle_rad: float, before_rad: float | None = None,
) -> DelayNodes:  # fmt: skip
    """Delays of light deflected at least once on a one-way path, for ranges low … high.

    Main arguments:
        phase, scattering_per_m, attenuation_per_m: the medium, c = a + b.
        half_angle_rad: w, half angle of the beam (outgoing path), or of the lit part of the view (return path).
    Other arguments:
        before_rad: w of an earlier path of the same length, on which the light was deflected any number of times, also 0.

    Raises ValueError for b ≤ 0 or an empty interval.
    """
    low, high = range_m
    if not (scattering_per_m > 0.0 and 0.0 < low <= high):
        raise ValueError("A delay needs scattering (b > 0) and an interval of ranges above 0.")
    # Delays grow as r² at most; their logarithm is nearly linear between neighbours.
    ranges = np.geomspace(low, max(high, low * 1.001), 3 + int(min(3.0 * np.log(high / low), 6.0)))
    found = [_groups(phase, scattering_per_m, attenuation_per_m, float(r), half_angle_rad, before_rad) for r in ranges]
    return DelayNodes(ranges, np.stack([f[0] for f in found]), np.stack([f[1] for f in found]))


@lru_cache(maxsize=256)
def _groups(
    phase: PhaseFunction, b: float, c: float, range_m: float, half_angle: float, before: float | None
) -> tuple[Array, Array]:
    ways = [single_turn_delay(phase, b, c, range_m, w) for w in (half_angle, before) if w is not None]
    # Delays of several deflections add: room for their sum; rarer delays go to the last cell.
    reach = float(sum(_rare(longer, light) * (2.0 + float(light.sum())) for longer, light in ways))
    cell = reach / _CELLS
    one, *rest = (np.fft.rfft(_histogram(longer, light, cell), 2 * _CELLS) for longer, light in ways)
    many = np.fft.irfft(np.expm1(one) * (np.exp(rest[0]) if rest else 1.0), 2 * _CELLS)[:_CELLS]
    return _quantile_groups(
        cell * np.arange(_CELLS, dtype=np.float64), np.asarray(np.maximum(many, 0.0), dtype=np.float64)
    )


def _rare(longer: Array, light: Array) -> float:
    """The delay exceeded by one deflection in 10⁴."""
    order = np.argsort(longer)
    share = np.cumsum(light[order])
    return float(longer[order][np.searchsorted(share, (1.0 - 1e-4) * share[-1])])


def _histogram(longer: Array, light: Array, cell: float) -> Array:
    """Light in cells of delay; each sample is split over two, so that the mean is kept for any width of the cells."""
    x = np.minimum(longer / cell, _CELLS - 1.001)
    i = x.astype(np.int64)
    here, next_to = (np.bincount(i + k, light * w, _CELLS + 1) for k, w in ((0, i + 1 - x), (1, x - i)))
    return np.asarray(here + next_to, dtype=np.float64)


def _quantile_groups(where: Array, light: Array) -> tuple[Array, Array]:
    """Mean and standard deviation of the groups SHARES of a distribution; a cell on a group's border is split."""
    edge = np.concatenate([[0.0], np.cumsum(light)])
    border = np.concatenate([[0.0], np.cumsum(SHARES)]) * edge[-1]
    mean, spread = np.empty((2, SHARES.size))
    for j in range(SHARES.size):
        part = np.clip(np.minimum(edge[1:], border[j + 1]) - np.maximum(edge[:-1], border[j]), 0.0, None)
        mean[j] = part @ where / part.sum()
        spread[j] = np.sqrt(max(float(part @ (where - mean[j]) ** 2 / part.sum()), 0.0))
    return mean, spread
