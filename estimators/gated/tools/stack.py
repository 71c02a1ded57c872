"""A capture as the gated estimators read it: signal slices sorted by delay, equal ones summed, background slices last.

Repeated slices of one delay and gate are summed, which loses nothing: a sum of Poisson counts is sufficient for their
common mean. Laser-off slices form one group at the end, with no response.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ....optics.jit import kernel
from ....scenes.errors import InputError
from .instrument import READ_NOISE, Dark, Instrument, instrument_of

__all__ = ["Stack", "load_row", "read_stack"]

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]
#: The plans of the last few instruments and sets of delays: making one takes as long as a small estimate.
_plans: OrderedDict[tuple[Any, ...], Stack] = OrderedDict()


@dataclass(frozen=True)
class Stack:
    """Counts, and the plan for reading them.

    counts (slice, row, col) are those of the capture, copied only where a sample is dead: it is NaN here. `slices` are the
    slices that are used, `group` the group of each. Per group:
    delay_s, gate, count (slices summed) and exposure (Σ pulses / nominal pulses); the first `signal` groups hold signal,
    sorted by delay. `frames` is the number of frames averaged into one float32 value (1 for uint16). `key` identifies the
    plan, which is everything but the counts.
    """

    counts: npt.NDArray[Any]
    instrument: Instrument
    slices: Int
    group: Int
    delay_s: Float
    gate: Int
    count: Float
    exposure: Float
    signal: int
    frames: float
    key: tuple[Any, ...]

    @property
    def groups(self) -> int:
        """Number of groups, that of the background included."""
        return int(self.delay_s.size)

    @property
    def reads(self) -> Float:
        """Slices per nominal exposure of every group. A value y of nominal exposure, made of the slices of a group, has the
        variance (F²·y + reads·σ_r²)/exposure, since light grows with the pulses and read noise with the slices."""
        return np.asarray(self.count / self.exposure)

    @property
    def centroid_delay_s(self) -> Float:
        """Echo time on which the response of each signal group is centred: delay plus the centroid of R."""
        shift = np.array([r.centroid_s for r in self.instrument.responses])
        return np.asarray(self.delay_s[: self.signal] + shift[self.gate[: self.signal]])

    def widths(self) -> Float:
        """Part of the span of delays that every signal group stands for (signal), relative to their mean: half the distance of
        its neighbours, at an end the distance of the only one. 1 for even delays, and for slices of several gates."""
        delay, gate = self.delay_s[: self.signal], self.gate[: self.signal]
        gaps = np.diff(delay)
        if gaps.size < 2 or (gate != gate[0]).any() or np.ptp(gaps) <= 1e-6 * gaps.mean():
            return np.ones(self.signal)
        wide = 0.5 * (np.concatenate([gaps[:1], gaps]) + np.concatenate([gaps, gaps[-1:]]))
        return np.asarray(wide / wide.mean())

    def spacing_s(self) -> float:
        """Median spacing of the delays; the standard deviation of R where there is only one delay."""
        gaps = np.diff(np.unique(self.delay_s[: self.signal]))
        if gaps.size:
            return float(np.median(gaps))
        return float(np.sqrt(self.instrument.responses[0].variance_s2))


def read_stack(capture: xr.Dataset) -> Stack:
    """Plan the reading of a gated capture. Raises InputError where a coordinate is missing or has the wrong size."""
    variables = capture.variables
    if "counts" not in variables or variables["counts"].dims != ("slice", "row", "col"):
        found = variables["counts"].dims if "counts" in variables else None
        raise InputError(
            "The capture has no stack of slices.", where="counts", value=found, allowed="dims (slice, row, col)"
        )
    counts = _marked(variables)
    total = counts.shape[0]
    instrument = instrument_of(capture)
    if counts.shape[1:] != (instrument.rows, instrument.cols):
        raise InputError(
            "The size of the stack differs from that of the declared camera.",
            where="counts",
            value=counts.shape[1:],
            allowed=f"({instrument.rows}, {instrument.cols})",
        )

    def per_slice(name: str, default: Any) -> npt.NDArray[Any]:
        if name not in variables:
            if default is None:
                raise InputError(f"The capture has no coordinate {name}.", where=name, allowed=f"({total},)")
            return np.full(total, default)
        values = np.asarray(variables[name].values)
        if values.shape != (total,):
            raise InputError(
                f"The coordinate {name} does not have one value per slice.", where=name, value=values.shape,
                allowed=f"({total},)",
            )  # fmt: skip
        return values

    delay = per_slice("delay", None).astype(np.float64)
    gate = per_slice("gate", 0).astype(np.int64)
    pulses = per_slice("pulses", -1).astype(np.float64)
    if instrument.rig.unknown("pulses_per_slice"):
        nominal = max(float(pulses.max(initial=0.0)), 1.0)
    else:
        nominal = instrument.pulses_per_slice
    pulses = np.where(pulses < 0, nominal, pulses) / nominal
    laser = per_slice("laser_on", True).astype(bool)
    valid = per_slice("valid", True).astype(bool)
    frames = float(capture.attrs.get("averaged", 1) or 1)
    if instrument.rig.unknown(READ_NOISE):
        instrument = instrument_of(capture, _dark(counts[valid & ~laser], frames))
    key = (instrument.key, frames, *(part.tobytes() for part in (delay, gate, pulses, laser, valid)))
    if key not in _plans:
        _plans[key] = _plan(instrument, delay, gate, pulses, laser, valid, frames, key)
        while len(_plans) > 8:
            _plans.popitem(last=False)
    return replace(_plans[key], counts=_without_dead(counts, instrument.dead_dn))


def _dark(counts: npt.NDArray[Any], frames: float) -> Dark | None:
    """Mean and variance of one frame of slices (slice, row, col) without laser light, over the pixels that are finite in all of
    them; the variance is that over slices, which a fixed pattern does not raise. None for fewer than two slices."""
    if len(counts) < 2:
        return None
    held = counts.astype(np.float64)
    sound = np.isfinite(held).all(axis=0)
    if not sound.any():
        return None
    return Dark(float(held[:, sound].mean()), frames * float(held[:, sound].var(axis=0, ddof=1).mean()))


def _marked(variables: Any) -> npt.NDArray[Any]:
    """The counts, with NaN (float32) for samples that the capture marks as unsound, where there are any."""
    counts: npt.NDArray[Any] = variables["counts"].values
    if "valid_sample" not in variables or (sound := np.asarray(variables["valid_sample"].values, bool)).all():
        return counts
    if sound.shape != counts.shape:
        raise InputError(
            "The marks of the samples do not fit the counts.", where="valid_sample", value=sound.shape,
            allowed=str(counts.shape),
        )  # fmt: skip
    return np.where(sound, counts.astype(np.float32), np.float32(np.nan))


def _without_dead(counts: npt.NDArray[Any], dead_dn: float) -> npt.NDArray[Any]:
    """The counts; with NaN (float32) for samples at and below `dead_dn`, where there are any."""
    if not np.isfinite(dead_dn) or not (found := counts <= dead_dn).any():
        return counts
    return np.where(found, np.float32(np.nan), counts.astype(np.float32))


def _plan(
    instrument: Instrument, delay: Float, gate: Int, pulses: Float, laser: npt.NDArray[np.bool_],
    valid: npt.NDArray[np.bool_], frames: float, key: tuple[Any, ...],
) -> Stack:  # fmt: skip
    """All of a Stack but its counts."""
    if (gate[valid & laser] < 0).any() or (gate[valid & laser] >= len(instrument.responses)).any():
        raise InputError(
            "A slice names a gate that the rig does not declare.", where="gate", value=np.unique(gate).tolist(),
            allowed=f"0 to {len(instrument.responses) - 1}",
        )  # fmt: skip
    on = np.flatnonzero(valid & laser & np.isfinite(delay))
    off = np.flatnonzero(valid & ~laser)
    keys, index = np.unique(np.stack([delay[on], gate[on].astype(np.float64)], axis=1), axis=0, return_inverse=True)
    signal = keys.shape[0]
    slices = np.concatenate([on, off])
    group = np.concatenate([index.reshape(-1), np.full(off.size, signal)]).astype(np.int64)
    groups = signal + (1 if off.size else 0)
    return Stack(
        counts=np.zeros((0, instrument.rows, instrument.cols), dtype=np.uint16),
        instrument=instrument,
        slices=slices.astype(np.int64),
        group=group,
        delay_s=np.concatenate([keys[:, 0], np.full(groups - signal, np.nan)]),
        gate=np.concatenate([keys[:, 1], np.zeros(groups - signal)]).astype(np.int64),
        count=frames * np.bincount(group, minlength=groups).astype(np.float64),
        exposure=np.asarray(frames * np.bincount(group, weights=pulses[slices], minlength=groups), dtype=np.float64),
        signal=signal,
        frames=frames,
        key=key,
    )


@kernel
def load_row(counts, slices, group, row, first, offset, scale, saturation, out, bad):  # type: ignore[no-untyped-def]
    """out[col, group] = Σ (counts − offset)·scale over the slices of a group, for the columns from `first` on; bad[col]
    counts the samples that are clipped, NaN or infinite (they stay in the sum: the caller treats such pixels apart)."""
    out[:] = 0.0
    bad[:] = 0
    columns = out.shape[0]
    for i in range(slices.size):
        k, g = slices[i], group[i]
        for c in range(columns):
            v = float(counts[k, row, first + c])
            if not -np.inf < v < saturation:
                bad[c] += 1
            out[c, g] += (v - offset) * scale
