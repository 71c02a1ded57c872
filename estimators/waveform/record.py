"""Reading a waveform capture: samples in photoelectrons, their noise, and the template that an echo leaves."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.constants import C_M_PER_S
from ...optics.pile_up import dead_bins, live_pulses
from ...scenes.errors import InputError
from ..response import Response, correlate_samples

__all__ = ["WaveformRecord", "read_record"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: An echo's samples are those whose share is above this part of the largest.
_ECHO = 1e-3


@dataclass(frozen=True)
class WaveformRecord:
    """Samples of all shots and what is known of them.

    z (shot, sample): photoelectrons, offset taken off. good (shot, sample): finite and not clipped. usable (shot):
    recorded soundly, with the laser on. time_s (sample): middle of each sample's interval, evenly spaced by step_s.
    share: R(u), the part of an echo at τ that falls into sample k at u = τ − t_k + step/2. excess, floor_var: variance
    of a sample of mean μ is excess·μ + floor_var. live (shot, sample), pulses (shot): of single-photon counting.
    """

    z: Float
    good: Bool
    usable: Bool
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

    @property
    def width_s(self) -> float:
        """Standard deviation of the share, s."""
        return float(np.sqrt(self.share.variance_s2))

    @property
    def centroid_s(self) -> float:
        """Mean time by which an echo's samples lag the echo, s: Σ t_k R/Σ R − τ = step/2 − ū."""
        return 0.5 * self.step_s - self.share.centroid_s

    @property
    def window_s(self) -> tuple[float, float]:
        """Echo times whose template's middle lies within the record."""
        lag = 0.5 * self.step_s - self.share.peak_s
        return float(self.time_s[0]) - lag, float(self.time_s[-1]) - lag

    def template(self, tau_s: Float) -> tuple[Float, Float]:
        """(R, dR/dτ [1/s]) of echoes at tau_s (…), each (…, sample)."""
        u = np.asarray(tau_s)[..., None] - self.time_s + 0.5 * self.step_s
        r, slope, _ = self.share(u)
        return r, slope

    def variance(self, mean: Float) -> Float:
        """Variance of a sample of mean photoelectrons `mean`."""
        return self.excess * np.maximum(mean, 0.0) + self.floor_var

    def outside(self) -> tuple[Float, Float]:
        """(mean of the samples that the echo at the brightest sample cannot reach (shot), their number (shot)).

        Where fewer than four are left the least quarter of the samples stands in for them.
        """
        seen = np.where(self.good, self.z, -np.inf)
        peak = self.time_s[np.argmax(seen, axis=1)]
        held = self.share.value >= _ECHO * self.share.peak
        u = self.share.start_s + self.share.step_s * np.flatnonzero(held)
        # One more step on both sides: the echo's peak may lie anywhere in the brightest sample.
        before, after = u[-1] - self.share.peak_s + self.step_s, self.share.peak_s - u[0] + self.step_s
        gap = self.time_s - peak[:, None]
        out = self.good & ((gap < -after) | (gap > before))
        number = out.sum(axis=1)
        few = number < 4
        if few.any():
            order = np.argsort(np.where(self.good[few], self.z[few], np.inf), axis=1)
            least = np.zeros_like(out[few])
            np.put_along_axis(least, order[:, : max(self.time_s.size // 4, 1)], True, axis=1)
            out[few] = least & self.good[few]
            number = out.sum(axis=1)
        level = np.where(out, self.z, 0.0).sum(axis=1) / np.maximum(number, 1)
        return level, number.astype(np.float64)


def _need(rig: dict[str, Any], path: str) -> Any:
    node: Any = rig
    for part in path.split("."):
        if not isinstance(node, dict) or part not in node:
            raise InputError("the declared rig lacks a value", where=f"attribute rig: {path}", allowed="schema 1")
        node = node[part]
    return node


@lru_cache(maxsize=8)
def _share(text: str, step_s: float) -> Response:
    # A sample collects over its interval as a gate of that width does.
    gate = {"start_s": 0.0, "step_s": step_s / 16, "value": [1.0] * 17}
    return correlate_samples(json.loads(text), gate)


def read_record(capture: xr.Dataset) -> WaveformRecord:
    """Read a waveform capture. Raises InputError where the rig or the samples' times cannot be used."""
    text = capture.attrs.get("rig")
    try:
        rig = json.loads(text) if isinstance(text, str) else None
    except json.JSONDecodeError as error:
        raise InputError("the declared rig is not JSON", where="attribute rig", value=str(text)[:80]) from error
    if not isinstance(rig, dict) or rig.get("schema") != 1 or rig.get("kind") != "waveform":
        raise InputError(
            "not the declared rig of a waveform capture", where="attribute rig", allowed="schema 1, waveform"
        )
    if "signal" not in capture or capture["signal"].dims != ("shot", "sample"):
        raise InputError("no waveform", where="signal", allowed="dims (shot, sample)")
    raw = capture["signal"].values
    shots, samples = raw.shape
    time = np.asarray(capture["time"].values, np.float64)
    gaps = np.diff(time)
    step = float(gaps.mean()) if gaps.size else float(_need(rig, "record.step_s"))
    if not step > 0 or (np.abs(gaps - step) > 1e-6 * step).any():
        raise InputError("samples are not evenly spaced in time", where="coordinate time", value=step)
    readout = _need(rig, "detector.readout")
    single = readout.get("kind") == "single-photon"
    pulses = _per_shot(capture, "pulses", shots, float(_need(rig, "pulses_per_shot"))).astype(np.float64)
    usable = _per_shot(capture, "valid", shots, True).astype(bool) & _per_shot(capture, "laser_on", shots, True)
    share = _share(json.dumps(_need(rig, "response"), sort_keys=True), round(step, 18))
    m_per_s = C_M_PER_S / (2.0 * float(_need(rig, "medium.group_index")))
    counter = rig.get("counter_hz")
    good = np.isfinite(raw)
    if single:
        z = np.where(good, raw, 0).astype(np.float64)
        dead = dead_bins(float(readout["dead_time_s"]), step, samples)
        live = live_pulses(z, pulses, dead)
        good &= live > 0
        noise = (1.0, 0.0)
    else:
        tube = readout.get("avalanche")
        gain, boost = float(readout["gain_dn_per_e"]), float(tube["gain"]) if tube else 1.0
        offset, read = float(readout["offset_dn"]), float(readout["read_noise_e"])
        full = offset + gain * (float(readout["full_well_e"]) - 4 * read)
        good &= raw < min(2.0 ** int(readout["adc_bits"]) - 1, full)
        z = (np.where(np.isfinite(raw), raw, offset).astype(np.float64) - offset) / (gain * boost)
        noise = (float(tube["excess_noise_factor"]) if tube else 1.0, (read**2 + 1 / (12 * gain**2)) / boost**2)
        dead, live = 0, None
    return WaveformRecord(
        z, good, usable, time, step, share, m_per_s, *noise, None if counter is None else float(counter), single, dead,
        pulses, live,
    )  # fmt: skip


def _per_shot(capture: xr.Dataset, name: str, shots: int, default: Any) -> npt.NDArray[Any]:
    if name not in capture.variables:
        return np.full(shots, default)
    values = np.asarray(capture[name].values)
    if values.shape != (shots,):
        raise InputError(f"coordinate {name} is not per shot", where=name, value=values.shape, allowed=f"({shots},)")
    return values
