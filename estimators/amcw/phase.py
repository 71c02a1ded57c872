"""Phase comparison: at one frequency, and by a ladder of wavelengths in ratios of ten."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.amcw import distance_eq24, part_wave_eq25, whole_cycles
from ...scenes.errors import InputError
from ..registry import estimator
from ..result import range_result
from .samples import AmcwSamples, Phasors, phasors, read_samples

__all__ = ["amcw_decade", "amcw_phase"]

Float = npt.NDArray[np.float64]


def _least(samples: AmcwSamples, found: Phasors, at: int) -> Float:
    """Distance by Eq. 2.4 with the least n that puts it into the declared window."""
    wave = float(samples.wavelength_m[at])
    part = part_wave_eq25(found.phase[:, at], 0.0, wave)
    n = np.ceil((2 * samples.window_m[0] - part) / wave)
    return distance_eq24(np.maximum(n, 0.0), part, wave)


def _sigma(samples: AmcwSamples, found: Phasors, at: int) -> Float:
    """Standard error of range from the noise of the phase, λ_m σ_φ/4π."""
    with np.errstate(divide="ignore", invalid="ignore"):
        phase = np.sqrt(found.variance[:, at]) / np.abs(found.value[:, at])
        return np.asarray(samples.wavelength_m[at] * phase / (4 * np.pi))


def _answer(samples: AmcwSamples, found: Phasors, distance: Float, used: list[int], min_snr: float) -> xr.Dataset:
    with np.errstate(invalid="ignore"):
        strong = np.abs(found.value[:, used]) > min_snr * np.sqrt(found.variance[:, used])
        inside = (distance >= samples.window_m[0]) & (distance <= samples.window_m[1])
    valid = samples.usable & (found.sound[:, used] & strong).all(axis=1) & inside
    return range_result(distance, _sigma(samples, found, used[-1]), valid)


@estimator("amcw", cites="Kusters 1992, Eq. 2.4-2.5 and Figure 2.3 (phase comparison)")
def amcw_phase(capture: xr.Dataset, *, frequency: int = -1, min_snr: float = 4.0) -> xr.Dataset:
    """2D = nλ_m + Δλ_m, Δλ_m = ΔΦ/2π·λ_m (Eq. 2.4, 2.5) at one frequency, n the least that the window allows.

    The answer is ambiguous: a target more than half a modulation wavelength beyond the near end of the window is answered
    too near. Other arguments: frequency: index of the frequency in ascending order; −1 is the highest, the most precise
    and the most ambiguous one. min_snr: least modulation in its standard errors.
    Returns range, sigma [m] and valid (shot). Raises InputError where there is no such frequency.
    """
    samples = read_samples(capture)
    total = samples.frequency_hz.size
    if not -total <= frequency < total:
        raise InputError(
            "There is no such frequency.",
            where="amcw-phase[frequency]",
            value=frequency,
            allowed=f"{-total} … {total - 1}",
        )
    found = phasors(samples)
    at = frequency % total
    return _answer(samples, found, _least(samples, found, at), [at], min_snr)


@estimator("amcw", cites="Kusters 1992, section 2.2.3.2 (ambiguity resolved by wavelengths in ratios of ten)")
def amcw_decade(capture: xr.Dataset, *, min_snr: float = 4.0) -> xr.Dataset:
    """The longest wavelength gives a coarse D'; each shorter one takes n = round((2D' − Δλ_m)/λ_m) and gives a finer D.

    A step fails where the coarser distance errs by more than λ_m/4: with a ratio of ten between wavelengths, where the
    coarser phase errs by more than 18°. The failure is not detected, and stays in the answer. sigma is that of the finest
    phase. Other arguments: min_snr: least modulation at every frequency, in its standard errors.
    Returns range, sigma [m] and valid (shot).
    """
    samples = read_samples(capture)
    found = phasors(samples)
    distance = _least(samples, found, 0)
    for at in range(1, samples.frequency_hz.size):
        wave = float(samples.wavelength_m[at])
        part = part_wave_eq25(found.phase[:, at], 0.0, wave)
        distance = distance_eq24(whole_cycles(distance, part, wave), part, wave)
    return _answer(samples, found, distance, list(range(samples.frequency_hz.size)), min_snr)
