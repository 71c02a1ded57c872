"""Forward-scattered light in the small-angle approximation: transfer and point spread function of a slab of medium.

Light deflected by ψ at the fraction t of the path from a target at r is displaced by the angle ψt, seen from the other
end; this holds for the outgoing beam and, by reciprocity, for the returning image. Over many scatterings (Wells 1973)

    M(q) = exp(−c r + b r Q(q)),   Q(q) = ∫₀¹ S(qt) dt,   S(k) = 2π ∫₀^{π/2} β̃(ψ) J₀(2πkψ) sinψ dψ,

q in cycles per radian. Q(0) = 1 − B, so that M(0) = e^{−(a + b_b) r}: a wide beam loses only light that is absorbed or
scattered backward; M(∞) = e^{−cr} is the unscattered light. The halo is the difference, e^{−cr}·[e^{b r Q(q)} − 1].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ..correlation.parts import Array
from .phase_forms import PhaseFunction, phase_cdf, phase_density
from .phase_function import phase_cells

__all__ = ["HaloSpread", "forward_share", "halo_spread", "softened_phase", "ring_transfer", "wells_mtf"]

_RIGHT_ANGLE = 0.5 * np.pi
#: Grid of q: even in ln q, wide enough that the ends of the transform stay far from the angles of any image.
_Q_POINTS = 1024
_Q_LOW, _Q_HIGH = 1e-5, 1e9


def forward_share(phase: PhaseFunction) -> float:
    """Q(0) = 1 − B: the share of scattered light deflected by less than a right angle."""
    return float(phase_cdf(phase, _RIGHT_ANGLE))


def ring_transfer(x: ArrayLike) -> Array:
    """G(x) = ∫₀¹ J₀(xt) dt: transfer of light displaced by ψt, t uniform in 0 … 1, at x = 2πqψ; 1 at 0, → 1/x."""
    from scipy.special import itj0y0

    value = np.abs(np.asarray(x, dtype=np.float64))
    safe = np.clip(value, 1e-6, 400.0)
    inner = itj0y0(safe)[0] / safe
    # Beyond 400 the ripple (below 4 % of G) is finer than any angular cell and averages out.
    return np.where(value > 400.0, 1.0 / np.maximum(value, 400.0), np.where(value < 1e-6, 1.0, inner))


@lru_cache(maxsize=32)
def _transfer(phase: PhaseFunction) -> tuple[Array, Array]:
    """(q, Q(q)) on the grid of q, from the exact shares of light in 4000 cells of angle."""
    psi, share = phase_cells(phase, 4000, _RIGHT_ANGLE)
    q = np.geomspace(_Q_LOW, _Q_HIGH, _Q_POINTS)
    out = np.empty(_Q_POINTS)
    for begin in range(0, _Q_POINTS, 256):
        part = slice(begin, begin + 256)
        out[part] = ring_transfer(2.0 * np.pi * q[part, None] * psi) @ share
    return q, out


def wells_mtf(
    frequency_per_rad: ArrayLike, range_m: ArrayLike, phase: PhaseFunction, absorption_per_m: float,
    scattering_per_m: float,
) -> Array:  # fmt: skip
    """M(q) = exp(−c r + b r Q(q)), one way over r [m], at q [cycles/rad] (Wells 1973; Jaffe 1990).

    Between e^{−cr} at high and e^{−(a + b_b) r} at low frequencies.
    """
    q, transfer = _transfer(phase)
    x = np.log(np.clip(np.abs(np.asarray(frequency_per_rad, dtype=np.float64)), _Q_LOW, _Q_HIGH))
    value = np.interp(x, np.log(q), transfer)
    r = np.asarray(range_m, dtype=np.float64)
    return np.asarray(np.exp(-(absorption_per_m + scattering_per_m) * r + scattering_per_m * r * value))


@dataclass(frozen=True, eq=False)
class HaloSpread:
    """Point spread function h(θ) of the halo relative to the unscattered light, on `angle_rad` (n, even in ln θ).

    `density` (n): h, 1/sr. `enclosed` (n): 2π ∫₀^θ h θ'dθ'. `total`: e^{b r (1 − B)} − 1, all of it.
    """

    angle_rad: Array
    density: Array
    enclosed: Array
    total: float

    def enclosed_within(self, angle_rad: ArrayLike) -> Array:
        """Halo inside a cone of half angle θ, relative to the unscattered light."""
        theta = np.asarray(angle_rad, dtype=np.float64)
        with np.errstate(divide="ignore"):
            x = np.log(theta)
        grid = np.log(self.angle_rad)
        # a power law below the grid
        inside = np.interp(x, grid, self.enclosed)
        slope = np.log(self.enclosed[1] / self.enclosed[0]) / (grid[1] - grid[0]) if self.enclosed[0] > 0 else 1.0
        with np.errstate(over="ignore"):
            below = self.enclosed[0] * np.exp(np.minimum(slope * (x - grid[0]), 0.0))
        return np.where(x < grid[0], below, inside)

    def density_at(self, angle_rad: ArrayLike) -> Array:
        """h at any angles, 1/sr, linear in log-log; beyond the grid the value of the last angle, 0 above π/2."""
        theta = np.asarray(angle_rad, dtype=np.float64)
        safe = np.clip(theta, self.angle_rad[0], self.angle_rad[-1])
        value = np.exp(np.interp(np.log(safe), np.log(self.angle_rad), np.log(np.maximum(self.density, 1e-300))))
        return np.where(theta > _RIGHT_ANGLE, 0.0, value)


def halo_spread(phase: PhaseFunction, optical_length: float) -> HaloSpread:
    """Point spread function of the halo after b·r = `optical_length` scattering lengths (for a two-way path the sum).

    h(θ) = 2π ∫ [e^{b r Q(q)} − 1] J₀(2πqθ) q dq by the fast Hankel transform on even ln q (Hamilton 2000, as in
    scipy.fft.fht). The small-angle approximation has no light at θ > π/2: it is assigned to the last ring, so that
    `enclosed` ends at `total`. Raises ValueError for a negative length.
    """
    if not optical_length >= 0.0:
        raise ValueError(f"optical_length must be at least 0, not {optical_length!r}")
    return _spread(phase, float(optical_length))


def softened_phase(phase: PhaseFunction, optical_length: ArrayLike, turn_rad: ArrayLike) -> Array:
    """Mean β̃ [1/sr] for light of the halo where unscattered light would be deflected by ψ = `turn_rad` (n).

    Light scattered forward at the fraction t of its path is displaced by ψ't and arrives tilted by ψ'(1 − t): t is uniform
    in 0 … 1, so that the tilt ω has the distribution h of the halo, and β̃ is averaged over h: cosψ → cosψ cosω +
    sinψ sinω cosα. `optical_length` b·r, one (result: n) or several (m; result: m, n), is that of the two-way path.
    """
    psi = np.asarray(turn_rad, dtype=np.float64)
    length = np.asarray(optical_length, dtype=np.float64)
    edge = np.geomspace(1e-4, _RIGHT_ANGLE, 64)
    share = np.empty((length.size, edge.size))
    for row, one in zip(share, length.flat, strict=True):
        spread = halo_spread(phase, max(float(one), 1e-9))
        row[:] = np.diff(spread.enclosed_within(edge), prepend=0.0)
        row[-1] += max(spread.total - float(row.sum()), 0.0)
    tilt = np.concatenate([[0.0], np.sqrt(edge[1:] * edge[:-1])])
    around = np.cos(np.pi * (np.arange(8) + 0.5) / 8)
    cosine = np.cos(psi)[:, None, None] * np.cos(tilt)[:, None]
    cosine = cosine + np.sin(psi)[:, None, None] * np.sin(tilt)[:, None] * around
    value = phase_density(phase, np.arccos(np.clip(cosine, -1.0, 1.0)).clip(1e-6, np.pi)).mean(axis=2)
    mean = share @ value.T / share.sum(axis=1)[:, None]
    return np.asarray(mean.reshape(length.shape + psi.shape))


@lru_cache(maxsize=256)
def _spread(phase: PhaseFunction, length: float) -> HaloSpread:
    from scipy.fft import fht, fhtoffset

    q, transfer = _transfer(phase)
    total = float(np.expm1(length * forward_share(phase)))
    if length == 0.0:
        angle = np.geomspace(1e-6, _RIGHT_ANGLE, 64)
        return HaloSpread(angle, np.zeros(64), np.zeros(64), 0.0)
    dln = float(np.log(q[1] / q[0]))
    bias = 0.25
    offset = fhtoffset(dln, 0.0, bias=bias)
    # fht gives ∫ a(k) J₀(kx) x dk with a = k·M, k = 2πq; h(x) = (1/2π) ∫ M J₀(kx) k dk
    k = 2.0 * np.pi * q
    moved = fht(k * np.expm1(length * transfer), dln, 0.0, offset=offset, bias=bias)
    x = np.exp(offset) / k[::-1]
    density = moved / x / (2.0 * np.pi)
    keep = (x >= 3e-7) & (x <= _RIGHT_ANGLE)
    x, density = x[keep], np.maximum(density[keep], 0.0)
    ring = 2.0 * np.pi * density * x**2
    # below the grid: a power law with the slope of its first points
    # (2, an even density, where rounding leaves none)
    rising = ring[0] > 0.0 and ring[8] > 0.0
    slope = float(np.clip(np.log(ring[8] / ring[0]) / np.log(x[8] / x[0]), 0.05, 2.0)) if rising else 2.0
    cell = 0.5 * (ring[1:] + ring[:-1]) * dln
    enclosed = ring[0] / slope + np.concatenate([[0.0], np.cumsum(cell)])
    return HaloSpread(x, density, np.minimum(enclosed, total), total)
