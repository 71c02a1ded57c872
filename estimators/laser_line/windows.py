"""Reading the frames of a laser line: in every row the brightest pixels, and a window of photoelectrons around each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.special import ndtr

from ...optics.sheet import gaussian_mean
from ..declared import check_keys
from ..result import stage_result
from ..rig import DeclaredRig, read_rig
from .declared import LASER_LINE_KEYS
from .frames import OffFrames, Scale, read_frames
from .geometry import declared_geometry
from .row_scan import scan_rows

__all__ = ["Formula", "Windows", "answered", "line_windows", "locked", "with_locking"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Windows (n, 2h + 1) above their background -> positions of the line from the middle pixel [px] (n), NaN where there is none.
Formula = Callable[[Float], Float]

#: Least and most half width of a window [px].
_LEAST, _MOST = 3, 64
#: Phases of the pixel over which a formula's error without noise is averaged.
_PHASES = 64
#: Widths [px] at which that is tabulated.
_WIDTHS = np.geomspace(0.1, 10.0, 24)
#: Where noise moves the brightest pixel by less [px, rms], it is the right one.
_SURE_PX = 0.01


@dataclass(frozen=True, eq=False)
class Windows:
    """The windows of all frames, n = frames · rows · returns; `shape` is these three.

    z (n, 2h + 1): photoelectrons around the brightest pixel, above the row's background. peak (n): that pixel's column.
    level, row_level (n): the background, photoelectrons; 0 and NaN in rows without. Where frames without laser are subtracted,
    `row_level` is what is left, and `level` the light whose shot noise the pixels have. floor_e2: variance of a pixel without
    light; excess: F², the variance of light over its mean.
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
    off_frames: OffFrames = "unused"

    @property
    def half(self) -> int:
        """Pixels to either side of the brightest one."""
        return int(self.z.shape[1]) // 2

    @property
    def frame(self) -> npt.NDArray[np.int64]:
        """Frame of every window (n)."""
        return np.repeat(np.arange(self.shape[0]), self.shape[1] * self.shape[2])

    @property
    def row(self) -> npt.NDArray[np.int64]:
        """Row of every window (n)."""
        return np.tile(np.repeat(np.arange(self.shape[1]), self.shape[2]), self.shape[0])

    @property
    def variance(self) -> Float:
        """Variance of the pixels (n, 2h + 1), from their own counts."""
        return np.asarray(self.excess * np.maximum(self.z + self.level[:, None], 0.0) + self.floor_e2)

    def electrons(self, capture: xr.Dataset) -> tuple[Float, Bool]:
        """(photoelectrons, whether a pixel is sound), each (frame, row, col), of the capture that the windows are of."""
        scale = Scale.of(self.rig)
        read = read_frames(capture, scale, self.off_frames)
        good = np.ones(read.shape, bool) if read.good is None else read.good.reshape(read.shape)
        return scale.electrons(read.counts).reshape(read.shape), good

    def width(self) -> Float:
        """σ [px] (n) that the declared rig gives a line at these columns."""
        return np.asarray(_declared_width(self.rig)[np.clip(self.peak, 0, None)])

    def locking(self, formula: Formula) -> Float:
        """rms error [px] (n) of a formula without any noise, of lines as wide as the rig declares at these columns."""
        plain = formula.func if isinstance(formula, partial) else formula
        given = tuple(sorted(formula.keywords.items())) if isinstance(formula, partial) else ()
        return np.asarray(_locking(self.rig, self.half, plain, given)[np.clip(self.peak, 0, None)])

    def shares(self) -> tuple[Float, Float]:
        """Shares (n) of the light of a line of the declared width in the pixel that it is in the middle of, less and plus that in
        the next one."""
        fall, near = _shares(self.rig)
        at = np.clip(self.peak, 0, None)
        return fall[at], near[at]

    def of(self, chosen: Bool) -> Windows:
        """Some of the windows; their `shape` is as if each were a frame."""
        return replace(
            self, z=self.z[chosen], peak=self.peak[chosen], level=self.level[chosen], row_level=self.row_level[chosen],
            sound=self.sound[chosen], shape=(int(chosen.sum()), 1, 1),
        )  # fmt: skip


def line_windows(
    capture: xr.Dataset, *, least_half: int = _LEAST, least_sigmas: float = 5.0, returns: int = 1,
    off_frames: OffFrames = "unused",
) -> Windows:  # fmt: skip
    """The windows of a capture.

    Other arguments:
        least_half: least number of pixels to either side, which are four standard deviations of the declared line and two.
        least_sigmas: height of the peak over its row's background, in standard deviations of a pixel without light. A row of
            Gaussian noise alone passes with a chance of at most cols · Q(least_sigmas), 5.5e-5 of 192 columns at 5.
        returns: windows per row, the brightest first; each later one lies outside of those before it.
        off_frames: "subtracted": the mean of the frames without laser is taken from every lit one first.

    The background of a row is the median of its sound pixels. Raises InputError for a rig that lacks a value, for frames
    of several channels, and where no frame can be subtracted.
    """
    rig = read_rig(capture, "laser_line")
    half = max(_half_window(rig), least_half)
    scale = Scale.of(rig).of_gains(capture)
    read = read_frames(capture, scale, off_frames)
    frames, rows, _ = read.shape
    peak, window, median, sound = scan_rows(read.counts, half, max(returns, 1), read.top_dn, read.dead_dn)
    shape = (frames, rows, peak.shape[1])
    level = np.repeat(scale.electrons(median), shape[2])
    z = scale.electrons(window).reshape(level.size, -1) - level[:, None]
    noisy = level + read.ambient_variance_e(peak, half, scale)
    fine = sound.ravel() & np.repeat(read.usable, shape[2]) & np.isfinite(level)
    with np.errstate(invalid="ignore"):
        fine &= z[:, half] > least_sigmas * np.sqrt(scale.floor_e2 + scale.excess * np.maximum(noisy, 0.0))
    z[~fine] = 0.0
    return Windows(
        z, peak.ravel(), np.where(fine, noisy, 0.0), level, scale.floor_e2, scale.excess, fine, shape, rig, off_frames
    )  # fmt: skip


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


def with_locking(
    windows: Windows, formula: Formula, *, reach: int | None = None, follows_peak: Literal["no", "held", "free"] = "no"
) -> xr.Dataset:
    """The result of a formula without a model of the pixels; arguments as of `locked`."""
    return answered(windows, *locked(windows, formula, reach=reach, follows_peak=follows_peak))


def locked(
    windows: Windows, formula: Formula, *, reach: int | None = None, follows_peak: Literal["no", "held", "free"] = "no"
) -> tuple[Float, Float]:
    """Position [px] from the peak (n) and its standard error [px] (n) of a formula without a model of the pixels.

    Other arguments:
        reach: pixels to either side of the middle that the formula reads; all of them where it is not given.
        follows_peak: of formulas that stay beside the brightest pixel, which noise moves: "held" where the answer moves with it,
            "free" where the formula finds the line from a neighbour too (the vertex of a curve).

    The standard error holds the noise, √Σ(Δc)² with Δc half the change of c between a pixel's value plus and minus its standard
    deviation, which holds what a pixel at a threshold does too; and what the formula errs without any noise: the rms over the
    phases of a pixel, of a line as wide as the rig declares ("pixel locking"); of "held" ones also how far noise moves the
    brightest pixel. Where it may move that pixel, the top of the line is flat against the noise, and a formula's slope at the
    measured pixels says little: of "free" ones the noise is then that of small changes about the expected line.
    """
    position = formula(windows.z)
    z, variance = windows.z, windows.variance
    swapped = np.zeros(position.shape) if follows_peak == "no" else _swapped(windows)
    part = np.ones(position.shape)  # of a standard deviation, by which a pixel is changed
    if follows_peak == "free" and (unsure := swapped > _SURE_PX).any():
        part[unsure] = 0.01
        line = _expected(windows, np.clip(np.nan_to_num(position), -0.5, 0.5))
        z = np.where(unsure[:, None], line, z)
        variance = np.where(unsure[:, None], _light_variance(windows, line), variance)
    read = windows.half if reach is None else min(reach, windows.half)
    square = np.zeros(position.shape)
    for k in range(windows.half - read, windows.half + read + 1):
        step = part * np.sqrt(variance[:, k])
        up, down = z.copy(), z.copy()
        up[:, k] += step
        down[:, k] -= step
        change = 0.5 * (formula(up) - formula(down)) / part
        # A change that has no number moves the answer by up to half of the window.
        square += np.minimum(np.where(np.isfinite(change), np.abs(change), windows.half), windows.half) ** 2
    if follows_peak == "held":
        square += swapped**2
    return position, np.sqrt(square + windows.locking(formula) ** 2)


def _expected(windows: Windows, place: Float | float) -> Float:
    """A line of the declared width and the window's light about `place` (n), photoelectrons (n, 2h + 1)."""
    k = np.arange(-windows.half, windows.half + 1, dtype=np.float64) - np.reshape(place, (-1, 1))
    share = gaussian_mean(k - 0.5, k + 0.5, windows.width()[:, None])
    return np.asarray(np.maximum(windows.z.sum(axis=1), 0.0)[:, None] * share)


def _light_variance(windows: Windows, light: Float) -> Float:
    return np.asarray(windows.excess * (light + np.maximum(windows.level, 0.0)[:, None]) + windows.floor_e2)


def _swapped(windows: Windows) -> Float:
    """rms distance [px] (n) from the middle of a line of the declared width to the pixel that noise makes the brightest.

    Pixel k exceeds the middle one with P_k = Φ((μ_k − μ_0)/√(V_k + V_0)); of several that may, each has its share:
    Σ k² P_k/(1 + Σ P_k).
    """
    k = np.arange(-windows.half, windows.half + 1, dtype=np.float64)
    light = _expected(windows, 0.0)
    variance = _light_variance(windows, light)
    middle = slice(windows.half, windows.half + 1)
    chance = ndtr((light - light[:, middle]) / np.sqrt(variance + variance[:, middle]))
    chance[:, windows.half] = 0.0
    return np.asarray(np.sqrt((chance * k**2).sum(axis=1) / (1.0 + chance.sum(axis=1))))


@lru_cache(maxsize=64)
def _locking(rig: DeclaredRig, half: int, formula: Callable[..., Float], given: tuple[tuple[str, Any], ...]) -> Float:
    """rms error [px] (col) of a formula without noise at the declared widths, from a table of widths."""
    width = _declared_width(rig)
    return np.interp(np.log(width), np.log(_WIDTHS), _locking_table(half, formula, given))


@lru_cache(maxsize=32)
def _shares(rig: DeclaredRig) -> tuple[Float, Float]:
    """Shares (col) of a line's light in the pixel that it is in the middle of, less and plus that in the next one."""
    width = _declared_width(rig)
    middle, beside = (gaussian_mean(k - 0.5, k + 0.5, width) for k in (0.0, 1.0))
    return np.asarray(middle - beside), np.asarray(middle + beside)


@lru_cache(maxsize=64)
def _locking_table(half: int, formula: Callable[..., Float], given: tuple[tuple[str, Any], ...]) -> Float:
    """rms error [px] of a formula without noise, over the phases of a pixel, for each of `_WIDTHS`."""
    x = np.arange(-half, half + 1, dtype=np.float64)
    phase = (np.arange(_PHASES) + 0.5) / _PHASES - 0.5
    rms = np.empty(_WIDTHS.size)
    for i, s in enumerate(_WIDTHS):
        line = gaussian_mean(x - 0.5 - phase[:, None], x + 0.5 - phase[:, None], s)
        error = formula(line * 1e6, **dict(given)) - phase
        rms[i] = np.sqrt(np.nanmean(error**2)) if np.isfinite(error).any() else 0.5
    return rms


@lru_cache(maxsize=32)
def _declared_width(rig: DeclaredRig) -> Float:
    """σ [px] (col); columns that see no sheet have the median of the others."""
    width = declared_geometry(rig).widths()
    known = np.isfinite(width)
    return np.where(known, width, np.median(width[known]) if known.any() else 1.0)


@lru_cache(maxsize=32)
def _half_window(rig: DeclaredRig) -> int:
    check_keys(rig, LASER_LINE_KEYS)
    return int(np.clip(np.ceil(4.0 * np.median(_declared_width(rig))) + 2, _LEAST, _MOST))
