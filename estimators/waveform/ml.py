"""Maximum likelihood and matched filter: time, height and background of one echo in every waveform."""

from __future__ import annotations

import numpy as np
import xarray as xr

from ..fit import Fit
from ..registry import estimator
from ..result import range_result
from .background import least_snr
from .per_pulse import per_pulse
from .record import WaveformRecord, read_record
from .start import even_weights, fit_echo, likelihood_weights

__all__ = ["waveform_matched", "waveform_ml"]


def _answer(record: WaveformRecord, fit: Fit, min_snr: float | None, where: str) -> xr.Dataset:
    least = least_snr(record, min_snr, where)
    tau, height = fit.value[:, 0], fit.value[:, 1]
    sigma_tau, sigma_height = np.sqrt(fit.variance[:, 0]), np.sqrt(fit.variance[:, 1])
    low, high = record.window_s
    with np.errstate(invalid="ignore"):
        found = record.usable & fit.settled & (height > least * sigma_height) & (sigma_tau < record.width_s)
        found &= (tau > low) & (tau < high)
    return range_result(record.range_m(tau), sigma_tau * record.m_per_s, found)


@estimator(
    "waveform",
    cites="Fisher scoring: Osborne, Int. Stat. Rev. 60:99, 1992; read noise: Snyder et al., JOSA A 12:272, 1995",
)
@per_pulse
def waveform_ml(capture: xr.Dataset, *, min_snr: float | None = None) -> xr.Dataset:
    """Maximum likelihood of μ_k = A R(τ − t_k) + B over (τ, A, B), R from the samples of the declared response.

    Analog samples are Poisson distributed with read noise (shifted Poisson approximation); single-photon histograms have
    the exact binomial likelihood of their live pulses, so that pile-up is part of the model. Clipped samples are left out.
    Other arguments: min_snr: least A in its standard errors; a weaker echo is not answered (null: 4, and 0
    for single photons).
    Returns range, sigma [m] (from the Fisher information, A and B profiled) and valid (shot). Raises InputError for a
    negative min_snr.
    """
    record = read_record(capture)
    return _answer(record, fit_echo(record, likelihood_weights(record)), min_snr, "waveform-ml")


@estimator("waveform", cites="Turin, IRE Trans. Inf. Theory 6:311, 1960 (matched filter)")
@per_pulse
def waveform_matched(capture: xr.Dataset, *, min_snr: float | None = None) -> xr.Dataset:
    """Matched filter: the τ that maximises the correlation of the samples with R(τ − t_k), background projected out.

    This is unweighted least squares over (τ, A, B), optimal for noise of equal strength in all samples. sigma propagates
    the noise of the samples through the filter. Arguments, result and errors as `waveform-ml`.
    """
    record = read_record(capture)
    return _answer(record, fit_echo(record, even_weights(record)), min_snr, "waveform-matched")
