"""Level of the background of every shot, and the least signal that an estimator answers."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from ...scenes.errors import InputError
from .record import WaveformRecord

__all__ = ["Background", "background_level", "first_samples", "least_snr"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Where the background is read: see `background_level`.
Background = Literal["robust", "outside", "before", "off-shots", "none"]

#: Standard deviations of the background above which a sample shows light, here and in `first_samples`.
_LIGHT = 4.0
#: Fewest samples that give a level.
_FEWEST = 4
#: Samples of a block: its mean shows light of a quarter of what a sample shows.
_BLOCK = 16


def background_level(record: WaveformRecord, how: Background, where: str) -> tuple[Float, Float]:
    """(level of the background [photoelectrons per sample], its variance), each (shot).

    how: "outside": mean of the samples that an echo at the brightest sample cannot reach; later returns and tails that lie
    there raise it. "robust": the same mean without the samples and the blocks of samples that show light, and those that the
    light may reach. "before": mean of the samples before the first light; NaN where there are fewer than four. "off-shots": mean of
    all sound samples of the shots with the laser off. "none": 0.
    where: name of the estimator, for the message. Raises InputError for "off-shots" where no shot is dark.
    """
    shots = len(record.z)
    if how == "none":
        return np.zeros(shots), np.zeros(shots)
    if how == "off-shots":
        used = record.good & record.dark[:, None]
        if not used.any():
            raise InputError(
                "The capture has no shot with the laser off.", where=f"{where}[background=off-shots]",
                allowed="robust, outside, before, none", next_step="set laser_on = False for shots that were taken so",
            )  # fmt: skip
        number = float(used.sum())
        level = np.full(shots, record.z[used].sum() / number)
        return level, record.variance(level) / number
    used = _unreached(record)
    if how == "robust":
        used, _, spread = _dark(record, used)
        used = _dark_blocks(record, used, spread)
    elif how == "before":
        used = first_samples(record)
    count = used.sum(axis=1)
    level = np.where(used, record.z, 0.0).sum(axis=1) / np.maximum(count, 1)
    if how == "before":
        level = np.where(count >= _FEWEST, level, np.nan)
    return level, record.variance(level) / np.maximum(count, 1)


def first_samples(record: WaveformRecord) -> Bool:
    """The good samples before the first light, less those that its echo may reach: (shot, sample)."""
    _, light, _ = _dark(record, record.good)
    start = np.where(light.any(axis=1), np.argmax(light, axis=1), record.time_s.size)
    return record.good & (np.arange(record.time_s.size) < (start - record.reach[0])[:, None])


def least_snr(record: WaveformRecord, min_snr: float | None, where: str) -> float:
    """The least signal in its standard errors: `min_snr` where it is given, else 4 for analog records and 0 for single
    photons, of which a few above a faint background are an echo. Raises InputError for a negative one."""
    if min_snr is None:
        return 0.0 if record.single_photon else 4.0
    if min_snr < 0:
        raise InputError(
            "The least signal must not be negative.", where=f"{where}[min_snr]", value=min_snr, allowed=">= 0"
        )
    return min_snr


def _unreached(record: WaveformRecord) -> Bool:
    """Good samples that an echo at the brightest sample cannot reach; the lowest quarter where fewer than four are left."""
    out = record.good & ~record.near(record.brightest())
    few = out.sum(axis=1) < _FEWEST
    if few.any():
        order = np.argsort(np.where(record.good[few], record.z[few], np.inf), axis=1)
        least = np.zeros_like(out[few])
        np.put_along_axis(least, order[:, : max(record.time_s.size // 4, 1)], True, axis=1)
        out[few] = least & record.good[few]
    return out


def _dark(record: WaveformRecord, among: Bool) -> tuple[Bool, Bool, Float]:
    """(samples of `among` without light, samples that show light, each (shot, sample); spread of the lower samples (shot)).

    The level starts at the lower quartile, which stands in the noise while less than three quarters of the samples show
    light, and rises to the mean of the samples below level + 4 s + 4 F² (the same probability for normal and for Poisson
    noise: F. J. Anscombe, Biometrika 35:246, 1948). s: the declared noise, or the spread of the lower samples where it is
    greater. Where fewer than four are left, all of `among` are.
    """
    z = np.sort(np.where(among, record.z, np.inf), axis=1)
    held = among.sum(axis=1)
    rows = np.arange(len(z))
    low, quartile = (np.where(held > 0, z[rows, (share * held).astype(np.intp)], 0.0) for share in (0.1, 0.25))
    # Of a normal distribution these two quantiles lie .607 σ apart.
    spread, level = (quartile - low) / 0.607, quartile
    light = np.zeros_like(among)
    kept = among
    for _ in range(12):
        s = np.maximum(np.maximum(np.sqrt(record.variance(level)), spread), 0.5)
        light = (record.z > (level + _LIGHT * s + _LIGHT * record.excess)[:, None]) | (~record.good & (record.z > 0))
        kept = among & ~_widened(light, *record.reach)
        few = kept.sum(axis=1) < _FEWEST
        kept[few] = (among & ~light)[few]
        few = kept.sum(axis=1) < _FEWEST
        kept[few] = among[few]
        new = np.where(kept, record.z, 0.0).sum(axis=1) / np.maximum(kept.sum(axis=1), 1)
        if np.allclose(new, level, rtol=0, atol=1e-12):
            break
        level = new
    return kept, light, spread


def _dark_blocks(record: WaveformRecord, among: Bool, spread: Float) -> Bool:
    """Those of `among` in blocks of 16 samples whose mean shows no light either, as a faint tail does: (shot, sample).

    As `_dark`, from the lowest block on.
    """
    samples = record.time_s.size
    starts = np.arange(0, samples, _BLOCK)
    number = np.add.reduceat(among.astype(np.float64), starts, axis=1)
    total = np.add.reduceat(np.where(among, record.z, 0.0), starts, axis=1)
    mean = np.where(number >= _FEWEST, total / np.maximum(number, 1), np.inf)
    level = mean.min(axis=1)
    seen = np.isfinite(level)
    level = np.where(seen, level, 0.0)
    dark = number > 0
    for _ in range(12):
        variance = np.maximum(np.maximum(record.variance(level), spread**2), 0.25)[:, None]
        dark = (number > 0) & (
            total <= number * level[:, None] + _LIGHT * np.sqrt(number * variance) + _LIGHT * record.excess
        )
        count = np.where(dark, number, 0.0).sum(axis=1)
        new = np.where(count > 0, np.where(dark, total, 0.0).sum(axis=1) / np.maximum(count, 1), level)
        if np.allclose(new, level, rtol=0, atol=1e-12):
            break
        level = new
    kept = among & np.repeat(dark, _BLOCK, axis=1)[:, :samples]
    enough = seen & (kept.sum(axis=1) >= _FEWEST)
    return np.where(enough[:, None], kept, among)


def _widened(light: Bool, before: int, after: int) -> Bool:
    """Samples that an echo which shows light in a sample of `light` may reach."""
    total = np.cumsum(np.pad(light, ((0, 0), (1, 0))), axis=1)
    n = light.shape[1]
    k = np.arange(n)
    # Light at sample j reaches from j − before to j + after: sample k is reached by j from k − after to k + before.
    return np.asarray(total[:, np.minimum(k + before + 1, n)] > total[:, np.maximum(k - after, 0)])
