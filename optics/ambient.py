"""Ambient light: from the spectrum of a lamp or the sky, through water, filter and quantum efficiency, to photoelectrons.

Spectra are arrays over `wavelength_m` (increasing); spectral irradiance in W/m² per m of wavelength. Sources: Planck's law;
CIE daylight (CIE 15:2004, eq. 3.1-3.4 and table T.2); CIE 1924 V(λ) (CIE 18.2) turns lux into watts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .constants import C_M_PER_S, PLANCK_J_S
from .correlation.parts import Array

__all__ = [
    "band_filter", "daylight_spectrum", "diffuse_attenuation", "diffuse_radiance", "illuminance_lux",
    "photoelectron_rate", "planck_radiance", "scaled_to_lux", "through",
]  # fmt: skip

_BOLTZMANN_J_K = 1.380_649e-23
_LUMEN_PER_W = 683.0

# CIE 15:2004, table T.2, 300 to 830 nm in steps of 10 nm.
_S0 = (
    0.04, 6, 29.6, 55.3, 57.3, 61.8, 61.5, 68.8, 63.4, 65.8, 94.8, 104.8, 105.9, 96.8, 113.9, 125.6, 125.5, 121.3, 121.3,
    113.5, 113.1, 110.8, 106.5, 108.8, 105.3, 104.4, 100, 96, 95.1, 89.1, 90.5, 90.3, 88.4, 84, 85.1, 81.9, 82.6, 84.9,
    81.3, 71.9, 74.3, 76.4, 63.3, 71.7, 77, 65.2, 47.7, 68.6, 65, 66, 61, 53.3, 58.9, 61.9,
)  # fmt: skip
_S1 = (
    0.02, 4.5, 22.4, 42, 40.6, 41.6, 38, 42.4, 38.5, 35, 43.4, 46.3, 43.9, 37.1, 36.7, 35.9, 32.6, 27.9, 24.3, 20.1, 16.2,
    13.2, 8.6, 6.1, 4.2, 1.9, 0, -1.6, -3.5, -3.5, -5.8, -7.2, -8.6, -9.5, -10.9, -10.7, -12, -14, -13.6, -12, -13.3,
    -12.9, -10.6, -11.6, -12.2, -10.2, -7.8, -11.2, -10.4, -10.6, -9.7, -8.3, -9.3, -9.8,
)  # fmt: skip
_S2 = (
    0, 2, 4, 8.5, 7.8, 6.7, 5.3, 6.1, 3, 1.2, -1.1, -0.5, -0.7, -1.2, -2.6, -2.9, -2.8, -2.6, -2.6, -1.8, -1.5, -1.3,
    -1.2, -1, -0.5, -0.3, 0, 0.2, 0.5, 2.1, 3.2, 4.1, 4.7, 5.1, 6.7, 7.3, 8.6, 9.8, 10.2, 8.3, 9.6, 8.5, 7, 7.6, 8, 6.7,
    5.2, 7.4, 6.8, 7, 6.4, 5.5, 6.1, 6.5,
)  # fmt: skip
# CIE 1924 V(λ), 380 to 780 nm in steps of 10 nm.
_V = (
    3.9e-05, 0.00012, 0.000396, 0.00121, 0.004, 0.0116, 0.023, 0.038, 0.06, 0.09098, 0.13902, 0.20802, 0.323, 0.503,
    0.71, 0.862, 0.954, 0.99495, 0.995, 0.952, 0.87, 0.757, 0.631, 0.503, 0.381, 0.265, 0.175, 0.107, 0.061, 0.032,
    0.017, 0.00821, 0.004102, 0.002091, 0.001047, 0.00052, 0.0002492, 0.00012, 6e-05, 3e-05, 1.499e-05,
)  # fmt: skip


def _grid(wavelength_m: ArrayLike) -> Array:
    w = np.asarray(wavelength_m, np.float64)
    if w.ndim != 1 or w.size < 2 or not (np.isfinite(w).all() and (np.diff(w) > 0).all() and w[0] > 0):
        raise ValueError("wavelength_m must be at least two increasing, positive lengths in m")
    return w


def planck_radiance(wavelength_m: ArrayLike, temperature_k: float) -> Array:
    """Planck's law: 2hc²/λ⁵ / (exp(hc/λkT) − 1), W/(m² sr m), for a filament or the sun (5772 K)."""
    if not temperature_k > 0:
        raise ValueError(f"temperature_k must be positive, not {temperature_k!r}")
    w = np.asarray(wavelength_m, np.float64)
    x = PLANCK_J_S * C_M_PER_S / (w * _BOLTZMANN_J_K * temperature_k)
    # In the form exp(−x)/(1 − exp(−x)) nothing overflows.
    return np.asarray(2.0 * PLANCK_J_S * C_M_PER_S**2 / w**5 * np.exp(-x) / -np.expm1(-x))


def daylight_spectrum(wavelength_m: ArrayLike, colour_temperature_k: float) -> Array:
    """Relative spectrum of CIE daylight, 100 at 560 nm: S₀ + M₁S₁ + M₂S₂; zero outside 300 … 830 nm.

    Main arguments:
        colour_temperature_k: 4000 … 25000 K; D65 is 6500·1.4388/1.4380 = 6503.6 K. ValueError outside.

    M₁ and M₂ are rounded to three decimals, as the CIE does.
    """
    t = float(colour_temperature_k)
    if not 4000.0 <= t <= 25000.0:
        raise ValueError(f"colour_temperature_k must be 4000 … 25000, not {t!r}")
    if t <= 7000.0:
        x = 0.244063 + 0.09911e3 / t + 2.9678e6 / t**2 - 4.6070e9 / t**3
    else:
        x = 0.237040 + 0.24748e3 / t + 1.9018e6 / t**2 - 2.0064e9 / t**3
    y = -3.0 * x * x + 2.870 * x - 0.275
    m = 0.0241 + 0.2562 * x - 0.7341 * y
    m1 = round((-1.3515 - 1.7703 * x + 5.9114 * y) / m, 3)
    m2 = round((0.0300 - 31.4424 * x + 30.0717 * y) / m, 3)
    table = np.asarray(_S0) + m1 * np.asarray(_S1) + m2 * np.asarray(_S2)
    nm = 1e9 * np.asarray(wavelength_m, np.float64)
    return np.asarray(np.interp(nm, 300.0 + 10.0 * np.arange(table.size), table, left=0.0, right=0.0))


def illuminance_lux(wavelength_m: ArrayLike, irradiance: ArrayLike) -> float:
    """683 lm/W ∫ E(λ) V(λ) dλ, lux, of a spectral irradiance in W/(m² m), by the trapezoid rule on its own grid.

    V is linear between its values every 10 nm: right within .5 % for a single line, .2 % for a broad spectrum.
    """
    w = _grid(wavelength_m)
    v = np.interp(1e9 * w, 380.0 + 10.0 * np.arange(len(_V)), _V, left=0.0, right=0.0)
    return float(_LUMEN_PER_W * np.trapezoid(np.asarray(irradiance, np.float64) * v, w))


def scaled_to_lux(wavelength_m: ArrayLike, relative: ArrayLike, lux: float) -> Array:
    """The relative spectrum scaled to a spectral irradiance of `lux`, W/(m² m).

    Raises ValueError for a negative illuminance, and for a spectrum without visible light.
    """
    if lux < 0:
        raise ValueError(f"lux must be at least 0, not {lux!r}")
    now = illuminance_lux(wavelength_m, relative)
    if not now > 0:
        raise ValueError("The spectrum has no visible light by which it could be scaled.")
    return np.asarray(np.asarray(relative, np.float64) * (lux / now))


def through(attenuation_per_m: ArrayLike, path_m: ArrayLike) -> Array:
    """exp(−K(λ) d): transmission of a path of d metres.

    K is the diffuse attenuation K_d for light that comes down from the sky, and the beam attenuation c for the image of
    a surface (light scattered into the line of sight is not included).
    """
    return np.asarray(np.exp(-np.asarray(attenuation_per_m, np.float64) * np.asarray(path_m, np.float64)))


def diffuse_attenuation(source: str, kind: str, wavelength_m: ArrayLike) -> Array:
    """K_d(λ), 1/m, of downwelling light: as tabulated by solonenko2015; of pure water a + b/2 (half of b scatters back).

    NaN where the source has no value. Raises ValueError for a source without K_d, or an unknown type.
    """
    from .water.types import water_optics

    wave = np.asarray(wavelength_m, np.float64)
    if source == "pure":

        def one(value: float) -> float:
            water = water_optics(source, kind, value)
            return water.absorption_per_m + 0.5 * water.scattering_per_m

    elif source == "solonenko2015":
        import jerlov

        water_optics(source, kind, 532e-9)
        body: Any = jerlov.water(kind, source=source)

        def one(value: float) -> float:
            return float(body.kd(round(value * 1e9, 9)))

    else:
        raise ValueError(f"{source} gives no diffuse attenuation K_d; solonenko2015 and pure do.")

    def safe(value: float) -> float:
        try:
            return one(value)
        except (ValueError, LookupError):
            return float("nan")

    return np.asarray([safe(float(v)) for v in wave.ravel()]).reshape(wave.shape)


def band_filter(wavelength_m: ArrayLike, centre_m: float, fwhm_m: float, peak: float, *, square: bool = False) -> Array:
    """Transmission of a band-pass filter: a Gaussian, or a rectangle, of full width `fwhm_m` and height `peak`."""
    if not (fwhm_m > 0 and 0 <= peak <= 1):
        raise ValueError(f"fwhm_m must be positive and peak in 0 … 1, not {(fwhm_m, peak)!r}")
    off = np.abs(np.asarray(wavelength_m, np.float64) - centre_m) / fwhm_m
    if square:
        return np.asarray(np.where(off <= 0.5, peak, 0.0))
    return np.asarray(peak * np.exp(-4.0 * np.log(2.0) * off**2))


def diffuse_radiance(irradiance: ArrayLike, albedo: ArrayLike) -> Array:
    """L = ρE/π, W/(m² sr m): a Lambert surface of albedo ρ under the irradiance E."""
    return np.asarray(np.asarray(irradiance, np.float64) * np.asarray(albedo, np.float64) / np.pi)


def photoelectron_rate(
    wavelength_m: ArrayLike,
    radiance: ArrayLike,
    *,
    etendue_m2_sr: float,
    filter_transmission: ArrayLike,
    quantum_efficiency: ArrayLike,
) -> float:
    """Photoelectrons per second, G ∫ L(λ) F(λ) QE(λ) λ/(hc) dλ, by the trapezoid rule on the given grid.

    Main arguments:
        radiance: L at the lens, W/(m² sr m). etendue_m2_sr: G, of a pixel A_px π/(4F²) times the optics' transmission,
        of a photodetector A_aperture · Ω. filter_transmission, quantum_efficiency: arrays on the grid, or numbers.

    This is the quantity `ambient_e_per_s` of a rig. The grid must resolve the filter.
    """
    w = _grid(wavelength_m)
    part = np.asarray(radiance, np.float64) * np.asarray(filter_transmission) * np.asarray(quantum_efficiency)
    return float(etendue_m2_sr * np.trapezoid(part * w / (PLANCK_J_S * C_M_PER_S), w))
