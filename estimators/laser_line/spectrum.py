"""Slope and level of the roughness spectrum of a surveyed surface, from the profiles of all frames of a capture."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..registry import estimator
from ..result import stage_result
from ..rig import DeclaredRig
from .likelihoods import Fit
from .periodograms import document_spectra, lomb_scargle, split_gaussian, tapered_spectra
from .profiles import Profile, levelled, profiles_of, resampled, selected
from .slopes import line_of_spectrum, power_law_of_points, power_law_of_spectrum

__all__ = [
    "POINTS", "fit_hann", "fit_kusters", "fit_lomb_scargle", "fit_multitaper", "fit_reml", "spectrum_hann", "spectrum_kusters",
    "spectrum_lomb_scargle", "spectrum_multitaper", "spectrum_reml",
]  # fmt: skip

Float = npt.NDArray[np.float64]

#: Points of a resampled profile, and the least of a selected one (Kusters 1992, sec. 5.5.1).
POINTS = 128
#: The lowest frequencies hold what detrending and taper left of them: the first two of 1/L, 2/L, … are not used for the line, and
#: as many more as a taper's width for the likelihood: its mean over the width exceeds a steep law by γ(γ + 1)/6k² there.
_FIRST, _WIDTH = 2, 2
#: Least number of profiles whose scatter tells of an error.
_LEAST_PROFILES = 4
#: Decibels per natural unit of a density.
_DB = 10.0 / np.log(10.0)


def fit_kusters(profiles: list[Profile], *, share: float = 0.25, sigmas: float = 2.5) -> Fit:
    """Resampled, detrended, split-Gaussian taper, transform, mean over profiles; a straight line through all of its logarithm."""
    even = resampled(profiles, POINTS)
    return line_of_spectrum(document_spectra(even, split_gaussian(POINTS, share, sigmas)), _FIRST)


def fit_hann(profiles: list[Profile], *, share: float = 0.5) -> Fit:
    """Resampled, Hann taper, power law and noise floor by Whittle's likelihood below `share` of the highest frequency."""
    even = resampled(profiles, POINTS)
    taper = np.sin(np.pi * (np.arange(POINTS) + 0.5) / POINTS) ** 2
    spectra = tapered_spectra(even, taper[None])
    return power_law_of_spectrum(
        spectra, 2.0 * even.noise_m2 * even.interval_m, _FIRST + _WIDTH, int(share * POINTS / 2)
    )


def fit_multitaper(profiles: list[Profile], *, share: float = 0.5, bandwidth: float = 2.5) -> Fit:
    """As Hann's with the 2·`bandwidth` − 1 orthogonal tapers that concentrate within `bandwidth`/L.

    The lowest frequencies, twice that wide, are not used.
    """
    from scipy.signal.windows import dpss

    even = resampled(profiles, POINTS)
    spectra = tapered_spectra(even, dpss(POINTS, bandwidth, int(2 * bandwidth) - 1))
    first = _FIRST + int(np.ceil(2 * bandwidth))
    return power_law_of_spectrum(spectra, 2.0 * even.noise_m2 * even.interval_m, first, int(share * POINTS / 2))


def fit_lomb_scargle(profiles: list[Profile], *, share: float = 0.5) -> Fit:
    """As Hann's, without resampling."""
    spectra = lomb_scargle(profiles, POINTS)
    noise = float(np.mean([2.0 * np.mean(profile.sigma**2) * profile.interval_m for profile in profiles]))
    return power_law_of_spectrum(spectra, noise, _FIRST + _WIDTH, int(share * spectra.frequency.size))


def fit_reml(profiles: list[Profile], *, aperture: float = 0.0) -> Fit:
    """Restricted likelihood of the points themselves, from Hann's line."""
    even = resampled(profiles, POINTS)
    taper = np.sin(np.pi * (np.arange(POINTS) + 0.5) / POINTS) ** 2
    line = line_of_spectrum(tapered_spectra(even, taper[None]), _FIRST).place
    return power_law_of_points(profiles, (float(line[0]), float(line[1])), aperture)


@estimator("spectrum", cites="Kusters 1992, sec. 5.5 (taper's constants and the line are choices)", joint=True)
def spectrum_kusters(
    points: xr.Dataset, rig: DeclaredRig, *, least_points: int = POINTS, most_gap: float = 5.0, share: float = 0.25,
    sigmas: float = 2.5,
) -> xr.Dataset:  # fmt: skip
    """The document's procedure. `share`, `sigmas`: see `split_gaussian`. Returns slope, sigma and level [dB re 1 m³ at 10
    cycles/m], which is the document's own density: two-sided, less what the taper takes."""
    return _answer(
        points, rig, least_points, most_gap, lambda held: fit_kusters(held, share=share, sigmas=sigmas), level=False
    )


@estimator(
    "spectrum", cites="F. J. Harris, Proc. IEEE 66:51, 1978; P. Whittle, Arkiv för Matematik 2:423, 1953", joint=True
)
def spectrum_hann(
    points: xr.Dataset, rig: DeclaredRig, *, least_points: int = POINTS, most_gap: float = 5.0, share: float = 0.5
) -> xr.Dataset:
    """Hann taper of resampled profiles, power law with noise floor up to `share` of the highest frequency."""
    return _answer(points, rig, least_points, most_gap, lambda held: fit_hann(held, share=share))


@estimator(
    "spectrum", cites="D. J. Thomson, Proc. IEEE 70:1055, 1982; P. Whittle, Arkiv för Matematik 2:423, 1953", joint=True
)
def spectrum_multitaper(
    points: xr.Dataset, rig: DeclaredRig, *, least_points: int = POINTS, most_gap: float = 5.0, share: float = 0.5,
    bandwidth: float = 2.5,
) -> xr.Dataset:  # fmt: skip
    """Slepian tapers of resampled profiles, power law with noise floor up to `share` of the highest frequency."""
    return _answer(
        points, rig, least_points, most_gap, lambda held: fit_multitaper(held, share=share, bandwidth=bandwidth)
    )


@estimator(
    "spectrum",
    cites="J. D. Scargle, Astrophysical Journal 263:835, 1982; P. Whittle, Arkiv för Matematik 2:423, 1953",
    joint=True,
)
def spectrum_lomb_scargle(
    points: xr.Dataset, rig: DeclaredRig, *, least_points: int = POINTS, most_gap: float = 5.0, share: float = 0.5
) -> xr.Dataset:
    """Periodogram of the points where they lie, Hann taper, power law with noise floor."""
    return _answer(points, rig, least_points, most_gap, lambda held: fit_lomb_scargle(held, share=share))


@estimator("spectrum", cites="P. K. Kitanidis, Water Resources Research 19:909, 1983; G. Matheron 1973", joint=True)
def spectrum_reml(
    points: xr.Dataset, rig: DeclaredRig, *, least_points: int = POINTS, most_gap: float = 5.0, aperture: float = 1.0
) -> xr.Dataset:
    """Restricted likelihood of the points as a Gaussian power law with noise; each is an average over `aperture` intervals (a
    row's height is the mean over the row)."""
    return _answer(points, rig, least_points, most_gap, lambda held: fit_reml(held, aperture=aperture))


def _answer(
    points: xr.Dataset, rig: DeclaredRig, least_points: int, most_gap: float, fit: Callable[[list[Profile]], Fit], *,
    level: bool = True,
) -> xr.Dataset:  # fmt: skip
    """Slope and level of one survey; invalid with too few profiles, and where no greatest likelihood lies within the limits.

    `level`: whether profiles are turned level first, so that the level is that square to the surface.
    """
    profiles = selected(profiles_of(points, rig), least_points, most_gap)
    if level:
        profiles = [levelled(profile) for profile in profiles]
    place, spread, found = np.full(2, np.nan), np.full(2, np.nan), False
    if len(profiles) >= _LEAST_PROFILES:
        made = fit(profiles)
        place, spread, found = made.place[:2], np.sqrt(np.diag(made.covariance)[:2]), made.found
    one = {"slope": place[:1], "sigma": spread[:1], "valid": np.array([found])}
    other = {"level": _DB * place[1:], "sigma_level": _DB * spread[1:], "valid_level": np.array([found])}
    return stage_result("spectrum", **one, **other)
