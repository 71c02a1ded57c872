"""Pulse and gate shapes. Times in seconds; a pulse's time 0 is its centroid, a gate's the opening half-height edge."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from .base import Fraction, Spec
from .quantities import MomentTime, OpenTime, OptionalTime, PulseTime

__all__ = [
    "ExponentialGate", "ExponentialPulse", "Gate", "GaussianGate", "GaussianPulse", "MeasuredGate", "MeasuredPulse", "Pulse",
    "RectangularGate",
    "RectangularPulse", "SampledGate", "SampledPulse", "TrapezoidalGate", "TrapezoidalPulse",
]  # fmt: skip

#: A measured value in any unit (a pulse's scale is removed); subtracting an offset leaves some below zero.
Sample = Annotated[float, Field(ge=-1e30, le=1e30)]

#: Of a text file: a number from 1, or a name in its heading.
Column = Annotated[int, Field(ge=1, le=10_000)] | Annotated[str, Field(min_length=1)]

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


class _Measured(Spec):
    """A curve in a text file, as an oscilloscope writes it: two columns, with or without a heading."""

    file: str = Field(min_length=1)
    time_unit: Literal["s", "ms", "us", "ns", "ps"]
    time_column: Column = 1
    value_column: Column = 2
    baseline: Sample | tuple[Sample, Sample] | None = None
    keep: tuple[Sample, Sample] | None = None
    inverted: bool = False


class MeasuredPulse(_Measured):
    """Samples of a pulse in a text file beside the scene file. When the scene is loaded they become `kind = "sampled"`, and what
    was done is told: a note names the baseline that was taken off, the samples below zero, and what was kept.

    Columns are numbers from 1, or names in the file's heading. `baseline`: the level without light, or [from, to], times of the
    file without light; absent: the first and the last tenth, which must agree. `keep`: [from, to], times of the file that hold
    the pulse; absent: from the first to the last sample above five standard deviations of the baseline and 0.1 % of the peak. All
    else is set to zero, and so is what lies below zero. `inverted`: light points downward.
    """

    kind: Literal["measured"] = "measured"


class MeasuredGate(_Measured):
    """Samples of a gate's transmission in a text file beside the scene file, in any unit; keys as for a measured pulse.

    The median of the samples above half of the highest is the open level and gets `transmission`; what then lies above 1 is set
    to 1. Time zero is where the opening edge crosses half of the open level.
    """

    kind: Literal["measured"] = "measured"
    transmission: Transmission


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
    GaussianPulse | RectangularPulse | TrapezoidalPulse | ExponentialPulse | SampledPulse | MeasuredPulse,
    Field(discriminator="kind"),
]
Gate = Annotated[
    RectangularGate | TrapezoidalGate | GaussianGate | ExponentialGate | SampledGate | MeasuredGate,
    Field(discriminator="kind"),
]
