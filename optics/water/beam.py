"""A beam's angular profile after forward scattering: I ⊗ h, the halo of scattered light that a slab of medium adds.

With the halo's point spread function h(θ) of `halo.py`, the beam's intensity at range r is e^{−cr}·[I(θ) + X(θ)],
X = I ⊗ h. For a beam far wider than h, X = I·(e^{b r (1 − B)} − 1); for a pencil beam X = h.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ..correlation.parts import Array
from ..jit import kernel, prange
from .halo import forward_share, halo_spread
from .phase_forms import PhaseFunction

__all__ = ["BeamHalo", "beam_halo", "halo_value", "tabulate_beam_halo"]

_PROFILE_NODES = 2048
_AROUND = 48  # directions around half a ring, by the midpoint rule
_ACROSS = 64  # radii of the beam, for angles far outside it


def beam_halo(
    angle_rad: ArrayLike,
    intensity: Callable[[Array], Array],
    edge_rad: float,
    phase: PhaseFunction,
    scattering_length: float,
) -> Array:
    """X(θ) = (I ⊗ h)(θ), 1/sr, at angles θ from the beam's axis.

    Main arguments:
        angle_rad: θ (n).
        intensity: I(θ) of angles, 1/sr; zero or negligible beyond `edge_rad`.
        phase, scattering_length: the medium and b·r.

    In the small-angle approximation, on the tangent plane of the axis. Inside the beam I is averaged over rings of h
    around θ; far outside, h is averaged over the beam; each is smooth where it is used.
    """
    theta = np.ascontiguousarray(angle_rad, dtype=np.float64)
    spread = halo_spread(phase, scattering_length)
    profile = np.asarray(intensity(np.linspace(0.0, edge_rad, _PROFILE_NODES)), dtype=np.float64)
    ring = np.diff(spread.enclosed, prepend=0.0)
    ring[-1] += max(spread.total - spread.enclosed[-1], 0.0)
    # Light in rings: on an even logarithmic grid the middle of two neighbours is their geometric mean.
    radius = np.concatenate([[0.5 * spread.angle_rad[0]], np.sqrt(spread.angle_rad[1:] * spread.angle_rad[:-1])])
    node, weight = _across_nodes()
    across = 0.5 * edge_rad * (node + 1.0)
    # the same planar measure for both averages
    flux = 0.5 * edge_rad * weight * np.asarray(intensity(across)) * 2.0 * np.pi * across
    log_density = np.log(np.maximum(spread.density, 1e-300))
    start = float(np.log(spread.angle_rad[0]))
    inverse = 1.0 / float(np.log(spread.angle_rad[1] / spread.angle_rad[0]))
    return np.asarray(
        _convolve(theta, profile, edge_rad, radius, ring, across, flux, log_density, start, inverse, _AROUND)
    )


@lru_cache(maxsize=1)
def _across_nodes() -> tuple[Array, Array]:
    return np.polynomial.legendre.leggauss(_ACROSS)


@kernel(parallel=True)
def _convolve(theta, profile, edge, radius, ring, across, flux, log_density, start, inverse, around):  # type: ignore[no-untyped-def]
    out = np.empty(theta.size)
    per = (profile.size - 1) / edge
    last = log_density.size - 1
    cosines = np.cos(np.pi * (np.arange(around) + 0.5) / around)
    some = np.cos(np.pi * (np.arange(24) + 0.5) / 24)
    few = np.cos(np.pi * (np.arange(8) + 0.5) / 8)
    for n in prange(theta.size):
        t = theta[n]
        total = 0.0
        if t < 1.5 * edge:
            for j in range(radius.size):
                p = radius[j]
                if p > t + edge:
                    break
                turn = few if p < 0.02 * edge else cosines  # over a small ring the beam is linear
                mean = 0.0
                for a in range(turn.size):
                    d = np.sqrt(max(t * t + p * p - 2.0 * t * p * turn[a], 0.0))
                    if d < edge:
                        x = d * per
                        i = min(int(x), profile.size - 2)
                        mean += profile[i] + (x - i) * (profile[i + 1] - profile[i])
                total += ring[j] * mean / turn.size
        else:
            # h is smooth around a ring that does not reach θ: n directions err by (p/θ)^2n.
            turn = few if t > 3.0 * edge else some
            for j in range(across.size):
                p = across[j]
                mean = 0.0
                for a in range(turn.size):
                    d = np.sqrt(max(t * t + p * p - 2.0 * t * p * turn[a], 1e-300))
                    x = max((np.log(d) - start) * inverse, 0.0)
                    if x < last:
                        i = int(x)
                        mean += np.exp(log_density[i] + (x - i) * (log_density[i + 1] - log_density[i]))
                total += flux[j] * mean / turn.size
        out[n] = total
    return out


@dataclass(frozen=True, eq=False)
class BeamHalo:
    """Table of X(θ, r): `log_shape`(range, angle) of X/(e^{k r} − 1), even in ln r and in asinh(θ/angle_scale_rad).

    `rate_per_m` k = b(1 − B)·legs. Evaluate it with `at`, in kernels with `halo_value`.
    """

    log_range_start: float
    log_range_step: float
    angle_scale_rad: float
    angle_step: float
    rate_per_m: float
    log_shape: Array

    def at(self, angle_rad: ArrayLike, range_m: ArrayLike) -> Array:
        """X at angles and ranges that broadcast, 1/sr; a range outside the table uses the nearest tabulated shape."""
        theta, r = np.broadcast_arrays(np.asarray(angle_rad, np.float64), np.asarray(range_m, np.float64))
        value = _look_up(
            np.ascontiguousarray(theta).ravel(), np.ascontiguousarray(r).ravel(), self.log_range_start,
            1.0 / self.log_range_step, 1.0 / self.angle_scale_rad, 1.0 / self.angle_step, self.rate_per_m,
            self.log_shape,
        )  # fmt: skip
        return np.asarray(value).reshape(theta.shape)


@kernel
def halo_value(theta, r, v0, inv_dv, inv_scale, inv_du, rate, table):  # type: ignore[no-untyped-def]
    """X(θ, r) from the fields of a `BeamHalo`, scalar; its logarithm is interpolated linearly in both coordinates."""
    v = min(max((np.log(r) - v0) * inv_dv, 0.0), table.shape[0] - 1.0)
    u = min(np.arcsinh(theta * inv_scale) * inv_du, table.shape[1] - 1.0)
    i = min(int(v), table.shape[0] - 2)
    j = min(int(u), table.shape[1] - 2)
    fv = v - i
    fu = u - j
    low = table[i, j] + fu * (table[i, j + 1] - table[i, j])
    high = table[i + 1, j] + fu * (table[i + 1, j + 1] - table[i + 1, j])
    return np.exp(low + fv * (high - low)) * np.expm1(rate * r)


@kernel(parallel=True)
def _look_up(theta, r, v0, inv_dv, inv_scale, inv_du, rate, table):  # type: ignore[no-untyped-def]
    out = np.empty(theta.size)
    for n in prange(theta.size):
        out[n] = halo_value(theta[n], r[n], v0, inv_dv, inv_scale, inv_du, rate, table)
    return out


def tabulate_beam_halo(
    intensity: Callable[[Array], Array],
    edge_rad: float,
    phase: PhaseFunction,
    scattering_per_m: float,
    range_m: tuple[float, float],
    legs: int,
    *,
    angles: int = 128,
) -> BeamHalo:
    """Table of X(θ, r) for ranges low … high.

    Main arguments:
        intensity, edge_rad: the beam, as for `beam_halo`.
        legs: 1 for the outgoing beam; 2 where the return path blurs too (backscatter of a coaxial rig, by reciprocity
            I ⊗ h_out ⊗ h_back).
    Raises ValueError for b ≤ 0 or an empty interval.
    """
    low, high = range_m
    if not (scattering_per_m > 0.0 and 0.0 < low <= high):
        raise ValueError("A halo needs scattering (b > 0) and an interval of ranges above 0.")
    high = max(high, low * 1.001)
    rate = scattering_per_m * legs * forward_share(phase)
    # The shape changes little over a scattering length: one node for each, 6 … 18, keeps the table accurate to 1.5 %.
    ranges = 6 + int(min(rate * (high - low), 12.0))
    r = np.geomspace(low, high, ranges)
    scale = 0.1 * edge_rad
    u = np.linspace(0.0, np.arcsinh(0.5 * np.pi / scale), angles)
    theta = scale * np.sinh(u)
    shape = np.empty((ranges, angles))
    for i, value in enumerate(r):
        x = beam_halo(theta, intensity, edge_rad, phase, scattering_per_m * legs * float(value))
        shape[i] = np.log(np.maximum(x, 1e-300)) - np.log(np.expm1(rate * value))
    return BeamHalo(float(np.log(low)), float(np.log(r[1] / r[0])), scale, float(u[1]), rate, shape)
