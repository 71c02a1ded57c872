"""Gaussian fit: the echo as a Gaussian of free width, whatever the true form of the response."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..fit import scoring
from ..registry import estimator
from ..result import range_result
from .background import least_snr
from .per_pulse import per_pulse
from .record import read_record
from .start import even_weights, grid_start

__all__ = ["waveform_gaussian"]

Float = npt.NDArray[np.float64]


@estimator("waveform", cites="Wagner et al., ISPRS J. Photogramm. 60:100, 2006 (Gaussian decomposition)")
@per_pulse
def waveform_gaussian(capture: xr.Dataset, *, min_snr: float | None = None) -> xr.Dataset:
    """Least squares of A exp(−(t − t₀)²/2s²) + B over (t₀, s, A, B); τ = t₀ − lag of the centroid of the response.

    A tail of the response that a Gaussian cannot follow pulls t₀; sigma does not contain this bias.
    Other arguments: min_snr: least A in its standard errors (null: 4, and 0 for single photons).
    Returns range, sigma [m] and valid (shot). Raises InputError for a negative min_snr.
    """
    record = read_record(capture)
    least = least_snr(record, min_snr, "waveform-gaussian")
    begin = grid_start(record)
    width = record.width_s
    shots = len(begin)
    peak = record.share.peak
    start = np.stack([begin[:, 0] + record.centroid_s, np.full(shots, width), begin[:, 1] * peak, begin[:, 2]], axis=1)
    first, last = float(record.time_s[0]), float(record.time_s[-1])
    low = np.tile([first - width, 0.2 * width, 0.0, -np.inf], (shots, 1))
    high = np.tile([last + width, max(5.0 * width, record.step_s), np.inf, np.inf], (shots, 1))

    def model(theta: Float, rows: npt.NDArray[np.intp]) -> tuple[Float, Float]:
        t0, s, a, b = (theta[:, i : i + 1] for i in range(4))
        x = (record.time_s[None, :] - t0) / s
        shape = np.exp(-0.5 * x * x)
        return a * shape + b, np.stack([a * shape * x / s, a * shape * x * x / s, shape, np.ones_like(shape)])

    fit = scoring(model, even_weights(record), start, low, high, np.array([0.7 * width, 0.5 * width, np.inf, np.inf]))
    t0, height = fit.value[:, 0], fit.value[:, 2]
    sigma, sigma_height = np.sqrt(fit.variance[:, 0]), np.sqrt(fit.variance[:, 2])
    with np.errstate(invalid="ignore"):
        found = record.usable & fit.settled & (height > least * sigma_height) & (sigma < width)
        found &= (t0 > first) & (t0 < last)
    return range_result(record.range_m(t0 - record.centroid_s), sigma * record.m_per_s, found)
