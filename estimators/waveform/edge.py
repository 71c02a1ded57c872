"""Timing by an edge: a fixed threshold (leading edge), and the counter that it stops."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.time_of_flight import count_cycles, pulse_distance_eq23
from ...scenes.errors import InputError
from ..registry import estimator
from ..result import range_result
from .background import Background, background_level
from .per_pulse import per_pulse
from .record import WaveformRecord, read_record

__all__ = ["edge_slope", "rise_lag", "waveform_counter", "waveform_leading_edge"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class _Crossing:
    """First upward crossing of a level (shot): its time, s, and whether there is one between good samples."""

    time_s: Float
    found: Bool


def _crossing(record: WaveformRecord, level: Float) -> _Crossing:
    """First crossing of `level` (shot) by straight lines between the samples."""
    z = record.z
    up = (z[:, :-1] < level[:, None]) & (z[:, 1:] >= level[:, None])
    at = np.argmax(up, axis=1)
    found = up.any(axis=1)
    at = np.where(found, at, 0)
    rows = np.arange(len(z))
    before, after = z[rows, at], z[rows, at + 1]
    sound = record.good[rows, at] & record.good[rows, at + 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        f = (level - before) / (after - before)
    return _Crossing(record.time_s[at] + record.step_s * f, found & sound)


def rise_lag(record: WaveformRecord, fraction: Float, smooth: int = 1) -> Float:
    """Lag [s] behind the echo at which its sampled template, averaged over `smooth` samples, first reaches `fraction`
    (any shape, 0 … 1) of its top."""
    share = record.share
    pad = 0.5 * (smooth + 1) * record.step_s
    u = np.arange(share.start_s - pad, share.start_s + share.step_s * share.value.size + pad, share.step_s)
    shifts = (np.arange(smooth) - 0.5 * (smooth - 1)) * record.step_s
    value = np.mean([share(u + shift)[0] for shift in shifts], axis=0)
    # Later samples see smaller u: the template against t − τ = step/2 − u, from its start to its top.
    value, lag = value[::-1], (0.5 * record.step_s - u)[::-1]
    top = int(np.argmax(value))
    rising = np.maximum.accumulate(value[: top + 1])
    start = int(np.flatnonzero(rising > 1e-9 * value[top])[0])
    first = max(start - 1, 0)
    found = np.interp(np.asarray(fraction) * value[top], rising[first:], lag[first : top + 1])
    return np.asarray(found, np.float64)


def _edge(
    record: WaveformRecord, threshold_sigma: float, walk: str, background: Background, where: str
) -> tuple[Float, Float, Bool]:
    """(time of the crossing less its lag behind the echo [s], its standard error, whether there is one), each (shot).

    On the line between two samples the mean of (1−f)² + f² is 2/3: so much of the variance of one sample is left.
    """
    if threshold_sigma <= 0:
        raise InputError("The threshold must be positive.", where=f"{where}[threshold_sigma]", value=threshold_sigma,
                         allowed="> 0")  # fmt: skip
    base, _ = background_level(record, background, where)
    # In a record without noise of its own, one count must still cross the level.
    level = base + threshold_sigma * np.sqrt(np.maximum(record.variance(base), 0.25))
    crossing = _crossing(record, level)
    height = np.maximum(np.where(record.good, record.z, -np.inf).max(axis=1) - base, 1e-9)
    part = np.clip((level - base) / height, 1e-3, 0.95)
    fraction = np.full(len(level), 0.5)
    # Without its brightest samples an echo has no known height, and the walk of the edge no lag.
    found = crossing.found & record.usable & ~record.clipped & record.intact(record.brightest())
    if walk == "median" and found.any():
        fraction = np.full(len(level), np.median(part[found]))
    # The slope comes from the response: between two noisy samples it is steepest where noise made them cross.
    sigma = np.sqrt(2 / 3 * record.variance(level)) / (height * edge_slope(record, part, 1))
    return crossing.time_s - rise_lag(record, fraction), sigma, found


@estimator(
    "waveform",
    cites="Kusters 1992, section 2.2.3.1 and Eq. 2.3; Palojarvi et al., IEEE TIM 54:1569, 2005 (walk; not verified)",
)
@per_pulse
def waveform_leading_edge(
    capture: xr.Dataset,
    *,
    threshold_sigma: float = 8.0,
    walk: Literal["median", "none"] = "median",
    background: Background = "robust",
) -> xr.Dataset:
    """τ = first crossing of a fixed threshold, less the lag of the response there.

    A brighter echo crosses earlier (walk). Other arguments: threshold_sigma: the threshold above the background, in
    standard deviations of its noise. walk: "median" subtracts the lag at the median height of the echoes of the capture,
    as an instrument that was adjusted on its own targets does, so that echoes of another height keep their walk; "none"
    subtracts the lag at half height. background: as `waveform-average`. sigma is that of the noise, without the walk.
    Returns range, sigma [m] and valid (shot). Invalid: no crossing, a clipped sample (the height, and with it the walk, are
    then unknown), or a missing one at the crossing or in the brightest echo.
    """
    record = read_record(capture)
    tau, sigma, found = _edge(record, threshold_sigma, walk, background, "waveform-leading-edge")
    return range_result(record.range_m(tau), sigma * record.m_per_s, found)


@estimator(
    "waveform", cites="Kusters 1992, Figure 2.2 and Eq. 2.3 (cycles of an oscillator, counted while the pulse travels)"
)
@per_pulse
def waveform_counter(
    capture: xr.Dataset,
    *,
    counter_hz: float | None = None,
    threshold_sigma: float = 8.0,
    walk: Literal["median", "none"] = "median",
    background: Background = "robust",
) -> xr.Dataset:
    """The leading edge stops a counter: n = floor(f t) cycles, D = v t/2 with t = (n + ½)/f (Eq. 2.3).

    The error of counting is uniform over ±v/4f, rms v/(2f√12); noise and walk of the edge come on top.
    Other arguments: counter_hz: f, by default that of the rig. The others: as `waveform-leading-edge`.
    Returns range, sigma [m] and valid (shot). Raises InputError where the frequency of the counter is not given.
    """
    record = read_record(capture)
    hertz = record.counter_hz if counter_hz is None else counter_hz
    if hertz is None or not hertz > 0:
        raise InputError(
            "The rig has no counter.", where="waveform-counter", value=hertz, allowed="counter_hz above 0",
            next_step="waveform-counter[counter_hz=1e9], or set rig.counter_hz of the scene",
        )  # fmt: skip
    tau, sigma, found = _edge(record, threshold_sigma, walk, background, "waveform-counter")
    cycles = count_cycles(tau + record.start_s, hertz)
    distance = pulse_distance_eq23((cycles + 0.5) / hertz, 2.0 * record.m_per_s)
    sigma = np.sqrt(sigma**2 + 1.0 / (12.0 * hertz**2))
    return range_result(distance, sigma * record.m_per_s, found & (cycles >= 0))


def edge_slope(record: WaveformRecord, fraction: Float, length: int) -> Float:
    """Slope of the template at `fraction` (any shape), in heights of the template per second."""
    low, high = 0.95 * fraction, np.minimum(1.05 * fraction, 0.999)
    return np.asarray((high - low) / (rise_lag(record, high, length) - rise_lag(record, low, length)))
