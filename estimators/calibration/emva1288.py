"""EMVA 1288 (release 4.0, linear): gain, noise, dark signal, non-uniformities, saturation and linearity of a camera.

Input: dark and flat frames (`series`), two or more of each setting. y counts, K gain [DN/electron], H light on any scale:

    gain              σ_y² − σ_y.dark² = K (μ_y − μ_y.dark), least squares through the origin up to 70 % of saturation
    saturation        the setting of the greatest temporal variance
    dark noise        σ_d² = (σ_y.dark² − 1/12)/K²; at exposure 0 where there are three exposures or more without light
    dark current      slope of μ_y.dark against the exposure, over K
    DSNU              s_y.dark/K, s² the variance over pixels of the mean frame, less the frames' own noise in it
    PRNU              √(s_y² − s_y.dark²)/(μ_y − μ_y.dark) at the setting nearest to half of saturation
    linearity         straight line of μ_y − μ_y.dark against H by relative deviations, 5 to 95 % of saturation; greatest deviations

Source: EMVA Standard 1288, release 4.0 (2021), sections 6 to 8. Standard errors are those of the frames' noise and of the pixels
(one of 16 blocks of rows left out in turn, the jackknife); they do not hold errors of the lamp. The quantum efficiency needs the
photons of a calibrated lamp, and is not found. An intensifier's noise is not that of this model, and is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...scenes.errors import InputError
from ..rig import read_rig
from .procedure import Calibrated, Figure, Procedure
from .series import Series, Setting, read_series, settings_of

__all__ = ["EMVA1288", "Emva", "emva_figures"]

Float = npt.NDArray[np.float64]

#: Variance of the rounding of a converter, DN².
_ROUNDING = 1.0 / 12.0
#: Least temporal variance of a dark frame from which the noise can be told from the rounding, DN² (section 6.5).
_LEAST_DARK = 0.24
#: Least settings with light for a photon transfer.
_LEAST_LIT = 4
#: Shares of saturation: of the fit of the gain, and of the linearity.
_GAIN_TO, _LINE_FROM, _LINE_TO = 0.7, 0.05, 0.95
#: Share of the greatest variance below which a setting's pixels are all full.
_FULL = 0.5


@dataclass(frozen=True)
class Emva:
    """Figures of one series. NaN: the series does not tell."""

    gain_dn_per_e: float
    offset_dn: float
    dark_noise_e: float
    dark_e_per_s: float
    dsnu_e: float
    prnu: float
    saturation_e: float
    full_well_e: float
    linearity_low: float
    linearity_high: float


def emva_figures(series: Series) -> Emva:
    """The figures of the module's equations. Raises InputError where dark frames or enough settings with light are missing."""
    mean, variance, spatial = series.mean_dn, series.temporal_dn2, series.spatial_dn2
    lit = np.flatnonzero(series.light > 0)
    exposure = _main_exposure(series)
    dark = np.flatnonzero((series.light == 0) & (series.exposure_s == exposure))
    lit = lit[series.exposure_s[lit] == exposure]
    if dark.size != 1 or lit.size < _LEAST_LIT:
        raise InputError(
            "The series does not hold dark and flat frames of one exposure.", where="captures",
            value=f"{dark.size} dark and {lit.size} lit settings at {exposure:g} s",
            allowed=f"dark frames, and {_LEAST_LIT} levels of light or more, at one exposure",
            next_step="docs/calibration.md shows a series",
        )  # fmt: skip
    zero = int(dark[0])
    signal, noise = mean[lit] - mean[zero], variance[lit] - variance[zero]
    full = _saturation(noise)
    fit = signal <= _GAIN_TO * signal[full]
    fit[full:] = False
    if fit.sum() < 2:
        raise InputError(
            "Too few settings lie below saturation.", where="captures", value=int(fit.sum()),
            allowed="2 levels or more below 70 % of saturation", next_step="record weaker light",
        )  # fmt: skip
    gain = float((signal[fit] * noise[fit]).sum() / (signal[fit] ** 2).sum())
    responsivity = float((series.light[lit][fit] * signal[fit]).sum() / (series.light[lit][fit] ** 2).sum())
    low, high = _linearity(series.light[lit], signal, full)
    dark_mean, dark_variance, slope = _dark(series, zero)
    half = int(lit[int(np.argmin(np.abs(signal - 0.5 * signal[full])))])
    flat = spatial[half] - spatial[zero]
    return Emva(
        gain, dark_mean, _root(max(dark_variance, _LEAST_DARK) - _ROUNDING) / gain, slope / gain,
        _root(spatial[zero]) / gain, _root(flat) / float(mean[half] - mean[zero]),
        responsivity * float(series.light[lit][full]) / gain, _well(series, signal, noise, gain, full, float(mean[zero])),
        low, high,
    )  # fmt: skip


def _main_exposure(series: Series) -> float:
    """The exposure with the most settings under light."""
    values, counts = np.unique(series.exposure_s[series.light > 0], return_counts=True)
    return float(values[counts.argmax()]) if values.size else float(series.exposure_s[0])


def _saturation(noise: Float) -> int:
    """Index of the setting of the greatest variance: beyond it, pixels fill and their noise sinks."""
    return int(noise.argmax())


def _linearity(light: Float, signal: Float, full: int) -> tuple[float, float]:
    """Least and greatest relative deviation from the line, of settings between 5 and 95 % of saturation."""
    used = (
        (signal >= _LINE_FROM * signal[full]) & (signal <= _LINE_TO * signal[full]) & (np.arange(signal.size) <= full)
    )
    if used.sum() < 3:
        return float("nan"), float("nan")
    slope, offset = np.polyfit(light[used], signal[used], 1, w=1.0 / signal[used])
    line = slope * light[used] + offset
    away = (signal[used] - line) / line
    return float(away.min()), float(away.max())


def _dark(series: Series, zero: int) -> tuple[float, float, float]:
    """(mean, variance, slope of the mean against the exposure) of dark frames at exposure 0, of three exposures or more.

    With fewer the first two are those of the series' own exposure, and the slope is NaN.
    """
    unlit = np.flatnonzero(series.light == 0)
    if unlit.size < 3:
        return float(series.mean_dn[zero]), float(series.temporal_dn2[zero]), float("nan")
    time = series.exposure_s[unlit]
    slope, mean = np.polyfit(time, series.mean_dn[unlit], 1)
    return float(mean), float(np.polyfit(time, series.temporal_dn2[unlit], 1)[1]), float(slope)


def _well(series: Series, signal: Float, noise: Float, gain: float, full: int, dark_dn: float) -> float:
    """Electrons of a full pixel: the level at which counts stay; NaN where none does, or the converter ends before."""
    top = signal[-1]
    flat = noise[-1] < _FULL * noise[full] and signal.size > full + 1
    return float(top / gain) if flat and dark_dn + top < 0.99 * series.top_dn else float("nan")


def _root(value: float) -> float:
    return float(np.sqrt(value)) if value >= 0 else float("nan")


def _lacking(captures: Sequence[xr.Dataset]) -> str:
    """What the captures lack: single frames with the laser off, dark ones and under light that the rig declares."""
    found: set[Setting] = set()
    for capture in captures:
        if "counts" not in capture or capture["counts"].ndim != 3:
            return "frames of a camera"
        if read_rig(capture).get("ambient_e_per_s") is None:
            return "ambient_e_per_s in the declared rig: the setting of the lamp, 0 for dark frames"
        found |= set(settings_of(capture))
    if not any(one.light == 0 for one in found):
        return "dark frames: laser off, ambient_e_per_s = 0"
    lit = len({one for one in found if one.light > 0})
    return "" if lit >= _LEAST_LIT else f"{_LEAST_LIT} levels of light or more with the laser off ({lit} are there)"


def _run(captures: Sequence[xr.Dataset]) -> Calibrated:
    for number, capture in enumerate(captures):
        if read_rig(capture).get("detector.intensifier") is not None:
            raise InputError(
                "The photon transfer of an intensified camera is not that of EMVA 1288: its tube adds noise.",
                where=f"capture {number}: attribute rig: detector.intensifier", allowed="a camera without a tube",
            )  # fmt: skip
    series = read_series(captures)
    whole = emva_figures(series)
    blocks = series.pixels.size
    parts = [emva_figures(series.without(block)) for block in range(blocks)] if blocks > 1 else []
    exposures = np.unique(series.exposure_s[series.light == 0]).size
    return Calibrated(
        _shown(whole, parts, exposures),
        used={
            "settings": int(series.light.size), "frames": int(series.frames.sum()), "pixels": int(series.pixels.sum()),
            "dark_exposures": int(exposures),
        },
    )  # fmt: skip


def _shown(whole: Emva, parts: Sequence[Emva], exposures: int) -> tuple[Figure, ...]:
    def of(name: str, field: str, unit: str, path: str = "", note: str = "") -> Figure:
        value = float(getattr(whole, field))
        left = np.array([getattr(part, field) for part in parts])
        sigma = (
            float(np.sqrt((len(left) - 1) / len(left) * ((left - left.mean()) ** 2).sum())) if parts else float("nan")
        )
        return Figure(name, unit, value, sigma, path if np.isfinite(value) else "", note)

    own = (
        "" if exposures >= 3 else "holds the dark electrons of the exposure: three dark exposures would tell them apart"
    )
    return (
        of("gain K", "gain_dn_per_e", "DN/electron", "rig.detector.gain_dn_per_e"),
        of("offset", "offset_dn", "DN", "rig.detector.offset_dn", own),
        of("dark noise", "dark_noise_e", "electron", "rig.detector.read_noise_e", own),
        of("dark current", "dark_e_per_s", "electron/s", "rig.detector.dark_current_e_per_s",
           "" if exposures >= 3 else "needs dark frames at three exposures or more"),
        of("DSNU", "dsnu_e", "electron", "rig.detector.dsnu_e"),
        of("PRNU", "prnu", "1", "rig.detector.prnu"),
        of("full well", "full_well_e", "electron", "rig.detector.full_well_e",
           "" if np.isfinite(whole.full_well_e) else "no setting fills the pixels below the converter's top"),
        of("saturation capacity", "saturation_e", "electron", note="of the setting of the greatest variance"),
        of("linearity error, least", "linearity_low", "1"),
        of("linearity error, greatest", "linearity_high", "1"),
    )  # fmt: skip


EMVA1288 = Procedure(
    "emva1288", "gain, noise, dark signal, non-uniformities, saturation and linearity from dark and flat frames", _lacking,
    _run,
)  # fmt: skip
