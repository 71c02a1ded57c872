"""Steps and tables by which a rig's pulse and gates become samples, and the refusal of those that cannot."""

from __future__ import annotations

import numpy as np

from ..optics.correlation import waveforms
from ..optics.correlation.response import Table, tabulate
from .errors import InputError
from .rigs.gated import GatedRig

__all__ = ["MOST_SAMPLES", "gated_sample_step", "response_table", "sample_step_s"]

#: Samples per characteristic width of the pulse or gate edge in the declared rig.
_SAMPLES_PER_WIDTH = 48
#: Most samples of a pulse or gate in a declared rig: 10 MB as text, in every capture.
MOST_SAMPLES = 1 << 20
#: Most samples that a pulse's finest part may ask for.
_FINE_SAMPLES = 1 << 14
_PS = 1e-12


def gated_sample_step(rig: GatedRig, where: str) -> float:
    """One even step [s] for pulse and gates as declared: fine against the pulse and against every gate's width.

    Raises:
        InputError: a pulse too short for steps of 1 ps, or one so short against pulse or gate that over 2²⁰ samples of
            these would be needed. `where`: of the scene, for the message.
    """
    pulse = waveforms.pulse_from_spec(rig.laser.pulse)
    gates = [waveforms.gate_from_spec(gate) for gate in rig.gates]
    spans = [_span(*waveforms.pulse_support(pulse)), *(_span(*waveforms.gate_support(gate)) for gate in gates)]
    widths = [2.0 * float(np.sqrt(waveforms.pulse_variance(pulse))), *(span / 2 for span in spans[1:])]
    # A gate far longer than the pulse does not coarsen it.
    step = sample_step_s(min(widths) / _SAMPLES_PER_WIDTH, pulse, max(spans), _PS)
    names = ["rig.laser.pulse", *(f"rig.gates.{number}" for number in range(len(gates)))]
    for name, span in zip(names, spans, strict=True):
        if not step < 0.5 * span:
            raise InputError(
                "Pulse and gates are declared as samples 1 ps apart or more, and these are too short for it.",
                where=f"{where}: {name}",
                value=f"{span:.3g} s long with its tails",
                allowed=f"longer than {2 * step:.3g} s",
                next_step="lengthen it: a response is as long as the longer of pulse and gate",
            )
        if span > step * MOST_SAMPLES:
            raise InputError(
                "Pulse and gates are declared as samples at one step, and this takes too many of them.",
                where=f"{where}: {name}",
                value=f"{span:.3g} s long with its tails, in steps of {step:.3g} s",
                allowed=f"at most {MOST_SAMPLES} samples: here {MOST_SAMPLES * step:.3g} s",
                next_step="shorten it, or lengthen the shortest of the pulse and the gates, which sets the step",
            )
    return step


def sample_step_s(wanted_s: float, pulse: waveforms.Pulse, span_s: float, grain_s: float) -> float:
    """Step of declared samples [s]: `wanted_s`, or half the pulse's finest part where that is less, as long as a span of
    `span_s` takes no more than `_FINE_SAMPLES`; a multiple of `grain_s`, which keeps the numbers readable."""
    step = min(wanted_s, max(0.5 * waveforms.finest_feature_s(pulse), span_s / _FINE_SAMPLES))
    return max(round(step / grain_s), 1) * grain_s


def _span(low: float, high: float) -> float:
    return float(high - low)


def response_table(pulse: waveforms.Pulse, gate: waveforms.Gate, rtol: float, where: str) -> Table:
    """R(u) of pulse and gate as a table (`optics.correlation.tabulate`); `where`: of the gate, for the message.

    Raises:
        InputError: a gate that lets nothing through, or a pulse too short or too steep against it for `rtol`.
    """
    try:
        return tabulate(pulse, gate, rtol)
    except ValueError as error:
        raise InputError(
            "The response of this pulse and gate cannot be tabulated.",
            where=where,
            value=str(error),
            allowed="an open gate of at most some 10⁵ lengths of the pulse, fewer where both have steep edges",
            next_step="shorten the gate, lengthen the pulse, or give one of them gentler edges",
        ) from error
