"""Maximum likelihood over all frequencies at once: the whole numbers of cycles of all frequencies are decided jointly."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...scenes.errors import InputError
from ..fit import scoring
from ..registry import estimator
from ..result import range_result
from .samples import AmcwSamples, Phasors, phasors, read_samples

__all__ = ["amcw_ml"]

Float = npt.NDArray[np.float64]

#: Candidate times per cycle of the highest frequency: half a step off, 15° of phase, the height loses at most 3.4 %.
_PER_CYCLE = 12
#: Products of phasors in one block of shots.
_PRODUCTS = 1 << 22
_MOST_CANDIDATES = 1 << 20


def _candidates(samples: AmcwSamples, found: Phasors) -> tuple[Float, Float]:
    """(best τ (shot), its lead in log-likelihood over all other cycles (shot)).

    With one height D for all F frequencies, least squares gains n P²/(2F) at τ, P(τ) = Σ_f Re D_f exp(−iω_f(τ − t₀)):
    P needs no whole number of cycles, so that its maximum decides all of them jointly.
    """
    low, high = (edge / samples.m_per_s for edge in samples.window_m)
    top = float(samples.frequency_hz[-1])
    count = int(np.ceil((high - low) * top * _PER_CYCLE)) + 1
    if count > _MOST_CANDIDATES:
        raise InputError(
            "The range window is too long for the shortest wavelength: there are too many candidate times.",
            where="amcw-ml", value=count, allowed=f"up to {_MOST_CANDIDATES}", next_step="narrow rig.range_window_m",
        )  # fmt: skip
    tau = np.linspace(low, high, max(count, 2))
    omega = 2 * np.pi * samples.frequency_hz
    turns = np.exp(-1j * omega[:, None] * (tau - samples.t0_s))
    best, lead = np.full(len(samples.z), np.nan), np.zeros(len(samples.z))
    share = samples.phase_rad.size / (4 * omega.size)
    piece = max(1, _PRODUCTS // tau.size)
    noise = (found.variance * samples.phase_rad.size / 2).mean(axis=1)
    weight = np.where(found.sound, found.value, 0.0)
    for begin in range(0, len(best), piece):
        rows = slice(begin, begin + piece)
        height = np.maximum((weight[rows] @ turns).real, 0.0)
        at = np.argmax(height, axis=1)
        first = np.take_along_axis(height, at[:, None], 1)[:, 0]
        best[rows] = np.where(first > 0, tau[at], np.nan)
        # All times within half a cycle of the best belong to the same candidate.
        same = np.abs(np.arange(tau.size)[None, :] - at[:, None]) <= _PER_CYCLE // 2
        second = np.where(same, 0.0, height).max(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            lead[rows] = share * (first**2 - second**2) / noise[rows]
    return best, lead


@estimator(
    "amcw",
    cites="Joint likelihood of several phases: Gudmundson, Larsson and Stoica, IEEE JSTSP 9:1515, 2015 (not verified)",
)
def amcw_ml(capture: xr.Dataset, *, min_gap: float = 4.6, min_snr: float = 4.0) -> xr.Dataset:
    """Maximum likelihood of μ = M + D cos(ω_f(τ − t₀) − φ_k) over (τ, M, D), from all frequencies and phases.

    The start is the best of all whole numbers of cycles in the declared window, decided jointly over the frequencies;
    Fisher scoring with Poisson and read noise follows. Other arguments: min_gap: least lead in log-likelihood over every
    other whole number of cycles; with a smaller one no answer is given (4.6: odds of 100 to 1). min_snr: least D in its
    standard errors.
    Returns range, sigma [m] (from the Fisher information, M and D profiled) and valid (shot). Raises InputError for
    negative parameters and for a window with too many candidates.
    """
    if min_gap < 0 or min_snr < 0:
        raise InputError(
            "A parameter is negative.", where="amcw-ml[min_gap, min_snr]", value=(min_gap, min_snr), allowed=">= 0"
        )
    samples = read_samples(capture)
    found = phasors(samples)
    tau, lead = _candidates(samples, found)
    shots = len(tau)
    omega = 2 * np.pi * samples.frequency_hz
    z, good = samples.z.reshape(shots, -1), (samples.good & found.sound[..., None]).reshape(shots, -1)
    mean = np.where(good, z, 0).sum(axis=1) / np.maximum(good.sum(axis=1), 1)
    height = np.abs(found.value).mean(axis=1)
    start = np.stack([tau, mean, height], axis=1)
    start[~found.sound.any(axis=1)] = np.nan
    half = 0.5 / float(samples.frequency_hz[-1])
    low = np.stack([tau - half, np.zeros(shots), np.zeros(shots)], axis=1)
    high = np.stack([tau + half, np.full(shots, np.inf), np.full(shots, np.inf)], axis=1)

    def model(theta: Float, rows: npt.NDArray[np.intp]) -> tuple[Float, Float]:
        turn = omega[None, :, None] * (theta[:, 0, None, None] - samples.t0_s) - samples.phase_rad
        flat = (len(theta), z.shape[1])
        cos, sin = np.cos(turn).reshape(flat), np.sin(turn).reshape(flat)
        rate = np.repeat(omega, samples.phase_rad.size)
        d = theta[:, 2:3]
        return theta[:, 1:2] + d * cos, np.stack([-d * rate * sin, np.ones_like(cos), cos])

    shift = samples.floor_var

    def weigh(mu: Float, rows: npt.NDArray[np.intp]) -> tuple[Float, Float, Float, Float]:
        rate = np.maximum(mu + shift, 1e-9)
        objective = np.where(good[rows], rate - (z[rows] + shift) * np.log(rate), 0.0).sum(axis=1)
        return objective, np.where(good[rows], 1.0 / rate, 0.0), z[rows] - mu, rate

    fit = scoring(model, weigh, start, low, high, np.array([0.2 * half, np.inf, np.inf]))
    sigma = np.sqrt(fit.variance[:, 0])
    with np.errstate(invalid="ignore"):
        valid = samples.usable & fit.settled & (lead > min_gap)
        valid &= fit.value[:, 2] > min_snr * np.sqrt(fit.variance[:, 2])
    return range_result(fit.value[:, 0] * samples.m_per_s, sigma * samples.m_per_s, valid)
