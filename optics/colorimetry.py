"""Photometry and colour of spectra, by colour-science: standard illuminants, lux, and sRGB (CIE 1931 2°, IEC 61966-2-1).

colour-science is imported on first use: it takes a second.
"""

from __future__ import annotations

import warnings
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .correlation.parts import Array

__all__ = [
    "encode_srgb", "illuminant_names", "illuminant_spectrum", "illuminance_of", "linear_srgb_of_line",
    "linear_srgb_of_spectrum", "shown_colour",
]  # fmt: skip

#: Wavelengths of the standard observer, m.
VISIBLE_M = (360e-9, 830e-9)


@lru_cache(maxsize=1)
def _colour() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns of optional packages that are not needed here
        import colour
    return colour


def illuminant_names() -> tuple[str, ...]:
    """Names of the standard illuminants: A, D50, D65, E, FL1 …, HP1 …, LED-B1 … (CIE 15:2018)."""
    return tuple(str(name) for name in _colour().SDS_ILLUMINANTS)


def illuminant_spectrum(name: str) -> tuple[Array, Array]:
    """(wavelength in m, relative spectral power) of a standard illuminant, as tabulated. ValueError for an unknown name."""
    table = _colour().SDS_ILLUMINANTS
    if name not in illuminant_names():
        raise ValueError(f"There is no illuminant {name!r}. Illuminants: {', '.join(illuminant_names())}")
    found = table[name]
    return np.asarray(found.wavelengths, np.float64) * 1e-9, np.asarray(found.values, np.float64)


def illuminance_of(wavelength_m: ArrayLike, irradiance: ArrayLike) -> float:
    """683 lm/W ∫ E V dλ, lux, of a spectral irradiance in W/(m² m), V(λ) of CIE 1924 at 1 nm.

    The trapezoid rule on the union of the spectrum's own grid and the 1 nm grid of V: exact for a linear spectrum.
    """
    colour = _colour()
    v = colour.SDS_LEFS["CIE 1924 Photopic Standard Observer"]
    at = np.asarray(v.wavelengths, np.float64) * 1e-9
    wave = np.asarray(wavelength_m, np.float64)
    grid = np.union1d(wave, at[(at > wave[0]) & (at < wave[-1])])
    power = np.interp(grid, wave, np.asarray(irradiance, np.float64))
    seen = np.interp(grid, at, np.asarray(v.values, np.float64), left=0.0, right=0.0)
    return float(683.0 * np.trapezoid(power * seen, grid))


def linear_srgb_of_line(wavelength_m: float) -> Array:
    """Linear sRGB (3,) of monochromatic light at Y = 1; components are negative where the colour is out of gamut.

    Raises ValueError outside 360 … 830 nm, the range of the standard observer.
    """
    colour = _colour()
    nm = 1e9 * float(wavelength_m)
    if not VISIBLE_M[0] <= wavelength_m <= VISIBLE_M[1]:
        raise ValueError(f"Light of {nm:g} nm is invisible; the standard observer covers 360 to 830 nm.")
    xyz = np.asarray(colour.wavelength_to_XYZ(nm), np.float64)
    return np.asarray(_to_linear(xyz / xyz[1]))


def linear_srgb_of_spectrum(wavelength_m: ArrayLike, power: ArrayLike) -> Array:
    """Linear sRGB (3,) of a spectrum, scaled to Y = 1. Raises ValueError for one without visible light."""
    colour = _colour()
    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    at = np.asarray(cmfs.wavelengths, np.float64) * 1e-9
    spectrum = np.interp(at, np.asarray(wavelength_m, np.float64), np.asarray(power, np.float64), left=0.0, right=0.0)
    xyz = spectrum @ np.asarray(cmfs.values, np.float64)
    if not xyz[1] > 0.0:
        raise ValueError("The spectrum has no visible light.")
    return np.asarray(_to_linear(xyz / xyz[1]))


def _to_linear(xyz: Array) -> Any:
    return _colour().XYZ_to_sRGB(xyz, apply_cctf_encoding=False)


def shown_colour(linear: ArrayLike) -> Array:
    """A colour in gamut: negative components become 0, the largest becomes 1 (the hue is nearly kept)."""
    inside = np.maximum(np.asarray(linear, np.float64), 0.0)
    return np.asarray(inside / inside.max())


def encode_srgb(linear: ArrayLike) -> np.ndarray:
    """Linear light 0 … 1 (clipped) to 8-bit sRGB."""
    encoded = _colour().cctf_encoding(np.clip(np.asarray(linear, np.float64), 0.0, 1.0), function="sRGB")
    return np.asarray(np.rint(255.0 * np.asarray(encoded)), dtype=np.uint8)
