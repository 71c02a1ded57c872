"""Calibrate pulse and gate: from noisy traces of a laboratory to the samples of a declared rig.

A pulse is measured as repeated, noisy traces of a fast detector; a gate by moving a short flash through it. Both become
even samples, smoothed no more than the noise requires, background removed, the pulse with unit area and its centroid at
0, the gate with its opening half height at 0.

Shape and place are estimated separately, because the steps that improve the shape bias the place. The shape is smoothed,
cut where it sinks into the noise, and kept above 0. The place comes from the unsmoothed record by sums that are linear in
it, so that noise moves it equally to both sides: the centroid of the pulse over a window twice as long as the shape, and
the half height of the gate as the crossing of a symmetric average over the opening edge. (The first sample above half of a
noisy curve lies early; a straight line to the sample before the upper end of a jump lies half a step early.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...scenes.errors import InputError
from ..rig import samples_of

__all__ = ["gate_from_scan", "pulse_from_trace", "simulate_measurement"]

Float = npt.NDArray[np.float64]

#: Nodes of the average over an edge: an odd number, so that one is its centre.
_NODES = np.linspace(-1.0, 1.0, 65)
#: Epanechnikov's weights with the second moment removed: exact for edges that are odd about their half height, such as
#: jumps and ramps, and for cubics.
_WEIGHTS = (1.0 - _NODES**2) * (3.0 - 7.0 * _NODES**2)
#: Shortest half width of that average, in steps: a jump rises over two.
_LEAST_REACH = 3.0


@dataclass(frozen=True)
class _Record:
    """A record with the background removed: as measured, and smoothed; the shape is smooth[first:last]."""

    raw: Float
    smooth: Float
    first: int
    last: int

    def shape(self) -> Float:
        """The smoothed samples of the shape, above 0, 0 at both ends."""
        cut = np.maximum(self.smooth[self.first : self.last], 0.0)
        cut[0] = cut[-1] = 0.0
        return cut


def _checked(start_s: float, step_s: float, trace: npt.ArrayLike, what: str) -> Float:
    values = np.asarray(trace, dtype=np.float64)
    values = values[None, :] if values.ndim == 1 else values
    if values.ndim != 2 or values.shape[1] < 16 or not np.isfinite(values).all():
        raise InputError(
            f"The measurement of the {what} cannot be used.", where=what, value=values.shape,
            allowed="finite numbers (shot, sample), 16 samples or more",
        )  # fmt: skip
    if not (np.isfinite(start_s) and step_s > 0):
        raise InputError(
            f"The time axis of the {what} cannot be used.", where=what, value=(start_s, step_s),
            allowed="a finite start_s, step_s > 0",
        )  # fmt: skip
    return values


def _noise(mean: Float) -> float:
    """Standard deviation of one sample from third differences, to which a smooth signal contributes little."""
    third = np.diff(mean, n=3)
    return float(1.4826 * np.median(np.abs(third - np.median(third))) / np.sqrt(20))


def _smooth(mean: Float, noise: float) -> Float:
    """Wiener filter: each frequency is weighted by its power above that of the white noise, over its power.

    The power is averaged over neighbouring frequencies; all beyond the first band without signal is taken as noise.
    """
    n = mean.size
    spectrum = np.fft.rfft(np.concatenate([mean, mean[::-1]]))
    power = np.abs(spectrum) ** 2
    level = 2 * n * max(noise, 1e-12 * float(np.abs(mean).max())) ** 2 * 2
    local = np.convolve(np.pad(power, 4, mode="edge"), np.ones(9) / 9, mode="valid")
    gain = np.clip(1 - level / np.maximum(local, 1e-300), 0, 1)
    silent = np.flatnonzero(local < 1.5 * level)
    if silent.size:
        gain[silent[0] :] = 0
    return np.asarray(np.fft.irfft(gain * spectrum, 2 * n)[:n])


def _support(smooth: Float, noise: float) -> tuple[int, int]:
    """First and last + 1 sample of the shape: the samples about the maximum that exceed the noise and 1e-3 of it, and the
    tails beyond them while they stay above 0."""
    above = smooth > max(2 * noise, 1e-3 * float(smooth.max()))
    top = int(smooth.argmax())
    before, after = np.flatnonzero(~above[:top]), np.flatnonzero(~above[top:])
    first = int(before[-1]) if before.size else 0
    last = top + int(after[0]) if after.size else smooth.size - 1
    below, beyond = np.flatnonzero(smooth[: first + 1] <= 0), np.flatnonzero(smooth[last:] <= 0)
    first = int(below[-1]) if below.size else 0
    last = last + int(beyond[0]) if beyond.size else smooth.size - 1
    return first, last + 1


def _recover(values: Float, step_s: float, what: str) -> _Record:
    raw = values.mean(axis=0)
    edge = max(3, raw.size // 20)
    # The mean, not the median: counts of a few are skew.
    raw = raw - np.concatenate([raw[:edge], raw[-edge:]]).mean()
    noise = _noise(raw)
    smooth = _smooth(raw, noise)
    if not smooth.max() > 5 * noise:
        raise InputError(
            f"The {what} does not exceed the noise.", where=what, value=float(smooth.max() / max(noise, 1e-300)),
            allowed="a peak above 5 standard deviations", next_step="average more shots",
        )  # fmt: skip
    first, last = _support(smooth, noise)
    if last - first < 3:
        raise InputError(
            f"The {what} is shorter than 3 samples.", where=what, value=last - first, allowed="3 samples or more",
            next_step="sample in smaller steps",
        )  # fmt: skip
    return _Record(raw, smooth, first, last)


def _centroid(record: _Record) -> float:
    """Centroid of the record, in samples, over the shape and half its length on either side."""
    room = (record.last - record.first) // 2
    low, high = max(record.first - room, 0), min(record.last + room, record.raw.size)
    weight = record.raw[low:high]
    return low + float((np.arange(weight.size) * weight).sum() / weight.sum())


def _top(record: _Record) -> float:
    """Height of the top of the gate, a plateau or a peak: at the centre of a parabola through the middle of the samples
    above .9 of the maximum."""
    high = record.first + np.flatnonzero(record.shape() >= 0.9 * float(record.smooth.max()))
    low, high_end, middle = int(high[0]), int(high[-1]), 0.5 * float(high[0] + high[-1])
    inset = int(0.2 * (high_end - low))
    chosen = np.arange(low + inset, high_end - inset + 1)
    if chosen.size < 5:
        return float(record.smooth.max())
    x = (chosen - middle) / max(float(high_end - low), 1.0)
    return float(np.polyval(np.polyfit(x, record.raw[chosen], 2), 0.0))


def _opening(record: _Record, top: float) -> float:
    """Where the record first passes half of `top`, in samples: the crossing of its average over the opening edge.

    The average reaches half of the time from ¼ to ¾ of the top to either side, and 3 steps at least.
    """
    samples = np.arange(record.raw.size)
    upper = record.first + int(np.flatnonzero(record.smooth[record.first : record.last] >= 0.75 * top)[0])

    def crossing(level: float) -> float:
        below = np.flatnonzero(record.smooth[:upper] < level)
        i = int(below[-1]) if below.size else 0
        low, high = float(record.smooth[i]), float(record.smooth[i + 1])
        return i + (level - low) / (high - low)

    begin, start, end = crossing(0.25 * top), crossing(0.5 * top), crossing(0.75 * top)
    reach = max(_LEAST_REACH, 0.5 * (end - begin))
    centre = start + np.linspace(-reach, reach, 257)
    place = centre[:, None] + reach * _NODES
    average = np.interp(place, samples, record.raw) @ _WEIGHTS / _WEIGHTS.sum() - 0.5 * top
    rising = np.flatnonzero((average[:-1] < 0) & (average[1:] >= 0))
    if not rising.size:
        return start
    i = int(rising[np.abs(centre[rising] - start).argmin()])
    return float(centre[i] - average[i] * (centre[i + 1] - centre[i]) / (average[i + 1] - average[i]))


def pulse_from_trace(start_s: float, step_s: float, trace: npt.ArrayLike) -> dict[str, Any]:
    """Samples {"start_s", "step_s", "value"} [1/s] of a pulse: unit area, t = 0 at the centroid of the record, so that a
    tail too faint to be among the samples still enters their place.

    Main arguments: time axis; trace (sample) or (shot, sample), in any unit and with any offset. Raises InputError for a
    measurement that cannot be used.
    """
    record = _recover(_checked(start_s, step_s, trace, "pulse"), step_s, "pulse")
    shape = record.shape()
    start = (record.first - _centroid(record)) * step_s
    return {"start_s": start, "step_s": float(step_s), "value": [float(v) for v in shape / (shape.sum() * step_s)]}


def gate_from_scan(
    start_s: float, step_s: float, scan: npt.ArrayLike, *, transmission: float, flash: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Samples {"start_s", "step_s", "value"} of a gate: top at `transmission`, opening half height at 0.

    Main arguments: time axis; the light of the flash that passes the gate at each time, (sample) or (repeat, sample); the
    greatest transmission of the gate. Other arguments: flash: samples of the flash; the width that its variance adds is
    removed to first order, by the sharpening g − ½σ²·g″. Raises InputError for a measurement that cannot be used.
    """
    if not 0 < transmission <= 1:
        raise InputError(
            "The transmission is not a fraction.", where="gate", value=transmission, allowed="0 < transmission <= 1"
        )
    record = _recover(_checked(start_s, step_s, scan, "gate"), step_s, "gate")
    top = _top(record)
    value = np.clip(record.shape() * transmission / top, 0.0, 1.0)
    opening = _opening(record, top)
    if flash is not None:
        _start, step, p = samples_of(flash, "flash")
        t = step * np.arange(p.size)
        variance = float((t**2 * p).sum() / p.sum() - ((t * p).sum() / p.sum()) ** 2)
        slope = np.gradient(value, step_s)
        bend = np.gradient(slope, step_s)
        # Sharpened by −½σ²g″, the edge passes half height where it did plus ½σ²g″/g′.
        at = np.arange(value.size) + record.first
        opening += 0.5 * variance * float(np.interp(opening, at, bend) / np.interp(opening, at, slope)) / step_s
        value = np.clip(value - 0.5 * variance * bend, 0.0, 1.0)
        value[0] = value[-1] = 0.0
    start = (record.first - opening) * step_s
    return {"start_s": start, "step_s": float(step_s), "value": [float(v) for v in value]}


def simulate_measurement(
    samples: Mapping[str, Any], *, noise: float, shots: int, seed: int, margin: float = 0.5
) -> tuple[float, float, Float]:
    """A noisy laboratory trace of declared samples: (start_s, step_s, trace (shot, sample)).

    The noise is white, with the standard deviation `noise`·peak per shot and sample; the trace has `margin`·length of empty
    time on both sides, and an offset and a scale that are drawn from the seed. Raises InputError.
    """
    if noise < 0 or shots < 1 or margin <= 0:
        raise InputError("The parameters describe no measurement.", where="simulate_measurement",
                         value=(noise, shots, margin), allowed="noise >= 0, shots >= 1, margin > 0")  # fmt: skip
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    start, step, value = samples_of(samples, "simulate_measurement")
    pad = max(16, int(margin * value.size))
    clean = np.concatenate([np.zeros(pad), value, np.zeros(pad)]) / value.max()
    scale, offset = rng.uniform(0.5, 2.0), rng.normal(0, 0.1)
    trace = scale * (clean + noise * rng.normal(size=(shots, clean.size))) + offset
    return start - pad * step, step, np.asarray(trace)
