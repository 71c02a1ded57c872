"""Scans: mean signals over a window of delays, from which the threshold follows, in one form for all modalities.

Sample k of an element at delay θ (of the light from laser to target to camera, s) has the mean μ_k(θ) = α r_k(θ) + β q_k,
with α the element's amplitude, β its background and q the shape of the background (mean 1):

    gated      r = R(θ − t_k)                                     one element per pixel
    waveform   r = R(θ + Δ − t_k + step/2)                        one per shot
    amcw       r = 1 + ½ m d cos(ω_f (θ − t0) − φ_k), q = 1       one per shot

Samples are taken as independent, each with the exact likelihood of its detector. Single-photon counts are taken as Poisson
counts without pile-up, which only matters for strong light, far above any threshold.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.correlation import response as correlation
from ...optics.likelihood.fisher_table import information_table
from ...optics.likelihood.model import NoiseModel
from ...scenes.errors import InputError

__all__ = ["PER_WIDTH", "Elements", "Scan", "Shapes", "levels", "make_scan", "need_truth", "table_shapes"]

Float = npt.NDArray[np.float64]
Shapes = Callable[[Float], tuple[Float, Float, Float]]

PER_WIDTH = 6.0  # delays per width; closed forms between them resolve Gaussian and rectangular R
_MOST_DELAYS = 3601


@dataclass(frozen=True)
class Scan:
    """`shapes`: θ -> r and its two derivatives (θ, sample). `share` (sample): q. `window_s`: first and last delay of the
    prior; `searched_s`: the same, or a part of it if the window is longer than 600 widths. `width_s`: σ_R, or 1/(f√12) of the
    highest modulation frequency. `noise`: None for Poisson counts. `key`: hash of all this."""

    shapes: Shapes
    share: Float
    window_s: tuple[float, float]
    searched_s: tuple[float, float]
    width_s: float
    noise: NoiseModel | None
    key: str

    def grid(self, per_width: float = PER_WIDTH) -> Float:
        """Uniform delays over `searched_s`, at least `per_width` per width, s."""
        low, high = self.searched_s
        return np.linspace(low, high, math.ceil(per_width * (high - low) / self.width_s - 1e-9) + 1)

    def information(self, mu: Float) -> Float:
        """J(μ) of one sample, 1/electron²; 0 without any light."""
        if self.noise is not None:
            return np.asarray(information_table(self.noise)(mu), np.float64)
        return np.where(mu > 0.0, 1.0 / np.where(mu > 0.0, mu, 1.0), 0.0)

    def poisson_mean(self, mu: Float) -> Float:
        """Means of the Poisson counts that match mean and variance: with V = F²μ + v, y/F² + v/F⁴, v the variance
        without light, photoelectrons²."""
        if self.noise is None:
            return np.maximum(mu, 1e-9)
        noise = self.noise
        floor = noise.dark_e + noise.read_noise_e**2 + 1.0 / (12.0 * noise.gain_dn_per_e**2)
        excess = noise.excess_noise_factor
        return np.maximum(mu / excess + floor / (noise.intensifier_gain * excess) ** 2, 1e-9)


@dataclass(frozen=True)
class Elements:
    """Delay [s] (NaN without truth), amplitude and background level [photoelectrons] per element, and metres per second."""

    delay_s: Float
    amplitude: Float
    level: Float
    scale_m_per_s: float


def make_scan(
    shapes: Shapes, share: Float, window: tuple[float, float], width: float, noise: NoiseModel | None, delay: Float
) -> Scan:
    """A scan of these samples; see `Scan` for the arguments. `delay`: delays of the elements, s, which
    decide where a long window is searched."""
    searched, most = window, (_MOST_DELAYS - 1) / PER_WIDTH * width
    if window[1] - window[0] > most:
        # A smaller window has fewer wrong cells, so that the bound remains valid. It is centred so that it contains the echoes.
        seen = delay[np.isfinite(delay)]
        middle = float(np.median(seen)) if seen.size else 0.5 * (window[0] + window[1])
        low = min(max(middle - 0.5 * most, window[0]), window[1] - most)
        searched = (low, low + most)
    known = hashlib.sha256(repr((searched, window, width, noise)).encode())
    probe = np.linspace(*searched, 97)
    for part in (share, shapes(probe)[0]):
        known.update(np.ascontiguousarray(part).tobytes())
    return Scan(shapes, share, window, searched, width, noise, known.hexdigest())


def table_shapes(tables: list[correlation.Table], which: npt.NDArray[np.int64], at: Float, width: float) -> Shapes:
    """Shapes R(θ − at_k) from the table of each sample; slope and curvature by differences."""

    def shapes(theta: Float) -> tuple[Float, Float, Float]:
        u = theta[:, None] - at
        r, slope, bend = np.zeros(u.shape), np.zeros(u.shape), np.zeros(u.shape)
        tiny, small = 1e-4 * width, 0.05 * width  # a second difference must span several cells of the table
        for g, table in enumerate(tables):
            its = which == g
            r[:, its] = np.maximum(correlation.lookup(table, u[:, its]), 0.0)
            ends = correlation.lookup(table, u[:, its] + tiny), correlation.lookup(table, u[:, its] - tiny)
            slope[:, its] = (ends[0] - ends[1]) / (2.0 * tiny)
            sides = correlation.lookup(table, u[:, its] + small) + correlation.lookup(table, u[:, its] - small)
            bend[:, its] = (sides - 2.0 * r[:, its]) / small**2
        return r, slope, bend

    return shapes


def levels(background: Float) -> tuple[Float, Float]:
    """Shape over samples (mean 1) and level per element of a background (sample, …)."""
    level = background.mean(axis=0)
    shape = background.reshape(background.shape[0], -1).mean(axis=1)
    mean = float(shape.mean())
    return (shape / mean if mean > 0 else np.ones(shape.size)), np.asarray(level)


def need_truth(capture: xr.Dataset, *names: str) -> None:
    """Raise InputError if a capture lacks one of these variables."""
    if any(name not in capture for name in names):
        raise InputError("The capture does not hold the truth of its light.", where=", ".join(names))
