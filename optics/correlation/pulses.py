"""Laser pulse shapes: unit area, centroid at t = 0. Fields as in the specs of `scenes.waveforms`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ..constants import FWHM_PER_SIGMA
from .parts import Array, ExGaussian, Gaussian, PiecewiseLinear, ramps, samples

__all__ = [
    "ExponentialPulse", "GaussianPulse", "Pulse", "RectangularPulse", "SampledPulse", "TrapezoidalPulse",
    "broadened", "finest_feature_s", "pulse_density", "pulse_part", "pulse_support", "pulse_variance", "sample_pulse",
]  # fmt: skip

#: Samples of a broadened pulse per jitter sigma, and the largest total.
_PER_SIGMA = 32
_MOST_SAMPLES = 1 << 17
#: Largest number of samples of a pulse on a grid of the caller's step.
_MOST_GRID = 1 << 22


@dataclass(frozen=True)
class GaussianPulse:
    """p ∝ exp(−t²/2σ²), fwhm = σ√(8 ln 2)."""

    fwhm_s: float


@dataclass(frozen=True)
class RectangularPulse:
    """Constant over `width_s`."""

    width_s: float


@dataclass(frozen=True)
class TrapezoidalPulse:
    """Linear rise, flat top, linear fall."""

    rise_s: float
    top_s: float
    fall_s: float


@dataclass(frozen=True)
class ExponentialPulse:
    """A Gaussian of `fwhm_s` convolved with an exponential decay of constant `tail_s`; centroid at 0."""

    fwhm_s: float
    tail_s: float


@dataclass(frozen=True)
class SampledPulse:
    """Even samples, linear between, zero outside; offset in time and scale are arbitrary (both are removed)."""

    step_s: float
    value: tuple[float, ...]


Pulse: TypeAlias = GaussianPulse | RectangularPulse | TrapezoidalPulse | ExponentialPulse | SampledPulse


def _positive(name: str, value: float) -> float:
    if not (np.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} must be positive and finite, not {value!r}")
    return float(value)


def _centred(shape: PiecewiseLinear) -> PiecewiseLinear:
    if not (np.isfinite(shape.area) and shape.area > 0.0):
        raise ValueError(f"A pulse needs a positive, finite area, not {shape.area!r}.")
    return shape.moved(-shape.centroid, 1.0 / shape.area)


def pulse_part(pulse: Pulse) -> Gaussian | ExGaussian | PiecewiseLinear:
    """The pulse as an elementary shape of unit area and centroid 0. Raises ValueError for widths that are not positive."""
    if isinstance(pulse, GaussianPulse):
        return Gaussian(0.0, _positive("fwhm_s", pulse.fwhm_s) / FWHM_PER_SIGMA)
    if isinstance(pulse, ExponentialPulse):
        return ExGaussian(0.0, _positive("fwhm_s", pulse.fwhm_s) / FWHM_PER_SIGMA, _positive("tail_s", pulse.tail_s))
    if isinstance(pulse, RectangularPulse):
        half = 0.5 * _positive("width_s", pulse.width_s)
        return ramps([(-half, 0.5 / half), (half, 0.5 / half)])
    if isinstance(pulse, TrapezoidalPulse):
        rise, top, fall = pulse.rise_s, pulse.top_s, pulse.fall_s
        if min(rise, top, fall) < 0.0:
            raise ValueError(f"rise_s, top_s and fall_s must be at least 0, not {(rise, top, fall)}")
        base = _positive("rise_s + top_s + fall_s", rise + top + fall)
        # In units of the base, so that the area is of order one whatever the time scale.
        unit = ramps([(0.0, 0.0), (rise / base, 1.0), ((rise + top) / base, 1.0), (1.0, 0.0)])
        shape = PiecewiseLinear(unit.knot * base, unit.left, unit.right)
        return _centred(shape)
    if isinstance(pulse, SampledPulse):
        return _centred(samples(0.0, _positive("step_s", pulse.step_s), pulse.value))
    raise TypeError(f"not a pulse: {pulse!r}")


def pulse_density(pulse: Pulse, t: ArrayLike) -> Array:
    """p(t) in 1/s at times t [s] of any shape; ∫p = 1, centroid 0."""
    return pulse_part(pulse).density(np.asarray(t, dtype=np.float64))


def pulse_support(pulse: Pulse) -> tuple[float, float]:
    """(lo, hi) in s: p is zero, or below 1e-14 of its peak, outside."""
    return pulse_part(pulse).support


def pulse_variance(pulse: Pulse) -> float:
    """∫ t² p(t) dt in s² (the pulse's centroid is 0)."""
    part = pulse_part(pulse)
    if isinstance(part, Gaussian):
        return part.sigma**2
    if isinstance(part, ExGaussian):
        return part.sigma**2 + part.tail**2
    return part.moment2(0.0)


def broadened(pulse: Pulse, sigma_s: float) -> Pulse:
    """The pulse convolved with a Gaussian of standard deviation `sigma_s` (jitter drawn anew for every shot), in s.

    Exact for Gaussian and exponential pulses. The others become samples of the exact convolution, 32 per sigma (at
    most 131,072 in all); the variance that linear interpolation adds, step²/6, is subtracted from sigma² beforehand, so
    that R errs by less than 1e-6 of its peak for gates longer than sigma_s. Below 3e-5 of the pulse's base length the
    blur changes R by less than 1.2e-5 of the pulse's peak × base, and the pulse is returned unchanged.
    Raises ValueError if `sigma_s` is negative.
    """
    if not (np.isfinite(sigma_s) and sigma_s >= 0.0):
        raise ValueError(f"sigma_s must be finite and at least 0, not {sigma_s!r}")
    if sigma_s == 0.0:
        return pulse
    if isinstance(pulse, GaussianPulse):
        return GaussianPulse(float(np.hypot(pulse.fwhm_s, FWHM_PER_SIGMA * sigma_s)))
    if isinstance(pulse, ExponentialPulse):
        return ExponentialPulse(float(np.hypot(pulse.fwhm_s, FWHM_PER_SIGMA * sigma_s)), pulse.tail_s)
    part = pulse_part(pulse)
    assert isinstance(part, PiecewiseLinear)
    lo, hi = part.support
    if sigma_s < 3e-5 * (hi - lo):
        return pulse
    lo, hi = lo - 8.1 * sigma_s, hi + 8.1 * sigma_s
    count = int(min(np.ceil((hi - lo) / sigma_s * _PER_SIGMA), _MOST_SAMPLES - 1)) + 1
    t, step = np.linspace(lo, hi, count, retstep=True)
    blur = Gaussian(0.0, float(np.sqrt(sigma_s**2 - float(step) ** 2 / 6.0)))
    value = np.zeros_like(t)
    for knot, jump, bend in zip(part.knot, part.jumps, part.bends, strict=True):
        # (p * N)(t) = Σ J·∫N over (x−t, ∞) mirrored (N is even), and its integral for the bends.
        value += jump * blur.upper(knot - t) + bend * blur.upper2(knot - t)
    if all(part.left >= 0.0) and all(part.right >= 0.0):
        value = np.maximum(value, 0.0)
    return SampledPulse(float(step), tuple(value.tolist()))


def finest_feature_s(pulse: Pulse) -> float:
    """Shortest feature of the pulse that samples must resolve [s]: σ of a Gaussian (also of the rise of an exponential
    pulse), the shortest straight piece, or, of a sampled pulse, its peak over its steepest slope."""
    if isinstance(pulse, GaussianPulse | ExponentialPulse):
        return float(pulse.fwhm_s / FWHM_PER_SIGMA)
    if isinstance(pulse, SampledPulse):
        value = np.asarray(pulse.value, dtype=np.float64)
        return float(pulse.step_s * np.ptp(value) / np.abs(np.diff(value)).max())
    part = pulse_part(pulse)
    if isinstance(part, PiecewiseLinear):
        return float(np.diff(part.knot).min())
    return float(np.sqrt(pulse_variance(pulse)))


def sample_pulse(pulse: Pulse, step_s: float) -> tuple[float, Array]:
    """Samples of p on an even grid, as a rig declares them: (start_s, value[1/s]), unit area and centroid 0 when read
    with straight lines between the samples.

    Continuous pulses: values at the grid's points. Pulses that jump: weighted with the hat function of the grid
    (∫ p(t) hat((t−t_i)/step) dt / step), which keeps area and centroid. A sampled pulse at its own step is returned
    unchanged. Interpolated linearly, the samples exceed the pulse's variance by step²/6 (points) or step²/3 (hats).
    Raises ValueError unless 0 < step_s < half of the support, and where over 2²² samples would be needed.
    """
    part = pulse_part(pulse)
    lo, hi = part.support
    if isinstance(pulse, SampledPulse) and abs(step_s / pulse.step_s - 1.0) < 1e-9:
        assert isinstance(part, PiecewiseLinear)
        return lo, np.append(part.right[:-1], part.left[-1])
    if not 0.0 < step_s < 0.5 * (hi - lo):
        raise ValueError(f"step_s must be above 0 and below half the pulse's support {hi - lo:.6g} s, not {step_s!r}")
    if hi - lo > _MOST_GRID * step_s:
        raise ValueError(f"step_s {step_s:.3g} over a support of {hi - lo:.3g} s gives more than {_MOST_GRID} samples")
    count = int(np.ceil((hi - lo) / step_s)) + 3
    # Centred on the support, so that a symmetric pulse has symmetric samples.
    start = 0.5 * (lo + hi) - 0.5 * (count - 1) * step_s
    t = np.asarray(start + step_s * np.arange(count), dtype=np.float64)
    if isinstance(part, PiecewiseLinear) and np.any(np.abs(part.jumps) > 0.0):
        edge = np.asarray(start + step_s * np.arange(-1, count + 1), dtype=np.float64)
        value = np.maximum(np.diff(part.upper2(edge), n=2), 0.0) / step_s**2
    else:
        value = part.density(t)
    linear = samples(start, step_s, value)
    return start - linear.centroid, value / linear.area
