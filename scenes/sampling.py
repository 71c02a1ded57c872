"""Steps and tables by which the pulse and gates of a rig become samples."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from ..optics.correlation import waveforms
from ..optics.correlation.response import Table, tabulate
from .errors import InputError
from .waveforms import Gate, Pulse

__all__ = ["MOST_SAMPLES", "optics_gate", "optics_pulse", "response_table", "rounded", "sample_step_s"]

#: Most samples of a pulse or gate in a declared rig: 10 MB as text, in every capture.
MOST_SAMPLES = 1 << 20
#: Most samples that a pulse's finest part may ask for.
_FINE_SAMPLES = 1 << 14


def optics_pulse(pulse: Pulse) -> waveforms.Pulse:
    """The pulse of `optics` that a spec describes (same name, same fields)."""
    return waveforms.pulse_from_spec(pulse)


def optics_gate(gate: Gate) -> waveforms.Gate:
    """The gate of `optics` that a spec describes (same name, same fields)."""
    return waveforms.gate_from_spec(gate)


def rounded(values: Any) -> list[float]:
    """Nine significant digits: far below any calibration, and half the size in JSON."""
    return [float(f"{v:.9g}") for v in np.asarray(values)]


def sample_step_s(wanted_s: float, pulse: waveforms.Pulse, span_s: float, grain_s: float) -> float:
    """Step of declared samples [s]: `wanted_s`, or half the pulse's finest part where that is less, as long as a span of
    `span_s` takes no more than `_FINE_SAMPLES`; a multiple of `grain_s`, which keeps the numbers readable."""
    step = min(wanted_s, max(0.5 * waveforms.finest_feature_s(pulse), span_s / _FINE_SAMPLES))
    return max(round(step / grain_s), 1) * grain_s


def response_table(pulse: waveforms.Pulse, gate: waveforms.Gate, rtol: float, where: str) -> Table:
    """R(u) of pulse and gate as a table (`optics.correlation.tabulate`); `where`: of the gate, for the message.

    Raises:
        InputError: a gate that lets nothing through, or a pulse too short or too steep against it for `rtol`.
    """
    try:
        return _tabulated(pulse, gate, rtol)
    except ValueError as error:
        raise InputError(
            "The response of this pulse and gate cannot be tabulated.",
            where=where,
            value=str(error),
            allowed="an open gate of at most some 10⁵ lengths of the pulse, fewer where both have steep edges",
            next_step="shorten the gate, lengthen the pulse, or give one of them gentler edges",
        ) from error


@lru_cache(maxsize=64)
def _tabulated(pulse: waveforms.Pulse, gate: waveforms.Gate, rtol: float) -> Table:
    """As `tabulate`; captures of one instrument have the same tables, which nobody may change."""
    table = tabulate(pulse, gate, rtol)
    for values in (table.value, table.slope):
        values.flags.writeable = False
    return table
