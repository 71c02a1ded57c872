"""Reading the frames of a laser line: in every row the brightest pixels, and a window of photoelectrons around each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.special import ndtr

from ...optics.sheet import gaussian_mean
from ...scenes.errors import InputError
from ..declared import check_keys
from ..result import stage_result
from ..rig import DeclaredRig, read_rig
from .declared import LASER_LINE_KEYS
from .geometry import declared_geometry
from .row_scan import scan_rows

__all__ = ["Formula", "Windows", "answered", "line_windows", "with_locking"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Windows (n, 2h + 1) above their background -> positions of the line from the middle pixel [px] (n), NaN where there is none.
Formula = Callable[[Float], Float]

#: Least and most half width of a window [px].
_LEAST, _MOST = 3, 64
#: Phases of the pixel over which a formula's error without noise is averaged.
_PHASES = 64


@dataclass(frozen=True, eq=False)
class Windows:
    """The windows of all frames, n = frames · rows · returns; `shape` is these three.

    z (n, 2h + 1): photoelectrons around the brightest pixel, above the row's background. peak (n): that pixel's column.
    level, row_level (n): the background, photoelectrons; 0 and NaN in rows without. floor_e2: variance of a pixel without light;
    excess: F², the variance of light over its mean.
    sound (n): rows of usable frames whose window lies within the image and holds no bad pixel, and whose peak is above
    `least_sigmas` of the noise.
    """

    z: Float
    peak: npt.NDArray[np.int64]
    level: Float
    row_level: Float
    floor_e2: float
    excess: float
    sound: Bool
    shape: tuple[int, int, int]
    rig: DeclaredRig

    @property
    def half(self) -> int:
        """Pixels to either side of the brightest one."""
        return int(self.z.shape[1]) // 2

    @property
    def variance(self) -> Float:
        """Variance of the pixels (n, 2h + 1), from their own counts."""
        return np.asarray(self.excess * np.maximum(self.z + self.level[:, None], 0.0) + self.floor_e2)

    def electrons(self, capture: xr.Dataset) -> tuple[Float, Bool]:
        """(photoelectrons, whether a pixel is sound), each (frame, row, col), of the capture that the windows are of."""
        scale, counts = _Scale.of(self.rig), np.asarray(capture["counts"].values)
        good = scale.good(counts)
        return scale.electrons(counts), np.ones(counts.shape, bool) if good is None else good

    def width(self) -> Float:
        """σ [px] (n) that the declared rig gives a line at these columns."""
        return np.asarray(_declared_width(self.rig)[np.clip(self.peak, 0, None)])


def line_windows(
    capture: xr.Dataset, *, least_half: int = _LEAST, least_sigmas: float = 5.0, returns: int = 1
) -> Windows:
    """The windows of a capture.

    Other arguments:
        least_half: least number of pixels to either side, which are four standard deviations of the declared line and two.
        least_sigmas: height of the peak over its row's background, in standard deviations of a pixel without light.

        returns: windows per row, the brightest first; each later one lies outside of those before it.

    The background of a row is the median of its sound pixels. Raises InputError for a rig that lacks a value, and for frames
    of several channels.
    """
    rig = read_rig(capture, "laser_line")
    check_keys(rig, LASER_LINE_KEYS)
    scale = _Scale.of(rig)
    counts = np.asarray(capture["counts"].values)
    if counts.ndim != 3:
        raise InputError(
            "Line finders read frames of one channel.", where="counts", value=capture["counts"].dims,
            allowed="frame, row, col", next_step="select a channel, or average over them",
        )  # fmt: skip
    frames, rows, cols = counts.shape
    usable = np.asarray(capture["valid"].values, bool) & np.asarray(capture["laser_on"].values, bool)
    half = max(_half_window(rig), least_half)
    peak, window, median, sound = scan_rows(
        np.ascontiguousarray(counts).reshape(-1, cols), half, max(returns, 1), scale.top_dn, scale.dead_dn
    )
    shape = (frames, rows, peak.shape[1])
    level = np.repeat(scale.electrons(median), shape[2])
    z = scale.electrons(window).reshape(level.size, -1) - level[:, None]
    fine = sound.ravel() & np.repeat(usable, rows * shape[2]) & np.isfinite(level)
    with np.errstate(invalid="ignore"):
        fine &= z[:, half] > least_sigmas * np.sqrt(scale.floor_e2 + scale.excess * np.maximum(level, 0.0))
    z[~fine] = 0.0
    return Windows(z, peak.ravel(), np.where(fine, level, 0.0), level, scale.floor_e2, scale.excess, fine, shape, rig)


@dataclass(frozen=True)
class _Scale:
    """From counts to photoelectrons, and which counts are data."""

    offset_dn: float
    dn_per_e: float
    top_dn: float
    dead_dn: float
    floor_e2: float
    excess: float

    @staticmethod
    def of(rig: DeclaredRig) -> _Scale:
        converter, (gain, excess) = rig.converter("detector"), rig.amplifier("detector.intensifier")
        return _Scale(
            converter.offset_dn, converter.gain_dn_per_e * gain, converter.saturation_dn, converter.dead_dn,
            converter.floor_e2 / gain**2, excess,
        )  # fmt: skip

    def electrons(self, counts: npt.NDArray[Any]) -> Float:
        with np.errstate(invalid="ignore"):
            return np.asarray((np.asarray(counts, np.float64) - self.offset_dn) / self.dn_per_e)

    def good(self, counts: npt.NDArray[Any]) -> Bool | None:
        """Whether pixels are finite, neither clipped nor dead; None where all are, which two passes show."""
        if counts.dtype.kind in "ui" and counts.size:
            values = np.asarray(counts)
            if float(values.max()) < self.top_dn and float(values.min()) > self.dead_dn:
                return None
        values = np.asarray(counts, np.float64)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.isfinite(values) & (values < self.top_dn) & (values > self.dead_dn))


def answered(windows: Windows, position: Float, sigma: Float, good: Bool | None = None) -> xr.Dataset:
    """The result of the stage `line`: position [px] from the peak (n) and its standard error [px] (n).

    Invalid where the window is not sound, or where the answer left it.
    """
    with np.errstate(invalid="ignore"):
        valid = windows.sound & (np.abs(position) <= windows.half)
    if good is not None:
        valid = valid & good
    shape = windows.shape
    return stage_result(
        "line", column=(windows.peak + position).reshape(shape), sigma=sigma.reshape(shape), valid=valid.reshape(shape)
    )


def with_locking(windows: Windows, formula: Formula, *, follows_peak: bool = False) -> xr.Dataset:
    """The result of a formula without a model of the pixels.

    Its standard error holds the noise, √Σ(Δc)² with Δc half the change of c between a pixel's value plus and minus its standard
    deviation, which holds what a pixel at a threshold does too; and what the formula errs without any noise: the rms over the
    phases of a pixel, of a line as wide as the rig declares ("pixel locking"). `follows_peak`: of formulas that stay beside the
    brightest pixel, also how far noise moves that one.
    """
    position = formula(windows.z)
    variance = windows.variance
    square = np.zeros(position.shape)
    for k in range(windows.z.shape[1]):
        step = np.sqrt(variance[:, k])
        up, down = windows.z.copy(), windows.z.copy()
        up[:, k] += step
        down[:, k] -= step
        change = 0.5 * (formula(up) - formula(down))
        # A change that has no number moves the answer by up to half of the window.
        square += np.minimum(np.where(np.isfinite(change), np.abs(change), windows.half), windows.half) ** 2
    if follows_peak:
        square += _swapped(windows) ** 2
    return answered(windows, position, np.sqrt(square + _locking(windows, formula) ** 2))


def _swapped(windows: Windows) -> Float:
    """rms distance [px] (n) from the middle of a line of the declared width to the pixel that noise makes the brightest.

    Pixel k exceeds the middle one with P_k = Φ((μ_k − μ_0)/√(V_k + V_0)); of several that may, each has its share:
    Σ k² P_k/(1 + Σ P_k).
    """
    k = np.arange(-windows.half, windows.half + 1, dtype=np.float64)
    share = gaussian_mean(k - 0.5, k + 0.5, windows.width()[:, None])
    light = np.maximum(windows.z.sum(axis=1), 0.0)[:, None] * share
    variance = windows.excess * (light + np.maximum(windows.level, 0.0)[:, None]) + windows.floor_e2
    middle = slice(windows.half, windows.half + 1)
    chance = ndtr((light - light[:, middle]) / np.sqrt(variance + variance[:, middle]))
    chance[:, windows.half] = 0.0
    return np.asarray(np.sqrt((chance * k**2).sum(axis=1) / (1.0 + chance.sum(axis=1))))


def _locking(windows: Windows, formula: Formula) -> Float:
    """rms error [px] (n) of a formula without noise at the declared widths, from a table of widths."""
    width = windows.width()
    if not np.isfinite(width).any():
        return np.zeros(width.shape)
    table = np.geomspace(0.1, 10.0, 24)
    x = np.arange(-windows.half, windows.half + 1, dtype=np.float64)
    phase = (np.arange(_PHASES) + 0.5) / _PHASES - 0.5
    rms = np.empty(table.size)
    for i, s in enumerate(table):
        line = gaussian_mean(x - 0.5 - phase[:, None], x + 0.5 - phase[:, None], s)
        error = formula(line * 1e6) - phase
        rms[i] = np.sqrt(np.nanmean(error**2)) if np.isfinite(error).any() else 0.5
    return np.interp(np.log(np.where(np.isfinite(width), width, np.nanmedian(width))), np.log(table), rms)


@lru_cache(maxsize=32)
def _declared_width(rig: DeclaredRig) -> Float:
    """σ [px] (col); columns that see no sheet have the median of the others."""
    width = declared_geometry(rig).widths()
    known = np.isfinite(width)
    return np.where(known, width, np.median(width[known]) if known.any() else 1.0)


def _half_window(rig: DeclaredRig) -> int:
    return int(np.clip(np.ceil(4.0 * np.median(_declared_width(rig))) + 2, _LEAST, _MOST))
