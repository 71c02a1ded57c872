"""Photon transfer of a delay scan: gain, excess noise, dark signal and noise, and how much the light varies from frame to
frame.

With y a count, o the dark level, K the gain [DN/electron], G and F² gain and excess noise factor of a tube (1 without), and n
photoelectrons, all over repeats of one delay and pixel,

    mean(y) − o = K G n,        var(y) − var(dark) = K² G² F² n,        κ₃(y) − κ₃(dark) = K³ G³ F² (2F² − 1) n
 (a Poisson number of gamma-distributed pulses). So the slope of the variance is s₂ = K G F², that of the third cumulant s₃ =
(K G)² F² (2F² − 1), and s₃/s₂² = 2 − 1/F² tells F² whatever the gain is. Slopes are ratios of sums over pixels with weights
that depend on the delay only, so that the noise of a mean does not bias them.

What all pixels of a frame share (the laser's energy, a delay that jitters) is taken out first: each frame is compared with its
delay's mean, scaled to the frame's own mean. Otherwise a laser that varies by 1 % would pass for gain.

Source: EMVA Standard 1288 R4.0, sec. 6 (photon transfer); k-statistics: R. A. Fisher, Proc. London Math. Soc. 30:199, 1930.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .gated_scan import DelayScan

__all__ = ["Found", "dark_statistics", "jackknifed", "noise_statistics"]

Float = npt.NDArray[np.float64]

#: Parts of the pixels, each left out once, from which standard errors follow.
PARTS = 20
#: Variances are taken as no smaller, DN².
_LEAST_LIGHT = 1e-12


@dataclass(frozen=True)
class Found:
    """A value and its standard error, in the unit of the value."""

    value: float
    sigma: float


@dataclass(frozen=True, eq=False)
class _Moments:
    """Moments over repeats, (delay, pixel) and (pixel) for the dark frames: mean, variance, third cumulant."""

    mean: Float
    variance: Float
    third: Float
    dark_mean: Float
    dark_variance: Float
    dark_third: Float


def _k_statistics(values: Float) -> tuple[Float, Float]:
    """Unbiased variance and third cumulant over axis −2 of deviations from the mean."""
    n = values.shape[-2]
    squares = values * values
    square = squares.sum(axis=-2) / (n - 1)
    if n < 3:
        return square, np.full(square.shape, np.nan)
    squares *= values  # values**3 calls pow, which took half of a certificate's time
    return square, n * squares.sum(axis=-2) / ((n - 1) * (n - 2))


def _moments(scan: DelayScan) -> tuple[_Moments, Float]:
    """Moments, and the frames' means relative to their delay's mean above the dark level, (delay, repeat)."""
    y = scan.counts.astype(np.float64)
    dark = scan.dark.astype(np.float64)
    dark_mean = dark.mean(axis=0)
    level = float(dark_mean.mean())
    mean = y.mean(axis=1)
    frame, whole = y.mean(axis=2) - level, mean.mean(axis=1) - level
    noise = math.sqrt(float(dark.var(axis=0, ddof=1).mean()) / y.shape[2])
    bright = whole > 20.0 * noise
    relative = np.where(bright[:, None], frame / np.where(bright, whole, 1.0)[:, None], 1.0)
    expected = dark_mean + (mean - dark_mean)[:, None, :] * relative[..., None]
    lost = np.where(bright, 1.0 / y.shape[2], 0.0)[:, None]
    variance, third = _k_statistics(y - expected)
    # The common scale of a frame takes a share of a degree of freedom.
    variance, third = variance / (1.0 - lost), third / (1.0 - 3.0 * lost)
    off_variance, off_third = _k_statistics((dark - dark_mean)[None])
    return _Moments(mean, variance, third, dark_mean, off_variance[0], off_third[0]), np.where(
        bright[:, None], relative, np.nan
    )


def jackknifed(
    statistic: Callable[[Float], Mapping[str, float]], pixels: int, *, errors: bool = True
) -> dict[str, Found]:
    """Statistics of all pixels, with standard errors from leaving out each of twenty interleaved parts of them.

    Main arguments:
        statistic: weights of the pixels, 1 or 0 -> values by name. pixels: how many.
    Other arguments:
        errors: False leaves standard errors out (NaN), where only values are read.
    """
    whole = statistic(np.ones(pixels))
    if not errors:
        return {name: Found(value, math.nan) for name, value in whole.items()}
    parts = min(PARTS, pixels)
    owner = np.arange(pixels) % parts
    without = [statistic(np.where(owner == part, 0.0, 1.0)) for part in range(parts)]
    found = {}
    for name, value in whole.items():
        held = np.array([one[name] for one in without])
        found[name] = Found(value, float(math.sqrt((parts - 1) / parts * ((held - held.mean()) ** 2).sum())))
    return found


def noise_statistics(scan: DelayScan, *, errors: bool = True) -> dict[str, Found]:
    """`slope` = K G F² [DN], `skewness` = κ₃κ₁/κ₂² = 2 − 1/F² [1], `excess` = F² [1] from it, `fluctuation` [1], the
    relative rms of the frames'
    light beyond photon noise. With standard errors; saturated delays, in which a pixel reaches the converter's top, are left
    out.

    `excess` is NaN where fewer than three repeats or too little light leave the third cumulant undefined. `errors`: as
    `jackknifed`.
    """
    moments, relative = _moments(scan)
    top = float(scan.counts.max())
    bits = scan.rig.get("detector.adc_bits")
    full = isinstance(bits, int) and top >= 2**bits - 1
    clear = scan.counts.max(axis=(1, 2)) < top if full else np.ones(len(scan.counts), bool)

    def statistic(weight: Float) -> dict[str, float]:
        return _slopes(moments, weight, clear)

    found = jackknifed(statistic, scan.counts.shape[2], errors=errors)
    ratio = found["skewness"]
    # 2 − 1/F² tends to 2: beyond 1.9, F² = 10, noise decides. The error follows from that of the ratio, which is
    # even to both sides.
    excess = 1.0 / (2.0 - min(ratio.value, 1.9))
    found["excess"] = Found(excess, ratio.sigma * excess**2)
    return found | {"fluctuation": _fluctuation(scan, moments, relative, found["slope"].value)}


def _slopes(m: _Moments, weight: Float, clear: npt.NDArray[np.bool_]) -> dict[str, float]:
    total = weight.sum()

    def over(values: Float) -> Float:
        return np.asarray((values * weight).sum(axis=-1) / total)

    light = over(m.mean - m.dark_mean)
    variance, off = over(m.variance), float(over(m.dark_variance))
    w2 = np.where(clear & (light > 0), np.maximum(light, 0.0) / np.maximum(variance, _LEAST_LIGHT) ** 2, 0.0)
    slope = float((w2 * (variance - off)).sum() / max(float((w2 * light).sum()), 1e-300))
    # Not over variance³, which is best for each delay alone: the dark frames' cumulant is common to all of them.
    w3 = w2
    third = float((w3 * (over(m.third) - _off_third(m, weight))).sum() / max(float((w3 * light).sum()), 1e-300))
    ratio = third / slope**2 if slope > 0 else math.nan
    return {"slope": slope, "skewness": ratio}


def _off_third(m: _Moments, weight: Float) -> float:
    held = m.dark_third
    return float((held * weight).sum() / weight.sum()) if np.isfinite(held).all() else 0.0


def _fluctuation(scan: DelayScan, m: _Moments, relative: Float, slope: float) -> Found:
    """Relative rms of a frame's light, the part of photon and read noise in a frame's mean taken off."""
    pixels = scan.counts.shape[2]
    used = np.isfinite(relative).all(axis=1)
    if not used.any():
        return Found(math.nan, math.nan)
    light = (m.mean - m.dark_mean).mean(axis=1)[used]
    noise = m.variance.mean(axis=1)[used] / pixels / light**2
    seen = relative[used].var(axis=1, ddof=1)
    weight = 1.0 / noise**2
    square = float((weight * (seen - noise)).sum() / weight.sum())
    error = math.sqrt(2.0 / (scan.repeats - 1) / float(weight.sum()))
    # An rms has no sign: the root keeps that of its square, so that no light beyond noise gives about 0, evenly to both sides.
    value = math.copysign(math.sqrt(abs(square)), square)
    return Found(value, error / (2.0 * max(abs(value), math.sqrt(error))))


def dark_statistics(scan: DelayScan, *, errors: bool = True) -> dict[str, Found]:
    """Of the frames with the laser off: `level` [DN], `noise` = temporal rms of a pixel [DN] and `pattern` = rms of the
    pixels' means [DN], the temporal part taken off. `errors`: as `jackknifed`."""
    dark = scan.dark.astype(np.float64)
    mean, variance = dark.mean(axis=0), dark.var(axis=0, ddof=1)
    frames = len(dark)

    def statistic(weight: Float) -> dict[str, float]:
        total = weight.sum()
        level = float((weight * mean).sum() / total)
        noise = float((weight * variance).sum() / total)
        spread = float((weight * (mean - level) ** 2).sum() / (total - 1.0)) - noise / frames
        return {
            "level": level, "noise": math.sqrt(max(noise, 0.0)),
            "pattern": math.copysign(math.sqrt(abs(spread)), spread),
        }  # fmt: skip

    return jackknifed(statistic, dark.shape[1], errors=errors)
