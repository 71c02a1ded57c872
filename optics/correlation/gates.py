"""Camera gate shapes: transmission 0…1 against τ, with τ = 0 at the opening half-height edge.

Fields as in the specs of `scenes.waveforms`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ..constants import FWHM_PER_SIGMA
from .parts import Array, Decay, Gaussian, Part, PiecewiseLinear, ramps, samples

__all__ = [
    "ExponentialGate", "Gate", "GaussianGate", "RectangularGate", "SampledGate", "TrapezoidalGate",
    "gate_area", "gate_parts", "gate_support", "gate_transmission", "sample_gate",
]  # fmt: skip


@dataclass(frozen=True)
class RectangularGate:
    """Open from 0 to `width_s`."""

    width_s: float
    transmission: float


@dataclass(frozen=True)
class TrapezoidalGate:
    """Linear edges; `width_s` between the half heights, top = width − (rise + fall)/2, starting to open at −rise/2."""

    width_s: float
    rise_s: float
    fall_s: float
    transmission: float


@dataclass(frozen=True)
class GaussianGate:
    """Gaussian of full width `fwhm_s`: half height at τ = 0, peak at fwhm/2."""

    fwhm_s: float
    transmission: float


@dataclass(frozen=True)
class ExponentialGate:
    """Opens instantly, stays open for `width_s`, then closes as exp(−(τ − width)/tail)."""

    width_s: float
    tail_s: float
    transmission: float


@dataclass(frozen=True)
class SampledGate:
    """Transmission sampled on an even grid from `start_s`, linear between samples, zero outside."""

    start_s: float
    step_s: float
    value: tuple[float, ...]


Gate: TypeAlias = RectangularGate | TrapezoidalGate | GaussianGate | ExponentialGate | SampledGate


def _positive(name: str, value: float) -> float:
    if not (np.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} must be positive and finite, not {value!r}")
    return float(value)


def gate_parts(gate: Gate) -> tuple[Part, ...]:
    """The gate as a sum of elementary shapes. Raises ValueError for impossible widths."""
    if isinstance(gate, RectangularGate):
        return (ramps([(0.0, gate.transmission), (_positive("width_s", gate.width_s), gate.transmission)]),)
    if isinstance(gate, TrapezoidalGate):
        rise, fall, width = gate.rise_s, gate.fall_s, _positive("width_s", gate.width_s)
        if min(rise, fall) < 0.0 or width < 0.5 * (rise + fall):
            raise ValueError(f"width_s {width} must be at least (rise_s + fall_s)/2 = {0.5 * (rise + fall)}")
        top = gate.transmission
        return (
            ramps(
                [
                    (-0.5 * rise, 0.0),
                    (0.5 * rise, top),
                    (max(width - 0.5 * fall, 0.5 * rise), top),
                    (width + 0.5 * fall, 0.0),
                ]
            ),
        )
    if isinstance(gate, GaussianGate):
        sigma = _positive("fwhm_s", gate.fwhm_s) / FWHM_PER_SIGMA
        return (Gaussian(0.5 * gate.fwhm_s, sigma, gate.transmission * sigma * float(np.sqrt(2.0 * np.pi))),)
    if isinstance(gate, ExponentialGate):
        if not (np.isfinite(gate.width_s) and gate.width_s >= 0.0):
            raise ValueError(f"width_s must be finite and at least 0, not {gate.width_s!r}")
        decay = Decay(gate.width_s, _positive("tail_s", gate.tail_s), gate.transmission)
        if gate.width_s == 0.0:
            return (decay,)
        return (ramps([(0.0, gate.transmission), (gate.width_s, gate.transmission)]), decay)
    if isinstance(gate, SampledGate):
        return (samples(gate.start_s, _positive("step_s", gate.step_s), gate.value),)
    raise TypeError(f"not a gate: {gate!r}")


def gate_transmission(gate: Gate, tau: ArrayLike) -> Array:
    """g(τ) (0…1) at τ [s] of any shape, from the right at jumps."""
    t = np.asarray(tau, dtype=np.float64)
    total = np.zeros_like(t)
    for part in gate_parts(gate):
        total = total + part.density(t)
    return total


def gate_support(gate: Gate) -> tuple[float, float]:
    """(lo, hi) in s: g is zero, or below 1e-14 of its peak, outside."""
    spans = [part.support for part in gate_parts(gate)]
    return min(s[0] for s in spans), max(s[1] for s in spans)


def gate_area(gate: Gate) -> float:
    """∫ g(τ) dτ in s."""
    return float(sum(float(part.upper(np.asarray(part.support[0] - 0.0))) for part in gate_parts(gate)))


def sample_gate(gate: Gate, step_s: float) -> tuple[float, Array]:
    """Samples of g on an even grid, as a rig declares them: (start_s, transmission), to be interpolated linearly.

    Continuous gates: values at the grid points, from the lower end of the support. Gates that jump, or rise within two
    steps: weighted with the hat function of the grid, which keeps area and centroid exactly and spreads a jump over two
    steps. A sampled gate at its own step is returned unchanged. Raises ValueError unless 0 < step_s < half of the support.
    """
    if isinstance(gate, SampledGate) and abs(step_s / gate.step_s - 1.0) < 1e-9:
        return gate.start_s, np.asarray(gate.value, dtype=np.float64)
    lo, hi = gate_support(gate)
    if not 0.0 < step_s < 0.5 * (hi - lo):
        raise ValueError(f"step_s must be above 0 and below half the gate's support {hi - lo:.6g} s, not {step_s!r}")
    parts = gate_parts(gate)
    jumps = any(isinstance(p, Decay) or (isinstance(p, PiecewiseLinear) and np.any(p.jumps != 0.0)) for p in parts)
    steep = any(isinstance(p, PiecewiseLinear) and np.diff(p.knot).min() < 2.0 * step_s for p in parts)
    if not jumps and not steep:
        count = int(np.ceil((hi - lo) / step_s)) + 2
        return lo, gate_transmission(gate, lo + step_s * np.arange(count))
    count = int(np.ceil((hi - lo) / step_s)) + 3
    start = lo - step_s
    edge = np.asarray(start + step_s * np.arange(-1, count + 1), dtype=np.float64)
    value = np.zeros(count)
    for part in parts:
        value += np.diff(part.upper2(edge), n=2) / step_s**2
    # Averages lie between the extremes of the gate; the second difference has rounding errors of 1e-16·(tail/step)².
    extremes = gate.value if isinstance(gate, SampledGate) else (gate.transmission,)
    return start, np.clip(value, min(0.0, *extremes), max(0.0, *extremes))
