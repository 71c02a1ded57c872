"""The frames of a laser line as numbers: which pixels are data, their photoelectrons, and frames without laser subtracted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...scenes.errors import InputError
from ..rig import Converter, DeclaredRig

__all__ = ["Frames", "OffFrames", "Scale", "read_frames"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: What finders do with the frames that were taken without laser: leave them, or subtract their mean from each lit frame
#: (Kusters 1992, sec. 6.2).
OffFrames = Literal["unused", "subtracted"]


@dataclass(frozen=True)
class Scale:
    """From counts to photoelectrons, and which counts are data.

    `well_dn`, `adc_dn`: the counts at which the full well, less four standard deviations of read noise, and the converter end, at
    the declared gain; infinite where the rig states a limit as unknown.
    """

    offset_dn: float
    dn_per_e: float
    well_dn: float
    adc_dn: float
    floor_e2: float
    excess: float

    @staticmethod
    @lru_cache(maxsize=32)
    def of(rig: DeclaredRig) -> Scale:
        """The scale of a declared rig. Raises InputError where it lacks a value."""
        converter, (gain, excess) = rig.converter("detector"), rig.amplifier("detector.intensifier")
        return Scale(
            converter.offset_dn, converter.gain_dn_per_e * gain, *_ends(rig, converter),
            converter.floor_e2 / gain**2, excess,
        )  # fmt: skip

    def of_gains(self, capture: xr.Dataset) -> Scale:
        """The scale whose rounding is that of the least `gain` of the frames: stated errors are then never too small."""
        least = float(_per_frame(capture, "gain").min()) if capture.sizes["frame"] else 1.0
        return replace(self, floor_e2=float(self.floor_at(least)))

    def floor_at(self, gain: Float | float) -> Float | float:
        """Variance of a pixel without light [photoelectrons²] at a gain of a frame: only the rounding's part changes."""
        return self.floor_e2 + (gain**-2 - 1.0) / (12.0 * self.dn_per_e**2)

    def electrons(self, counts: npt.NDArray[Any]) -> Float:
        """Photoelectrons of counts [DN]."""
        with np.errstate(invalid="ignore"):
            return np.asarray((np.asarray(counts, np.float64) - self.offset_dn) / self.dn_per_e)

    def tops_dn(self, gain: Float) -> Float:
        """The counts (frame) [DN] from which a pixel of frames of these gains is clipped: offset + gain·(well − offset), or the
        converter's top where that is less.

        A full pixel's count is rounded to a whole one, which may lie half a count below: so is a limit by the full well at
        another gain than the declared one, where a count may be more than the noise."""
        well = self.offset_dn + gain * (self.well_dn - self.offset_dn)
        return np.minimum(np.where(gain == 1.0, well, np.floor(well + 0.5)), self.adc_dn)

    def deads_dn(self, gain: Float) -> Float:
        """The counts (frame) [DN] at and below which a pixel of frames of these gains is no datum: 0 where the offset lies 8
        standard deviations of the floor, read noise at that gain and the converter's step, above it; −inf where it does not."""
        sigma_dn = self.dn_per_e * gain * np.sqrt(self.floor_at(gain))
        return np.where(self.offset_dn > 8.0 * sigma_dn, 0.0, -np.inf)


def _ends(rig: DeclaredRig, converter: Converter) -> tuple[float, float]:
    """(`well_dn`, `adc_dn`) of a declared rig, one of which is its converter's `saturation_dn`."""
    well = adc = np.inf
    if not rig.unknown("detector.full_well_e"):
        held = rig.number("detector.full_well_e", above=0) - 4.0 * converter.read_noise_e
        well = converter.offset_dn + converter.gain_dn_per_e * held
    if not rig.unknown("detector.adc_bits"):
        adc = 2.0 ** rig.whole("detector.adc_bits") - 1.0
    return well, adc


def _good(counts: npt.NDArray[Any], top_dn: Float | float, dead_dn: Float | float) -> Bool | None:
    """Whether counts are numbers between the two; None where all are, which two passes show."""
    within = counts.dtype.kind in "ui" and counts.size and float(counts.max()) < np.min(top_dn)
    if within and float(counts.min()) > np.max(dead_dn):
        return None
    values = np.asarray(counts, np.float64)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.isfinite(values) & (values < top_dn) & (values > dead_dn))


@dataclass(frozen=True, eq=False)
class Frames:
    """All rows of a capture, n = frames · rows.

    counts (n, cols) [DN], lit frames less those without laser where these are subtracted (the converter's offset stays).
    Pixels are data between `dead_dn` and `top_dn`, both excluded; where frames are subtracted, those that are no data in one of
    them hold NaN. usable (n): rows of valid frames with the laser on. ambient (rows, cols): photoelectrons that were subtracted,
    None where none were; `averaged`: of how many frames they are the mean. shape: frames, rows, cols.
    """

    counts: npt.NDArray[Any]
    usable: Bool
    ambient: Float | None
    averaged: int
    shape: tuple[int, int, int]
    top_dn: float
    dead_dn: float

    @property
    def good(self) -> Bool | None:
        """Whether pixels (n, cols) are data; None where all are."""
        return _good(self.counts, self.top_dn, self.dead_dn)

    def ambient_variance_e(self, peak: npt.NDArray[np.int64], half: int, scale: Scale) -> Float | float:
        """Photoelectrons (m) whose shot noise is what the subtracted light adds to windows of `half` pixels to either side of
        columns `peak` (n, k), m = n·k: ambient light b in the lit frame, and F² b + floor of each of K others,

            b + (b + floor/F²)/K."""
        if self.ambient is None:
            return 0.0
        rows = np.tile(self.ambient, (self.shape[0], 1))
        each = peak.shape[1]
        inside = np.clip(peak[:, :, None] + np.arange(-half, half + 1), 0, self.shape[2] - 1)
        mean = np.take_along_axis(rows, inside.reshape(len(rows), -1), axis=1).reshape(len(rows), each, -1).mean(axis=2)
        b = np.maximum(mean.ravel(), 0.0)
        return np.asarray(b + (b + scale.floor_e2 / scale.excess) / self.averaged)


def read_frames(capture: xr.Dataset, scale: Scale, off_frames: OffFrames) -> Frames:
    """The frames of a capture, all on the scale of the declared gain where the coordinate `gain` says what theirs was.

    Raises InputError for several channels, for a gain or exposure that is not positive, and where frames without laser are to be
    subtracted and the capture holds none that is valid."""
    counts = np.asarray(capture.variables["counts"].values)
    if counts.ndim != 3:
        raise InputError(
            "Line finders read frames of one channel.", where="counts", value=capture["counts"].dims,
            allowed="frame, row, col", next_step="select a channel, or average over them",
        )  # fmt: skip
    shape = (counts.shape[0], counts.shape[1], counts.shape[2])
    valid, on = (np.asarray(capture.variables[name].values, bool) for name in ("valid", "laser_on"))
    usable = np.repeat(valid & on, shape[1])
    flat = np.ascontiguousarray(counts).reshape(-1, shape[2])
    gain, exposure = (_per_frame(capture, name) for name in ("gain", "exposure"))
    tops, deads = scale.tops_dn(gain)[:, None, None], scale.deads_dn(gain)[:, None, None]
    top, dead, scaled = float(tops.min(initial=np.inf)), float(deads.max(initial=-np.inf)), counts
    if (gain != 1.0).any():
        good = _good(counts, tops, deads)
        scaled = scale.offset_dn + (counts - scale.offset_dn) / gain[:, None, None]
        scaled[np.zeros(counts.shape, bool) if good is None else ~good] = np.nan
        flat, top, dead = scaled.reshape(-1, shape[2]), np.inf, -np.inf
    if off_frames == "unused":
        return Frames(flat, usable, None, 0, shape, top, dead)
    off = np.flatnonzero(valid & ~on)
    if not off.size:
        raise InputError(
            "No frame without laser can be subtracted: the capture holds none that is valid.", where="laser_on",
            value=f"{int(on.sum())} of {on.size} frames with laser", allowed="one valid frame or more without",
            next_step="record frames with the laser off (rig.frames.laser_off), or leave off_frames out",
        )  # fmt: skip
    good, dark_good = _good(counts, tops, deads), _good(counts[off], tops[off], deads[off])
    # Light of the exposure of each lit frame; the mean of frames of other exposures is that of their rates.
    rate = (scale.electrons(scaled[off]) / exposure[off, None, None]).mean(axis=0)
    lit = np.asarray(scaled, np.float64) - rate * exposure[:, None, None] * scale.dn_per_e
    if good is not None:
        lit[~good] = np.nan
    if dark_good is not None:
        lit[:, ~dark_good.all(axis=0)] = np.nan
    ambient = rate * float(exposure[valid & on].mean() if (valid & on).any() else 1.0)
    ambient = np.where(np.isfinite(ambient), ambient, 0.0)
    return Frames(lit.reshape(-1, shape[2]), usable, ambient, int(off.size), shape, np.inf, -np.inf)


def _per_frame(capture: xr.Dataset, name: str) -> Float:
    """A setting of every frame, 1 where the capture does not say."""
    frames = capture.sizes["frame"]
    if name not in capture.coords:
        return np.ones(frames)
    setting = np.asarray(capture[name].values, np.float64)
    if not (np.isfinite(setting) & (setting > 0)).all():
        raise InputError(
            f"The {name} of a frame is not positive.", where=name, value=setting.tolist(), allowed="above 0"
        )
    return setting
