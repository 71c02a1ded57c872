"""Pulse and gate shapes. Times in seconds; a pulse's time 0 is its centroid, a gate's the opening half-height edge."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from .base import Fraction, Spec
from .quantities import MomentTime, OpenTime, OptionalTime, PulseTime

__all__ = [
    "ExponentialGate", "ExponentialPulse", "Gate", "GaussianGate", "GaussianPulse", "Pulse", "RectangularGate",
    "RectangularPulse", "SampledGate", "SampledPulse", "TrapezoidalGate", "TrapezoidalPulse",
]  # fmt: skip

#: A measured value in any unit (a pulse's scale is removed); subtracting an offset leaves some below zero.
Sample = Annotated[float, Field(ge=-1e30, le=1e30)]

#: Of an open gate: one that lets less than this through is closed.
Transmission = Annotated[float, Field(ge=1e-12, le=1)]


class GaussianPulse(Spec):
    """p ∝ exp(−t²/2σ²), fwhm = σ√(8 ln 2)."""

    kind: Literal["gaussian"] = "gaussian"
    fwhm_s: PulseTime


class RectangularPulse(Spec):
    """Constant over `width_s`."""

    kind: Literal["rectangular"] = "rectangular"
    width_s: PulseTime


class TrapezoidalPulse(Spec):
    """Linear rise, flat top, linear fall; rise + top + fall is the whole base."""

    kind: Literal["trapezoidal"] = "trapezoidal"
    rise_s: OptionalTime
    top_s: OptionalTime
    fall_s: OptionalTime

    @model_validator(mode="after")
    def _has_area(self) -> TrapezoidalPulse:
        if self.rise_s + self.top_s + self.fall_s <= 0:
            raise ValueError("rise_s + top_s + fall_s must be positive")
        return self


class ExponentialPulse(Spec):
    """A Gaussian of `fwhm_s` convolved with an exponential decay of time constant `tail_s` (exGaussian)."""

    kind: Literal["exponential"] = "exponential"
    fwhm_s: PulseTime
    tail_s: PulseTime


class SampledPulse(Spec):
    """Measured samples on an even grid, linear between them, zero outside; any offset, scaled to unit area."""

    kind: Literal["sampled"] = "sampled"
    step_s: PulseTime
    value: tuple[Sample, ...] = Field(min_length=3)


class RectangularGate(Spec):
    """Open from 0 to `width_s`."""

    kind: Literal["rectangular"] = "rectangular"
    width_s: OpenTime
    transmission: Transmission


class TrapezoidalGate(Spec):
    """Linear edges; `width_s` is between the half heights, so top = width − (rise + fall)/2."""

    kind: Literal["trapezoidal"] = "trapezoidal"
    width_s: OpenTime
    rise_s: OptionalTime
    fall_s: OptionalTime
    transmission: Transmission

    @model_validator(mode="after")
    def _top_not_negative(self) -> TrapezoidalGate:
        if self.width_s < (self.rise_s + self.fall_s) / 2:
            raise ValueError("width_s must be at least (rise_s + fall_s)/2")
        return self


class GaussianGate(Spec):
    """Gaussian transmission of full width `fwhm_s`; the opening half height is at 0, the peak at fwhm/2."""

    kind: Literal["gaussian"] = "gaussian"
    fwhm_s: OpenTime
    transmission: Transmission


class ExponentialGate(Spec):
    """Opens at once, stays open for `width_s`, then decays as exp(−t/tail_s)."""

    kind: Literal["exponential"] = "exponential"
    width_s: Annotated[float, Field(ge=0, le=1)]
    tail_s: PulseTime
    transmission: Transmission


class SampledGate(Spec):
    """Measured transmission on an even grid from `start_s`, linear between samples, zero outside."""

    kind: Literal["sampled"] = "sampled"
    start_s: MomentTime
    step_s: OpenTime
    value: tuple[Fraction, ...] = Field(min_length=3)


Pulse = Annotated[
    GaussianPulse | RectangularPulse | TrapezoidalPulse | ExponentialPulse | SampledPulse, Field(discriminator="kind")
]
Gate = Annotated[
    RectangularGate | TrapezoidalGate | GaussianGate | ExponentialGate | SampledGate, Field(discriminator="kind")
]
