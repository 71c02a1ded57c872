"""Pulse and gate shapes from both files, `pulses.py` and `gates.py`.

`pulse_from_spec` and `gate_from_spec` turn a spec of `scenes.waveforms`, or any object with the same class name and
fields, into the shape.
"""

from __future__ import annotations

import dataclasses

from .gates import (
    ExponentialGate,
    Gate,
    GaussianGate,
    RectangularGate,
    SampledGate,
    TrapezoidalGate,
    gate_area,
    gate_parts,
    gate_support,
    gate_transmission,
    sample_gate,
)
from .pulses import (
    ExponentialPulse,
    GaussianPulse,
    Pulse,
    RectangularPulse,
    SampledPulse,
    TrapezoidalPulse,
    broadened,
    finest_feature_s,
    pulse_density,
    pulse_part,
    pulse_support,
    pulse_variance,
    sample_pulse,
)

__all__ = [
    "ExponentialGate", "ExponentialPulse", "Gate", "GaussianGate", "GaussianPulse", "Pulse", "RectangularGate",
    "RectangularPulse", "SampledGate", "SampledPulse", "TrapezoidalGate", "TrapezoidalPulse", "broadened", "gate_area",
    "gate_from_spec", "gate_parts", "gate_support", "gate_transmission", "pulse_density", "pulse_from_spec",
    "finest_feature_s", "pulse_part", "pulse_support", "pulse_variance", "sample_gate", "sample_pulse",
]  # fmt: skip

_PULSES: dict[str, type[Pulse]] = {
    kind.__name__: kind for kind in (GaussianPulse, RectangularPulse, TrapezoidalPulse, ExponentialPulse, SampledPulse)
}
_GATES: dict[str, type[Gate]] = {
    kind.__name__: kind for kind in (RectangularGate, TrapezoidalGate, GaussianGate, ExponentialGate, SampledGate)
}


def pulse_from_spec(spec: object) -> Pulse:
    """The pulse with the class name and fields of `spec`. Raises TypeError for any other object."""
    kind = _PULSES.get(type(spec).__name__)
    if kind is None:
        raise TypeError(f"not a pulse: {spec!r}; pulses: {', '.join(_PULSES)}")
    return kind(**{field.name: getattr(spec, field.name) for field in dataclasses.fields(kind)})


def gate_from_spec(spec: object) -> Gate:
    """The gate with the class name and fields of `spec`. Raises TypeError for any other object."""
    kind = _GATES.get(type(spec).__name__)
    if kind is None:
        raise TypeError(f"not a gate: {spec!r}; gates: {', '.join(_GATES)}")
    return kind(**{field.name: getattr(spec, field.name) for field in dataclasses.fields(kind)})
