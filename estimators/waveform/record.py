"""Reading a waveform capture: samples in photoelectrons, their noise, and the template that an echo leaves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.constants import C_M_PER_S
from ...optics.pile_up import dead_bins, live_pulses
from ...scenes.errors import InputError
from ..declared import check_keys
from ..response import Response, correlate_samples
from ..rig import DeclaredRig, Samples, read_rig
from .analog import read_analog
from .declared import WAVEFORM_KEYS
from .light_noise import light_noise
from .per_pulse import outgoing

__all__ = ["WaveformRecord", "read_record"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: An echo's samples are those whose share is above this part of the largest.
_ECHO = 1e-3


@dataclass(frozen=True)
class WaveformRecord:
    """Samples of all shots, and what the rig declares of them.

    z (shot, sample): photoelectrons, offset subtracted. good (shot, sample): finite, not clipped, not dead. clipped (shot):
    whether any sample of it is at the top of the converter. usable (shot): marked valid, with the laser on. dark (shot):
    marked valid, with the laser off. time_s (sample): middle of the interval of each sample, evenly spaced by step_s.
    share: R(u), the part of an echo at τ that falls into sample k at u = τ − t_k + step/2. excess, floor_var: the variance
    of a sample of mean μ is excess·μ + floor_var (where the gain is unknown, z is in standard deviations of the
    baseline, and excess measured). dead, pulses (shot) and live (shot, sample) belong to single-photon
    counting: bins of dead time, pulses of a shot, and pulses that no earlier count has blinded (None for analog records). start_s
    (shot): start of the record after the emitted pulse's centroid, which is added to time_s.
    """

    z: Float
    good: Bool
    clipped: Bool
    usable: Bool
    dark: Bool
    time_s: Float
    step_s: float
    share: Response
    m_per_s: float
    excess: float
    floor_var: float
    counter_hz: float | None
    single_photon: bool
    dead: int
    pulses: Float
    live: Float | None
    start_s: Float

    def range_m(self, tau_s: Float) -> Float:
        """Range [m] of echoes at tau_s (shot, …) on the clock of `time_s`, to which the start of each record is added."""
        start = self.start_s.reshape(-1, *([1] * (np.ndim(tau_s) - 1)))
        return np.asarray((tau_s + start) * self.m_per_s)

    @property
    def width_s(self) -> float:
        """Standard deviation of the share, s."""
        return float(np.sqrt(self.share.variance_s2))

    @property
    def centroid_s(self) -> float:
        """Mean time by which the samples of an echo lag the echo, s: Σ t_k R/Σ R − τ = step/2 − ū."""
        return 0.5 * self.step_s - self.share.centroid_s

    @property
    def window_s(self) -> tuple[float, float]:
        """First and last time [s] of echoes whose template has its middle within the record."""
        lag = 0.5 * self.step_s - self.share.peak_s
        return float(self.time_s[0]) - lag, float(self.time_s[-1]) - lag

    def template(self, tau_s: Float) -> tuple[Float, Float]:
        """(R, dR/dτ [1/s]) of echoes at the times tau_s (…), each (…, sample)."""
        u = np.asarray(tau_s)[..., None] - self.time_s + 0.5 * self.step_s
        r, slope, _ = self.share(u)
        return r, slope

    def variance(self, mean: Float) -> Float:
        """Variance of a sample of mean photoelectrons `mean`."""
        return self.excess * np.maximum(mean, 0.0) + self.floor_var

    @property
    def least_mean(self) -> float:
        """Least mean of the background in a fit: without read noise no mean is below zero; with it the mean of the shifted
        Poisson distribution stays positive; there is none for a normal distribution of the baseline."""
        if self.floor_var == 0:
            return 1e-9
        return -0.5 * self.floor_var / self.excess if self.excess > 0 else -np.inf

    @property
    def reach(self) -> tuple[int, int]:
        """By how many samples an echo may reach before and after its brightest sample, above `_ECHO` of its top."""
        held = self.share.value >= _ECHO * self.share.peak
        u = self.share.start_s + self.share.step_s * np.flatnonzero(held)
        # One more step on both sides: the top of the echo may lie anywhere in the brightest sample. The next 1e-9 of a
        # step is rounding.
        early, late = u[-1] - self.share.peak_s + self.step_s, self.share.peak_s - u[0] + self.step_s
        return int(late / self.step_s + 1e-9), int(early / self.step_s + 1e-9)

    def brightest(self) -> npt.NDArray[np.intp]:
        """Index of the brightest sample of each shot (shot); clipped samples count, missing and dead ones do not."""
        return np.asarray(np.argmax(np.where(self.good | (self.z > 0), self.z, -np.inf), axis=1), np.intp)

    def near(self, at: npt.NDArray[np.intp]) -> Bool:
        """Samples that an echo may reach whose brightest sample is `at` (shot): (shot, sample)."""
        gap = np.arange(self.time_s.size) - np.asarray(at)[:, None]
        before, after = self.reach
        return (gap >= -before) & (gap <= after)

    def intact(self, at: npt.NDArray[np.intp]) -> Bool:
        """Whether all samples of an echo whose brightest one is `at` are good (shot)."""
        return np.asarray((self.good | ~self.near(at)).all(axis=1))


@lru_cache(maxsize=8)
def _share(rig: DeclaredRig, step_s: float) -> Response:
    return _sampled(rig.samples("response"), step_s)


def _sampled(response: Samples, step_s: float) -> Response:
    # A sample collects charge over its interval as a gate of that width does.
    return correlate_samples(response, Samples(0.0, step_s / 16, np.ones(17)))


def read_record(capture: xr.Dataset) -> WaveformRecord:
    """Read a waveform capture. Raises InputError where the rig or the times of the samples cannot be used."""
    rig = read_rig(capture, "waveform")
    check_keys(rig, WAVEFORM_KEYS)
    if "signal" not in capture or capture["signal"].dims != ("shot", "sample"):
        raise InputError(
            "The capture has no waveform.",
            where="signal",
            value=tuple(capture.variables),
            allowed="dims (shot, sample)",
        )
    raw = _marked(capture)
    shots, samples = raw.shape
    time, step = _times(capture, rig)
    single = rig.word("detector.readout.kind", "analog", "single-photon") == "single-photon"
    pulses = _pulses(capture, rig, shots, single)
    valid, lit = (_per_shot(capture, name, shots, True).astype(bool) for name in ("valid", "laser_on"))
    if single:
        good = np.isfinite(raw) & (raw >= 0)
        z = np.where(good, raw, 0).astype(np.float64)
        dead = dead_bins(rig.number("detector.readout.dead_time_s", least=0), step, samples)
        live = live_pulses(z, pulses, dead)
        good &= live > 0
        clipped, excess, floor = np.zeros(shots, dtype=bool), 1.0, 0.0
    else:
        z, good, clipped, excess, floor = read_analog(rig, raw, valid)
        dead, live = 0, None
    start = _per_shot(capture, "start", shots, 0.0).astype(np.float64)
    share = _share(rig, round(step, 18))
    if "pulse" in capture.variables:
        response, centroid = outgoing(capture, rig)
        share, start = _sampled(response, step), start - centroid
    record = WaveformRecord(
        z, good, clipped, valid & lit, valid & ~lit, time, step, share,
        C_M_PER_S / (2.0 * rig.number("medium.group_index", above=0)), excess, floor,
        None if rig.get("counter_hz") is None else rig.number("counter_hz"), single, dead, pulses, live,
        start,
    )  # fmt: skip
    return record if record.excess > 0 else _with_light_noise(record)


def _with_light_noise(record: WaveformRecord) -> WaveformRecord:
    """The record of a rig of unknown gain, with the noise of the light as its echoes show it."""
    top = record.brightest()
    use = record.good & record.near(top) & (record.usable & record.intact(top))[:, None]
    begin = record.time_s[top] - 0.5 * record.step_s + record.share.peak_s
    found = light_noise(record.z, use, record.floor_var, begin, record.step_s, lambda tau_s: record.template(tau_s)[0])
    return replace(record, excess=found)


def _times(capture: xr.Dataset, rig: DeclaredRig) -> tuple[Float, float]:
    """Times of the samples [s] (sample), and their even spacing [s]."""
    if "time" not in capture.variables:
        raise InputError("The capture has no times of its samples.", where="coordinate time", allowed="(sample,) in s")
    time = np.asarray(capture["time"].values, np.float64)
    gaps = np.diff(time)
    step = float(gaps.mean()) if gaps.size else rig.number("record.step_s", above=0)
    if not step > 0 or (np.abs(gaps - step) > 1e-6 * step).any():
        raise InputError(
            "The samples are not evenly spaced in time.",
            where="coordinate time",
            value=step,
            allowed="even, rising steps",
        )
    return time, step


def _pulses(capture: xr.Dataset, rig: DeclaredRig, shots: int, single: bool) -> Float:
    """Pulses of every shot (shot); NaN where they are unknown, and the detector is one whose records do not depend on them."""
    if not single and rig.unknown("pulses_per_shot"):
        return np.asarray(_per_shot(capture, "pulses", shots, np.nan), np.float64)
    given = "pulses" in capture.variables and rig.unknown("pulses_per_shot")
    nominal = np.nan if given else rig.number("pulses_per_shot", above=0)
    return np.asarray(_per_shot(capture, "pulses", shots, nominal), np.float64)


def _marked(capture: xr.Dataset) -> npt.NDArray[Any]:
    """The signal (shot, sample), with NaN for samples that the capture marks as unsound, where there are any."""
    raw: npt.NDArray[Any] = capture["signal"].values
    if "valid_sample" not in capture.variables or (sound := np.asarray(capture["valid_sample"].values, bool)).all():
        return raw
    if sound.shape != raw.shape:
        raise InputError(
            "The marks of the samples do not fit the signal.",
            where="valid_sample",
            value=sound.shape,
            allowed=str(raw.shape),
        )
    return np.where(sound, raw, np.nan)


def _per_shot(capture: xr.Dataset, name: str, shots: int, default: Any) -> npt.NDArray[Any]:
    if name not in capture.variables:
        return np.full(shots, default)
    values = np.asarray(capture[name].values)
    if values.shape != (shots,):
        raise InputError(
            f"The coordinate {name} does not have one value per shot.", where=name, value=values.shape,
            allowed=f"({shots},)",
        )  # fmt: skip
    return values
