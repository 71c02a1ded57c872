"""Power spectra of profiles: detrended, tapered, transformed. One-sided densities in m³ = m²/(cycle/m), but for the document's own.

Sources: Kusters 1992, sec. 5.5.2; F. J. Harris, Proc. IEEE 66:51, 1978 (Hann); D. J. Thomson, Proc. IEEE 70:1055, 1982
(multitaper); J. D. Scargle, Astrophysical Journal 263:835, 1982.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .profiles import Profile, Resampled

__all__ = ["Spectra", "detrended", "document_spectra", "lomb_scargle", "split_gaussian", "tapered_spectra"]

Float = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Spectra:
    """`power` (profile, k) [m³] at `frequency` (k) [cycles/m]. `spread`: variance of an estimate from all k together, over what it
    were if the powers were independent, N Σh⁴/(Σh²)² of the taper h (R. Dahlhaus, Stochastic Processes 15:1, 1983)."""

    frequency: Float
    power: Float
    spread: float


def detrended(height: Float) -> Float:
    """Rows less their line of least squares."""
    at = np.arange(height.shape[-1], dtype=np.float64)
    at -= at.mean()
    rest = height - height.mean(axis=-1, keepdims=True)
    return np.asarray(rest - (rest @ at / (at @ at))[..., None] * at)


def split_gaussian(count: int, share: float, sigmas: float) -> Float:
    """One in the middle; over `share` of the length at each end half of a Gaussian, which falls to exp(−sigmas²/2) at the end.

    Neither the length nor the width of the Gaussian is in the document: both are choices.
    """
    inward = np.minimum(np.arange(count), np.arange(count)[::-1]) / (count - 1.0)
    u = sigmas * np.clip(1.0 - inward / share, 0.0, None)
    return np.asarray(np.exp(-0.5 * u * u))


def document_spectra(profiles: Resampled, taper: Float) -> Spectra:
    """As printed: detrend, taper, transform, times its conjugate, over the length: |Δ Σ w h e^(−2πifs)|²/L at f = k/L.

    Two-sided, and without the taper's loss of power Σw²/n: both halve the level at least, and leave the slope.
    """
    n = profiles.height.shape[1]
    wave = np.fft.rfft(taper * detrended(profiles.height), axis=1)[:, 1:]
    length = n * profiles.interval_m
    power = np.abs(profiles.interval_m * wave) ** 2 / length
    return Spectra(np.asarray(np.fft.rfftfreq(n, profiles.interval_m)[1:], np.float64), power, _spread(taper))


def tapered_spectra(profiles: Resampled, tapers: Float) -> Spectra:
    """One-sided densities of equally spaced profiles, the mean over the rows of `tapers` (taper, n), at f = k/L."""
    n = profiles.height.shape[1]
    unit = tapers / np.sqrt((tapers**2).sum(axis=1, keepdims=True))
    flat = detrended(profiles.height)
    power = np.zeros((flat.shape[0], n // 2))
    for one in unit:
        power += 2.0 * profiles.interval_m * np.abs(np.fft.rfft(one * flat, axis=1)[:, 1 : n // 2 + 1]) ** 2 / len(unit)
    if n % 2 == 0:
        power[:, -1] *= 0.5  # the Nyquist frequency is its own mirror image
    return Spectra(
        np.asarray(np.fft.rfftfreq(n, profiles.interval_m)[1 : n // 2 + 1], np.float64),
        power,
        _spread(np.sqrt((unit**2).mean(axis=0))),
    )


def lomb_scargle(profiles: Sequence[Profile], count: int) -> Spectra:
    """The periodogram of sines fitted to the points where they lie, under a Hann taper; nothing is interpolated.

    One grid of frequencies for all profiles: k/L of the shortest, up to half of the least average rate of points.
    """
    from scipy.signal import lombscargle

    interval = min(profile.interval_m for profile in profiles)
    longest = max(profile.interval_m for profile in profiles)
    f = np.arange(1, count // 2 + 1) / (count * interval)
    f = f[f <= 0.5 / longest]
    rows = []
    for profile in profiles:
        at = profile.along - profile.along[0]
        taper = np.sin(np.pi * at / profile.length_m) ** 2
        basis = np.stack([np.ones_like(at), at], axis=1)
        flat = profile.height - basis @ np.linalg.lstsq(basis, profile.height, rcond=None)[0]
        held = taper * flat * np.sqrt(at.size / (taper**2).sum())
        rows.append(2.0 * profile.interval_m * lombscargle(at, held, 2.0 * np.pi * f))
    return Spectra(f, np.array(rows), 35.0 / 18.0)


def _spread(taper: Float) -> float:
    return float(taper.size * (taper**4).sum() / (taper**2).sum() ** 2)
