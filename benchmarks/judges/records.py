"""Simulated records of an instrument's pulse and gates, as a laboratory takes them to calibrate it."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
import numpy.typing as npt

from ...optics.correlation import waveforms

__all__ = ["Record", "record_gate", "record_pulse"]

Float = npt.NDArray[np.float64]


class Record(IntEnum):
    """What is recorded: the stage in its random stream's name. Never renumber; apart from the generator's stages."""

    PULSE = 101
    GATE = 102


#: Dark counts per sample, as a fraction of the brightest sample's.
_DARK = 1e-3
#: Empty room on both sides of a record, in lengths of the shape: a laboratory does not know where it ends.
_MARGIN = 0.5


def _grid(low: float, high: float, step: float) -> Float:
    length = high - low
    first = np.floor((low - _MARGIN * length) / step)
    last = np.ceil((high + _MARGIN * length) / step)
    return np.asarray(np.arange(first, last + 1) * step, np.float64)


def record_pulse(
    pulse: waveforms.Pulse, step_s: float, photoelectrons: float, rng: np.random.Generator
) -> tuple[Float, Float]:
    """(time, counts) of a pulse in bins of `step_s` centred at `time`; the clock's zero is the pulse's centroid."""
    time = _grid(*_core(waveforms.pulse_support(pulse), waveforms.pulse_variance(pulse)), step_s)
    edge = np.append(time - 0.5 * step_s, time[-1] + 0.5 * step_s)
    mean = photoelectrons * np.maximum(-np.diff(waveforms.pulse_part(pulse).upper(edge)), 0.0)
    mean = mean + _DARK * mean.max()
    return time, rng.poisson(mean).astype(np.float64)


def _core(support: tuple[float, float], variance: float) -> tuple[float, float]:
    """The support, cut at 6 standard deviations where it is longer: tails far below one count are not recorded."""
    reach = 6.0 * float(np.sqrt(variance))
    return max(support[0], -reach), min(support[1], reach)


def record_gate(
    gate: waveforms.Gate, step_s: float, photoelectrons: float, rng: np.random.Generator
) -> tuple[Float, Float]:
    """(delay, counts) of a gate scanned in steps of `step_s`; `photoelectrons` per step at transmission 1.

    Each step sees the gate through the hat that spans the steps beside it, so that the record read with straight lines
    keeps the gate's area and centroid, and a jump its place: sampled at points, a jump between two of them, or on one, is
    read up to half a step away.
    """
    delay = _grid(*waveforms.gate_support(gate), step_s)
    edge = np.concatenate([[delay[0] - step_s], delay, [delay[-1] + step_s]])
    seen = sum(np.diff(part.upper2(edge), n=2) for part in waveforms.gate_parts(gate)) / step_s**2
    mean = photoelectrons * np.clip(seen, 0.0, 1.0)
    return delay, rng.poisson(mean + _DARK * mean.max()).astype(np.float64)
