"""Weighted average of a waveform, without and with the pile-up correction of Coates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.pile_up import coates_rate
from ...scenes.errors import InputError
from ..registry import estimator
from ..result import range_result
from .background import Background, background_level, least_snr
from .per_pulse import per_pulse
from .record import WaveformRecord, read_record

__all__ = ["waveform_average", "waveform_coates"]

Float = npt.NDArray[np.float64]


def _centroid(
    record: WaveformRecord, z: Float, variance: Float, level: Float, level_var: Float, reach: float, min_snr: float
) -> xr.Dataset:
    """Centroid of z − level over the samples within `reach` σ_R of the brightest one; over all samples where it is 0."""
    seen = np.where(record.good, z, -np.inf)
    top = record.time_s[np.argmax(seen, axis=1)]
    use = record.good & np.isfinite(z)
    low = np.full(len(z), record.time_s[0])
    if reach > 0:
        # In two rounds: the brightest sample is noisy, the first centroid is less so.
        use = use & (np.abs(record.time_s - top[:, None]) <= reach * record.width_s)
        y = np.where(use, z - level[:, None], 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            centre = (y * record.time_s).sum(axis=1) / y.sum(axis=1)
        near = np.abs(record.time_s - centre[:, None]) <= reach * record.width_s
        use = record.good & np.isfinite(z) & np.where(np.isfinite(centre)[:, None], near, use)
    y = np.where(use, z - level[:, None], 0.0)
    total = y.sum(axis=1)
    noise = np.where(use, variance, 0.0)
    x = record.time_s - low[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (y * x).sum(axis=1) / total
        arm = np.where(use, x - mean[:, None], 0.0)
        var = (arm**2 * noise).sum(axis=1) + arm.sum(axis=1) ** 2 * level_var
        # One photoelectron more at the spread of R: of one count alone the samples show no spread at all.
        var += record.excess * record.share.variance_s2
        sigma = np.sqrt(var) / total
        spread = np.sqrt(noise.sum(axis=1) + use.sum(axis=1) ** 2 * level_var)
        clipped = (~record.good & (np.abs(record.time_s - (low + mean)[:, None]) < 3 * record.width_s)).any(axis=1)
        found = record.usable & (total > min_snr * spread) & (total > 0) & ~clipped
    tau = low + mean - record.centroid_s
    return range_result(record.range_m(tau), sigma * record.m_per_s, found)


def _check(reach: float, where: str) -> None:
    if reach < 0:
        raise InputError("A parameter is negative.", where=f"{where}[reach]", value=reach, allowed=">= 0")


@estimator(
    "waveform",
    cites="Guo et al. 2017, Figure 7 (weighted average of a photodetector's pulse); "
    "Busck and Heiselberg, Appl. Opt. 43(24):4705, 2004",
)
@per_pulse
def waveform_average(
    capture: xr.Dataset,
    *,
    background: Background = "robust",
    reach: float = 3.0,
    min_snr: float | None = None,
) -> xr.Dataset:
    """τ = Σ t_k y_k/Σ y_k − lag of the centroid of the response, y = z − background.

    Other arguments: background: "robust" is the mean of the samples without light, "outside" of all that the brightest echo
    cannot reach, "before" of those before the first light, "off-shots" of the shots with the laser off; "none" subtracts
    nothing, which pulls the answer to the middle of the window. reach: half width of the window about the echo in σ of the
    response; 0 takes the whole record. min_snr: least Σ y in its standard errors (null: 4, and 0 for single photons).
    Pile-up of single-photon counts pulls the answer to early times.
    Returns range, sigma [m] and valid (shot). sigma² has one photoelectron more than the samples show, so that of one count
    it is the variance of R. Raises InputError for negative parameters, and for "off-shots" where no shot is dark.
    """
    _check(reach, "waveform-average")
    record = read_record(capture)
    least = least_snr(record, min_snr, "waveform-average")
    level, level_var = background_level(record, background, "waveform-average")
    return _centroid(record, record.z, record.variance(record.z), level, level_var, reach, least)


@estimator(
    "waveform",
    cites="Coates, J. Phys. E: Sci. Instrum. 1:878, 1968 (correction of pile-up)",
    needs={"detector.readout.kind": "single-photon"},
)
@per_pulse
def waveform_coates(
    capture: xr.Dataset, *, background: Background = "robust", reach: float = 3.0, min_snr: float | None = None
) -> xr.Dataset:
    """Weighted average of the rates λ̂_k = −ln(1 − n_k/live_k) of a single-photon histogram.

    live_k is the number of pulses that no earlier count has blinded; bins without such a pulse are left out. Other
    arguments: as `waveform-average`. Returns range, sigma [m] and valid (shot). Raises InputError for analog captures:
    they have no pile-up, and the method does not apply to them.
    """
    _check(reach, "waveform-coates")
    record = read_record(capture)
    if not record.single_photon:
        raise InputError(
            "An analog capture has no pile-up to correct.", where="attribute rig: detector.readout.kind",
            value="analog", allowed="single-photon", next_step="waveform-average",
        )  # fmt: skip
    rate, variance = coates_rate(record.z, record.pulses, record.dead)
    m = record.pulses[:, None]
    known = np.isfinite(rate)
    z, noise = np.where(known, rate * m, 0.0), np.where(known, variance * m * m, 0.0)
    corrected = replace(record, z=z, good=record.good & known)
    level, level_var = background_level(corrected, background, "waveform-coates")
    least = least_snr(record, min_snr, "waveform-coates")
    return _centroid(corrected, z, noise, level, level_var, reach, least)
