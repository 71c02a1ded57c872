"""A series of dark and flat frames as sums: what EMVA 1288 needs of it, by setting and by block of rows.

The frames are those with the laser off: dark ones, and ones under even light that the rig declares (`ambient_e_per_s`: the setting
of the lamp, on any scale). Frames of equal light and exposure are one setting. Every sum is kept by block of rows, so that leaving
one block out tells how well a figure is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ...scenes.errors import InputError
from ..rig import DeclaredRig, read_rig

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["BLOCKS", "Series", "Setting", "read_series", "settings_of"]

Float = npt.NDArray[np.float64]

#: Blocks of rows that are left out in turn.
BLOCKS = 16


@dataclass(frozen=True)
class Setting:
    """Light on any scale (lamp × open time, s⁻¹·s), and exposure [s], of frames."""

    light: float
    exposure_s: float


@dataclass(frozen=True, eq=False)
class Series:
    """Sums over the pixels of blocks, each (setting, block); settings in ascending light, then exposure.

    Main arguments:
        light, exposure_s: (setting). frames: numbers of frames (setting). pixels: pixels of a block (block).
        mean: Σ ȳ [DN], ȳ the mean of a pixel's frames. square: Σ (ȳ − c)², c = `centre` (setting).
        variance: Σ s² [DN²], s² the unbiased variance of a pixel's frames less their common mean.
        top_dn: the converter's greatest count.
    """

    light: Float
    exposure_s: Float
    frames: Float
    pixels: Float
    mean: Float
    square: Float
    variance: Float
    centre: Float
    top_dn: float

    def without(self, block: int) -> Series:
        """The series without a block."""
        keep = np.arange(self.pixels.size) != block
        parts = (self.pixels[keep], self.mean[:, keep], self.square[:, keep], self.variance[:, keep])
        return Series(self.light, self.exposure_s, self.frames, *parts, self.centre, self.top_dn)

    @property
    def mean_dn(self) -> Float:
        """μ_y: mean over frames and pixels (setting)."""
        return np.asarray(self.mean.sum(axis=1) / self.pixels.sum())

    @property
    def temporal_dn2(self) -> Float:
        """σ_y²: mean over the pixels of the variance over frames (setting)."""
        return np.asarray(self.variance.sum(axis=1) / self.pixels.sum())

    @property
    def spatial_dn2(self) -> Float:
        """s_y²: variance over pixels of the mean of frames, less the share σ_y²/L that the frames' own noise leaves in it."""
        count = self.pixels.sum()
        offset = self.mean.sum(axis=1) - count * self.centre
        measured = (self.square.sum(axis=1) - offset**2 / count) / (count - 1.0)
        return np.asarray(measured - self.temporal_dn2 / self.frames)


def settings_of(capture: xr.Dataset) -> dict[Setting, npt.NDArray[np.int64]]:
    """Indices of the usable frames with the laser off, by setting. Raises InputError where the rig does not tell the light.

    The light is `ambient_e_per_s` times the time that the pixel is open: all pulses' gates where the rig declares gates, else the
    exposure.
    """
    rig = read_rig(capture)
    dim = str(capture["counts"].dims[0])
    used = (
        ~capture["laser_on"].values.astype(bool) if "laser_on" in capture.coords else np.ones(capture.sizes[dim], bool)
    )
    if "valid" in capture.coords:
        used &= capture["valid"].values.astype(bool)
    exposure = rig.number("detector.exposure_s", above=0.0)
    lamp = rig.number("ambient_e_per_s", least=0.0)
    found: dict[Setting, list[int]] = {}
    for index in np.flatnonzero(used):
        found.setdefault(Setting(lamp * _open_s(rig, capture, int(index), exposure), exposure), []).append(int(index))
    return {setting: np.array(frames) for setting, frames in found.items()}


def _open_s(rig: DeclaredRig, capture: xr.Dataset, frame: int, exposure_s: float) -> float:
    if not isinstance(rig.get("gates"), list):
        return exposure_s
    gate = rig.samples(f"gates.{int(capture['gate'].values[frame])}")
    pulses = float(capture["pulses"].values[frame]) if "pulses" in capture.coords else rig.number("pulses_per_slice")
    return float(gate.value.sum() * gate.step_s) * pulses


def read_series(captures: Sequence[xr.Dataset]) -> Series:
    """The sums of all captures, which are read one by one.

    Raises InputError: counts that are averages, have channels or another size than the first capture's, or another converter.
    """
    sums: dict[Setting, _Sums] = {}
    first: tuple[tuple[int, ...], float] | None = None
    for number, capture in enumerate(captures):
        counts = capture["counts"]
        if counts.dtype != np.uint16 or counts.ndim != 3:
            raise InputError(
                "The photon transfer needs single frames of one channel.", where=f"capture {number}: counts",
                value=f"{counts.dtype} {counts.shape}", allowed="uint16 (frame, row, col), not averaged",
            )  # fmt: skip
        bits = read_rig(capture).get("detector.adc_bits")
        top = float(2 ** int(bits) - 1) if bits is not None else float("inf")
        first = first or (counts.shape[1:], top)
        if first != (counts.shape[1:], top):
            raise InputError(
                "The captures are not of one camera.", where=f"capture {number}", value=f"{counts.shape[1:]}, {top:g} DN",
                allowed=f"{first[0]} pixels, a converter up to {first[1]:g} DN as in the first",
            )  # fmt: skip
        values = counts.values
        for setting, frames in settings_of(capture).items():
            sums.setdefault(setting, _Sums()).add(values[frames])
    order = sorted((one for one in sums if sums[one].count > 1), key=lambda one: (one.light, one.exposure_s))
    if not order or first is None:
        raise InputError(
            "The captures hold no two frames with the laser off of one light and exposure.", where="captures",
            next_step="record dark and flat frames with the laser off (docs/calibration.md)",
        )  # fmt: skip
    reduced = [sums[one].reduced() for one in order]
    centre = np.array([one[3] for one in reduced])
    return Series(
        np.array([one.light for one in order]), np.array([one.exposure_s for one in order]),
        np.array([float(sums[one].count) for one in order]), reduced[0][4],
        np.stack([one[0] for one in reduced]), np.stack([one[1] for one in reduced]), np.stack([one[2] for one in reduced]),
        centre, first[1],
    )  # fmt: skip


class _Sums:
    """Running sums of the frames of one setting, per pixel: of the counts, and of their squares less the frames' means."""

    def __init__(self) -> None:
        self.count = 0
        self._sum: Float = np.zeros(())
        self._rest: Float = np.zeros(())
        self._square: Float = np.zeros(())

    def add(self, frames: npt.NDArray[np.uint16]) -> None:
        for frame in frames:
            values = frame.astype(np.float64)
            rest = values - values.mean()
            self._sum = self._sum + values
            self._rest = self._rest + rest
            self._square = self._square + rest**2
            self.count += 1

    def reduced(self) -> tuple[Float, Float, Float, float, Float]:
        """Sums by block of mean, (mean − centre)², variance; the centre; pixels of the blocks."""
        mean = self._sum / self.count
        variance = (self._square - self._rest**2 / self.count) / (self.count - 1)
        centre = float(mean.mean())
        rows = mean.shape[0]
        starts = np.unique((np.arange(min(BLOCKS, rows)) * rows) // min(BLOCKS, rows))

        def by_block(values: Float) -> Float:
            return np.asarray(np.add.reduceat(values.sum(axis=1), starts))

        pixels = by_block(np.ones(mean.shape))
        return by_block(mean), by_block((mean - centre) ** 2), by_block(variance), centre, pixels
