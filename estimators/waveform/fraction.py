"""Timing at a constant fraction of the height of an echo: of the brightest one, or of the first."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...scenes.errors import InputError
from ..registry import estimator
from ..result import range_result
from .background import Background, background_level, least_snr
from .edge import edge_slope, rise_lag
from .per_pulse import per_pulse
from .record import WaveformRecord, read_record

__all__ = ["waveform_constant_fraction", "waveform_first_return"]

Float = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


@estimator("waveform", cites="Gedcke and McDonald, Nucl. Instrum. Methods 55:377, 1967 (constant fraction)")
@per_pulse
def waveform_constant_fraction(
    capture: xr.Dataset,
    *,
    fraction: float = 0.5,
    smooth: float = 0.5,
    background: Background = "robust",
    min_snr: float | None = None,
) -> xr.Dataset:
    """τ = last crossing of a fraction of the height of the brightest echo before its top, less the lag of the response there.

    There is no walk, since the level follows the height (a parabola through the three highest samples). The record is
    smoothed first, as the bandwidth of a comparator does: otherwise noise crosses the level many times.
    Other arguments: fraction: 0.05 … 0.95. smooth: length of the moving average in σ of the response, 0 … 4. background:
    as `waveform-average`. min_snr: least height in standard deviations of the noise at the top (null: 4, and 0 for single
    photons).
    Returns range, sigma [m] and valid (shot). Invalid: a sample of the echo is clipped or missing, since the height is then
    unknown. Raises InputError for parameters out of range.
    """
    where = "waveform-constant-fraction"
    record, length = _read(capture, fraction, smooth, where)
    least, base = least_snr(record, min_snr, where), background_level(record, background, where)
    z = _moving_mean(record.z, length)
    top = np.argmax(np.where(record.good | (record.z > 0), z, -np.inf), axis=1)
    return _timed(record, z, top, base, fraction, length, least)


@estimator(
    "waveform", cites="Wagner et al., ISPRS J. Photogramm. 60:100, 2006 (first return; constant fraction of its height)"
)
@per_pulse
def waveform_first_return(
    capture: xr.Dataset,
    *,
    fraction: float = 0.5,
    smooth: float = 0.5,
    threshold_sigma: float = 8.0,
    background: Background = "robust",
    min_snr: float | None = None,
) -> xr.Dataset:
    """τ of the first echo, however bright later ones are: constant fraction of the first top above a threshold.

    The first top is the first sample above the threshold that no sample within σ of the response after it exceeds. An echo
    that follows within some 3 σ raises the height and is not told apart (`waveform-several-returns` fits both).
    Other arguments: threshold_sigma: above the background, in standard deviations of its noise. The others: as
    `waveform-constant-fraction`. Returns range, sigma [m] and valid (shot). Raises InputError for parameters out of range.
    """
    where = "waveform-first-return"
    record, length = _read(capture, fraction, smooth, where)
    if threshold_sigma <= 0:
        raise InputError("The threshold must be positive.", where=f"{where}[threshold_sigma]", value=threshold_sigma,
                         allowed="> 0")  # fmt: skip
    least, base = least_snr(record, min_snr, where), background_level(record, background, where)
    z = _moving_mean(record.z, length)
    level = base[0] + threshold_sigma * np.sqrt(np.maximum(record.variance(base[0]), 0.25) / length)
    ahead = max(1, round(record.width_s / record.step_s))
    padded = np.pad(z, ((0, 0), (0, ahead)), constant_values=-np.inf)
    following = np.lib.stride_tricks.sliding_window_view(padded, ahead + 1, axis=1).max(axis=-1)
    tops = (z > level[:, None]) & (z >= following)
    top = np.where(tops.any(axis=1), np.argmax(tops, axis=1), 0)
    return _timed(record, z, top, base, fraction, length, least, tops.any(axis=1))


def _read(capture: xr.Dataset, fraction: float, smooth: float, where: str) -> tuple[WaveformRecord, int]:
    """The record, and the length of the moving average in samples."""
    if not 0.05 <= fraction <= 0.95 or not 0 <= smooth <= 4:
        raise InputError(
            "A parameter is out of range.", where=f"{where}[fraction, smooth]", value=(fraction, smooth),
            allowed="fraction .05 … .95, smooth 0 … 4",
        )  # fmt: skip
    record = read_record(capture)
    length = max(1, 2 * int(0.5 * smooth * record.width_s / record.step_s) + 1)
    return record, min(length, record.time_s.size)


def _timed(
    record: WaveformRecord, z: Float, top: Index, base: tuple[Float, Float], fraction: float, length: int, min_snr: float,
    seen: npt.NDArray[np.bool_] | None = None,
) -> xr.Dataset:  # fmt: skip
    """Range of the last crossing before sample `top` (shot) of z, the record averaged over `length` samples.

    base: level of the background and its variance. seen: shots that have such a top.
    """
    level_e, level_var = base
    sound = _moving_mean(record.good.astype(np.float64), length) > 1 - 0.5 / length
    rows = np.arange(len(z))
    intact = record.intact(top)
    top = np.clip(top, 1, z.shape[1] - 2)
    left, mid, right = (z[rows, top + i] for i in (-1, 0, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        curve = left - 2 * mid + right
        peak = np.where(curve < 0, mid - (right - left) ** 2 / (8 * curve), mid)
        level = level_e + fraction * (peak - level_e)
        below = (z < level[:, None]) & (np.arange(z.shape[1]) < top[:, None])
        at = z.shape[1] - 1 - np.argmax(below[:, ::-1], axis=1)
        found = record.usable & below.any(axis=1) & (peak - level_e > min_snr * np.sqrt(record.variance(mid) / length))
        found &= intact if seen is None else intact & seen
        at = np.where(below.any(axis=1), at, 0)
        found &= sound[rows, top] & sound[rows, at] & sound[rows, at + 1]
        rise = z[rows, at + 1] - z[rows, at]
        f = (level - z[rows, at]) / rise
        # Neighbouring averages share all samples but one: the line between them has the noise of one average.
        share = (1 - f) ** 2 + f**2 if length == 1 else 1.0
        own = share * record.variance(level) / length
        shift = fraction**2 * record.variance(mid) / length + (1 - fraction) ** 2 * level_var
        # The slope comes from the response: between two noisy samples it is steepest where noise helps.
        sigma = np.sqrt(own + shift) / ((peak - level_e) * edge_slope(record, np.asarray(fraction), length))
    tau = record.time_s[at] + record.step_s * f - rise_lag(record, np.asarray(fraction), length)
    return range_result(record.range_m(tau), sigma * record.m_per_s, found)


def _moving_mean(z: Float, length: int) -> Float:
    """Mean over `length` samples, an odd number; the outermost sample is repeated beyond the ends."""
    if length == 1:
        return z
    half = length // 2
    padded = np.pad(z, ((0, 0), (half + 1, half)), mode="edge")
    total = np.cumsum(padded, axis=1)
    return np.asarray((total[:, length:] - total[:, :-length]) / length)
