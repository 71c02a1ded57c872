"""Fits of an echo to a waveform: the start by a matched filter on a grid, and the weights of the samples."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..fit import Fit, Weigh, scoring
from .record import WaveformRecord

__all__ = ["even_weights", "fit_echo", "grid_start", "likelihood_weights"]

Float = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]

#: Spacing of the starting grid in standard deviations of the template.
_SPACING = 0.5
_LEAST = 1e-9


def grid_start(record: WaveformRecord) -> Float:
    """(shot, [τ, A, B]): the time of a grid at which the template, with the background projected out, gives the largest
    A/σ_A; NaN where no A is positive. Samples that are not good count as background."""
    low, high = record.window_s
    spacing = min(_SPACING * record.width_s, record.step_s)
    spacing = max(spacing, (high - low) / 4096)
    tau = np.arange(low, high + 0.5 * spacing, spacing)
    r, _ = record.template(tau)
    centred = r - r.mean(axis=1, keepdims=True)
    norm = np.sqrt((centred**2).sum(axis=1))
    usable = norm > 1e-6 * norm.max()
    tau, r, centred, norm = tau[usable], r[usable], centred[usable], norm[usable]
    level = np.where(record.good, record.z, 0).sum(axis=1) / np.maximum(record.good.sum(axis=1), 1)
    z = np.where(record.good, record.z, level[:, None])
    strength = (z @ centred.T) / norm
    best = np.argmax(strength, axis=1)
    a = np.take_along_axis(strength, best[:, None], 1)[:, 0] / norm[best]
    b = z.mean(axis=1) - a * r[best].mean(axis=1)
    return np.where((a > 0)[:, None], np.stack([tau[best], a, b], axis=1), np.nan)


def even_weights(record: WaveformRecord) -> Weigh:
    """Least squares: w = 1 on good samples; the variance of the samples enters the covariance only."""

    def weigh(mean: Float, rows: Rows) -> tuple[Float, Float, Float, Float]:
        w = record.good[rows].astype(np.float64)
        e = record.z[rows] - mean
        return 0.5 * (w * e * e).sum(axis=1), w, e, record.variance(mean)

    return weigh


def likelihood_weights(record: WaveformRecord) -> Weigh:
    """Weights of the likelihood.

    Analog samples: the shifted Poisson distribution y + s ~ Poisson(μ/F² + s), y = z/F², s = σ²/F⁴, which matches mean
    and variance (Snyder et al. 1995); a normal distribution where light adds no noise. Single-photon counts:
    n ~ Binomial(live, 1 − e^(−μ/M)), exact.
    """
    if record.live is not None:
        live_all, pulses = record.live, record.pulses

        def count(mean: Float, rows: Rows) -> tuple[Float, Float, Float, Float]:
            n, live, m = record.z[rows], live_all[rows], pulses[rows][:, None]
            rate = np.maximum(mean / m, 1e-12)
            p, q = -np.expm1(-rate), np.exp(-rate)
            good = record.good[rows]
            objective = -np.where(good, n * np.log(p) - (live - n) * rate, 0.0).sum(axis=1)
            w = np.where(good, live * q / (p * m * m), 0.0)
            with np.errstate(divide="ignore", invalid="ignore"):
                e = np.where(good, (n - live * p) * m / (live * q), 0.0)
                v = np.where(w > 0, 1.0 / w, 0.0)
            return objective, w, e, v

        return count
    if record.excess == 0:
        return even_weights(record)
    f2 = record.excess
    shift = record.floor_var / f2**2

    def weigh(mean: Float, rows: Rows) -> tuple[Float, Float, Float, Float]:
        rate = np.maximum(mean / f2 + shift, _LEAST)
        good = record.good[rows]
        y = record.z[rows] / f2 + shift
        objective = np.where(good, rate - y * np.log(rate), 0.0).sum(axis=1)
        v = f2 * f2 * rate
        return objective, np.where(good, 1.0 / v, 0.0), record.z[rows] - mean, v

    return weigh


def fit_echo(record: WaveformRecord, weigh: Weigh) -> Fit:
    """(τ, A, B) of μ_k = A R(τ − t_k) + B for every shot, from `grid_start`."""
    start = grid_start(record)
    shots = len(start)
    low_s, high_s = record.window_s
    low = np.tile([low_s - record.width_s, 0.0, record.least_mean], (shots, 1))
    high = np.tile([high_s + record.width_s, np.inf, np.inf], (shots, 1))

    def model(theta: Float, rows: Rows) -> tuple[Float, Float]:
        r, slope = record.template(theta[:, 0])
        a, b = theta[:, 1:2], theta[:, 2:3]
        return a * r + b, np.stack([a * slope, r, np.ones_like(r)])

    return scoring(model, weigh, start, low, high, np.array([0.7 * record.width_s, np.inf, np.inf]))
