"""Simulated records of an instrument's pulse and gates, as a laboratory takes them for a calibration."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
import numpy.typing as npt

from ...optics.correlation import waveforms

__all__ = ["Record", "record_gate", "record_pulse"]

Float = npt.NDArray[np.float64]


class Record(IntEnum):
    """Kinds of records: the stage in the key of the random stream. Never renumber; the generator's stages differ from these."""

    PULSE = 101
    GATE = 102


#: Dark counts per sample, as a fraction of the brightest sample's.
_DARK = 1e-3
#: Empty margin on both sides of a record, in lengths of the shape, as a laboratory does not know where the shape ends.
_MARGIN = 0.5


def _grid(low: float, high: float, step: float) -> Float:
    length = high - low
    first = np.floor((low - _MARGIN * length) / step)
    last = np.ceil((high + _MARGIN * length) / step)
    return np.asarray(np.arange(first, last + 1) * step, np.float64)


def record_pulse(
    pulse: waveforms.Pulse, step_s: float, photoelectrons: float, rng: np.random.Generator
) -> tuple[Float, Float]:
    """(time, counts) of a pulse in bins of `step_s` centred at `time`; time 0 is the centroid of the pulse."""
    time = _grid(*_core(waveforms.pulse_support(pulse), waveforms.pulse_variance(pulse)), step_s)
    edge = np.append(time - 0.5 * step_s, time[-1] + 0.5 * step_s)
    mean = photoelectrons * np.maximum(-np.diff(waveforms.pulse_part(pulse).upper(edge)), 0.0)
    mean = mean + _DARK * mean.max()
    return time, rng.poisson(mean).astype(np.float64)


def _core(support: tuple[float, float], variance: float) -> tuple[float, float]:
    """The support, limited to 6 standard deviations, as tails far below one count are not recorded."""
    reach = 6.0 * float(np.sqrt(variance))
    return max(support[0], -reach), min(support[1], reach)


def record_gate(
    gate: waveforms.Gate, step_s: float, photoelectrons: float, rng: np.random.Generator
) -> tuple[Float, Float]:
    """(delay, counts) of a gate scanned in steps of `step_s`; `photoelectrons` per step at transmission 1.

    Each step measures the gate weighted by the hat function that spans its two neighbours. The record, interpolated linearly,
    then keeps area and centroid of the gate, and the position of a jump. With samples at points, a jump would be displaced by
    up to half a step.
    """
    delay = _grid(*waveforms.gate_support(gate), step_s)
    edge = np.concatenate([[delay[0] - step_s], delay, [delay[-1] + step_s]])
    seen = sum(np.diff(part.upper2(edge), n=2) for part in waveforms.gate_parts(gate)) / step_s**2
    mean = photoelectrons * np.clip(seen, 0.0, 1.0)
    return delay, rng.poisson(mean + _DARK * mean.max()).astype(np.float64)
