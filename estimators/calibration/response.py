"""Calibrate pulse and gate: from noisy traces of a laboratory to the samples that a declared rig holds.

A pulse is seen by a fast detector as repeated, noisy traces; a gate by moving a short flash through it. Both come out
as even samples, smoothed no more than the noise asks, background removed, the pulse with unit area and its centroid at
0, the gate with its opening half height at 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ...scenes.errors import InputError

__all__ = ["gate_from_scan", "pulse_from_trace", "simulate_measurement"]

Float = npt.NDArray[np.float64]


def _checked(start_s: float, step_s: float, trace: npt.ArrayLike, what: str) -> Float:
    values = np.asarray(trace, dtype=np.float64)
    values = values[None, :] if values.ndim == 1 else values
    if values.ndim != 2 or values.shape[1] < 16 or not np.isfinite(values).all():
        raise InputError(
            f"unusable {what} measurement", where=what, value=values.shape, allowed="finite (shot, sample), 16 or more"
        )
    if not (np.isfinite(start_s) and step_s > 0):
        raise InputError(f"unusable time axis of the {what}", where=what, value=(start_s, step_s), allowed="step_s > 0")
    return values


def _noise(mean: Float) -> float:
    """Standard deviation of one sample from third differences, which a smooth signal hardly enters."""
    third = np.diff(mean, n=3)
    return float(1.4826 * np.median(np.abs(third - np.median(third))) / np.sqrt(20))


def _smooth(mean: Float, noise: float) -> Float:
    """Wiener filter in frequency: each component weighted by its power above the white noise's, over its power.

    The power is averaged over neighbouring frequencies; beyond the first band without signal all is taken as noise.
    """
    n = mean.size
    spectrum = np.fft.rfft(np.concatenate([mean, mean[::-1]]))
    power = np.abs(spectrum) ** 2
    level = 2 * n * max(noise, 1e-12 * float(np.abs(mean).max())) ** 2 * 2
    kernel = np.ones(9) / 9
    local = np.convolve(np.pad(power, 4, mode="edge"), kernel, mode="valid")
    gain = np.clip(1 - level / np.maximum(local, 1e-300), 0, 1)
    silent = np.flatnonzero(local < 1.5 * level)
    if silent.size:
        gain[silent[0] :] = 0
    return np.asarray(np.fft.irfft(gain * spectrum, 2 * n)[:n])


def _support(smooth: Float, noise: float) -> tuple[int, int]:
    """First and last + 1 sample of the connected part around the maximum that stands above the noise and 1e-3."""
    above = smooth > max(2 * noise, 1e-3 * float(smooth.max()))
    top = int(smooth.argmax())
    before, after = np.flatnonzero(~above[:top]), np.flatnonzero(~above[top:])
    first = int(before[-1]) if before.size else 0
    last = top + int(after[0]) + 1 if after.size else smooth.size
    return max(first, 0), min(last, smooth.size)


def _recover(values: Float, step_s: float, what: str) -> tuple[Float, int, int]:
    mean = values.mean(axis=0)
    edge = max(3, mean.size // 20)
    mean = mean - np.median(np.concatenate([mean[:edge], mean[-edge:]]))
    noise = _noise(mean)
    smooth = _smooth(mean, noise)
    if not smooth.max() > 5 * noise:
        raise InputError(
            f"no {what} stands out of the noise", where=what, value=float(smooth.max() / max(noise, 1e-300)),
            allowed="peak above 5 standard deviations", next_step="average more shots",
        )  # fmt: skip
    first, last = _support(smooth, noise)
    if last - first < 3:
        raise InputError(f"the {what} is shorter than 3 samples", where=what, value=step_s, next_step="sample finer")
    cut = np.maximum(smooth[first:last], 0.0)
    cut[0] = cut[-1] = 0.0
    return cut, first, last


def pulse_from_trace(start_s: float, step_s: float, trace: npt.ArrayLike) -> dict[str, Any]:
    """Samples {"start_s", "step_s", "value"} [1/s] of a pulse: unit area, centroid at t = 0.

    Main arguments: time axis and trace (sample) or (shot, sample), any unit and offset. Raises InputError.
    """
    values = _checked(start_s, step_s, trace, "pulse")
    cut, _first, _last = _recover(values, step_s, "pulse")
    area = float(cut.sum() * step_s)
    centroid = float((np.arange(cut.size) * cut).sum() / cut.sum()) * step_s
    return {"start_s": -centroid, "step_s": float(step_s), "value": [float(v) for v in cut / area]}


def gate_from_scan(
    start_s: float, step_s: float, scan: npt.ArrayLike, *, transmission: float, flash: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Samples {"start_s", "step_s", "value"} of a gate: top at `transmission`, opening half height at 0.

    Main arguments: time axis and the light that passes a flash at each time, (sample) or (repeat, sample); the gate's
    greatest transmission. Other arguments: flash: samples of the flash; its variance is taken off by the first-order
    sharpening g − ½σ²·g″, where the noise lets that be seen. Raises InputError.
    """
    if not 0 < transmission <= 1:
        raise InputError(
            "transmission is a fraction", where="gate", value=transmission, allowed="0 < transmission <= 1"
        )
    values = _checked(start_s, step_s, scan, "gate")
    cut, _first, _last = _recover(values, step_s, "gate")
    # The top is a plateau or a peak: a parabola over it serves both, and is steadier than one largest sample.
    upper = np.flatnonzero(cut >= 0.9 * cut.max())
    if upper.size >= 5:
        x = (upper - upper.mean()) / max(float(np.ptp(upper)), 1.0)
        top = float(np.polyval(np.polyfit(x, cut[upper], 2), x).max())
    else:
        top = float(cut.max())
    value = np.clip(cut * transmission / top, 0.0, 1.0)
    if flash is not None:
        p = np.asarray(flash["value"], dtype=np.float64)
        t = float(flash["step_s"]) * np.arange(p.size)
        variance = float((t**2 * p).sum() / p.sum() - ((t * p).sum() / p.sum()) ** 2)
        bend = np.gradient(np.gradient(value, step_s), step_s)
        value = np.clip(value - 0.5 * variance * bend, 0.0, 1.0)
        value[0] = value[-1] = 0.0
    half = 0.5 * transmission
    i = int(np.flatnonzero(value >= half)[0])
    opening = i - (value[i] - half) / (value[i] - value[i - 1])
    return {"start_s": -opening * step_s, "step_s": float(step_s), "value": [float(v) for v in value]}


def simulate_measurement(
    samples: Mapping[str, Any], *, noise: float, shots: int, seed: int, margin: float = 0.5
) -> tuple[float, float, Float]:
    """A noisy laboratory trace of declared samples: (start_s, step_s, trace (shot, sample)).

    White noise of standard deviation `noise`·peak per shot and sample; `margin`·length of empty time on both sides, an
    unknown offset and scale drawn from the seed. This is the stated noise of a suite's "calibrated" condition.
    """
    if noise < 0 or shots < 1 or margin <= 0:
        raise InputError("not a measurement", where="simulate_measurement", value=(noise, shots, margin),
                         allowed="noise >= 0, shots >= 1, margin > 0")  # fmt: skip
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    value = np.asarray(samples["value"], dtype=np.float64)
    pad = max(16, int(margin * value.size))
    clean = np.concatenate([np.zeros(pad), value, np.zeros(pad)]) / value.max()
    scale, offset = rng.uniform(0.5, 2.0), rng.normal(0, 0.1)
    trace = scale * (clean + noise * rng.normal(size=(shots, clean.size))) + offset
    step = float(samples["step_s"])
    return float(samples["start_s"]) - pad * step, step, np.asarray(trace)
