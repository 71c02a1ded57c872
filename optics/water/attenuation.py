"""Attenuation of light and of sound in water against wavelength (Kusters 1992, Eq. 2.1, 2.2 and Figure 2.1).

Light is attenuated as I = I₀ e^{−cr}. Oceanographers give sound absorption in dB/km; it is converted to intensity
attenuation in 1/m, so that both fit one axis as in the figure: light against micrometres, sound against millimetres.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..correlation.parts import Array
from .types import water_optics

__all__ = [
    "FIGURE_2_1_WATERS", "db_per_km_to_per_m", "frequency_eq2_1", "intensity_eq2_2", "light_attenuation",
    "sound_absorption_ainslie_mccolm", "sound_absorption_francois_garrison", "sound_attenuation_of_wavelength",
]  # fmt: skip

#: The figure names its waters but not their source: the waters used in their place, (source, type).
FIGURE_2_1_WATERS = {
    "distilled": ("pure", "fresh"),
    "ocean": ("williamson2022", "IB"),
    "coastal": ("williamson2022", "1C"),
    "bay": ("williamson2022", "5C"),
}


def frequency_eq2_1(wavelength_m: ArrayLike, speed_m_per_s: ArrayLike) -> Array:
    """Eq. 2.1: f = c/λ, Hz (the fraction is missing in the scan)."""
    return np.asarray(np.asarray(speed_m_per_s, np.float64) / np.asarray(wavelength_m, np.float64))


def intensity_eq2_2(intensity: ArrayLike, attenuation_per_m: ArrayLike, range_m: ArrayLike) -> Array:
    """Eq. 2.2, Beer-Lambert: I = I₀ e^{−cr} after the distance r, in the unit of I₀."""
    return np.asarray(np.asarray(intensity, np.float64) * np.exp(-np.asarray(attenuation_per_m) * np.asarray(range_m)))


def light_attenuation(source: str, kind: str, wavelength_m: ArrayLike) -> Array:
    """c = a + b of a water of `optics.water` at vacuum wavelengths, 1/m; NaN where the source has no value.

    Raises ValueError for an unknown source or type. Sources extend to .7 or .8 µm, the figure to 1.3 µm.
    """
    water_optics(source, kind, 532e-9)
    wavelength = np.asarray(wavelength_m, dtype=np.float64)

    def one(value: float) -> float:
        try:
            return water_optics(source, kind, value).attenuation_per_m
        except ValueError:
            return float("nan")

    return np.asarray([one(float(v)) for v in wavelength.ravel()]).reshape(wavelength.shape)


def db_per_km_to_per_m(absorption_db_per_km: ArrayLike) -> Array:
    """Intensity attenuation 1/m of an absorption in dB/km: ln(10)/10⁴ times it."""
    return np.asarray(np.asarray(absorption_db_per_km, np.float64) * (np.log(10.0) / 1e4))


def sound_absorption_francois_garrison(
    frequency_hz: ArrayLike, *, temperature_c: float, salinity_psu: float, depth_m: float, ph: float
) -> Array:
    """Absorption of sound in sea water, dB/km (Francois and Garrison, J. Acoust. Soc. Am. 72:1879, 1982).

    Coefficients as in MB-System's manual of `mbabsorption` and in several public programs; .0004397 in the manual is a
    misprint for 4.937e-4, which alone is continuous with the branch above 20 °C.

    α = A₁f₁f²/(f₁² + f²) + A₂P₂f₂f²/(f₂² + f²) + A₃P₃f², f in kHz: boric acid, magnesium sulphate, pure water. Stated
    accuracy 5 % for −2 … 22 °C, 30 … 35 psu (10 % elsewhere); with salinity 0 the first two vanish.
    """
    f2_khz = (np.asarray(frequency_hz, dtype=np.float64) / 1e3) ** 2
    t, s, d = temperature_c, salinity_psu, depth_m
    speed = 1412.0 + 3.21 * t + 1.19 * s + 0.0167 * d
    kelvin = 273.0 + t
    boric = _relaxation(f2_khz, 2.8 * np.sqrt(s / 35.0) * 10.0 ** (4.0 - 1245.0 / kelvin))
    sulphate = _relaxation(f2_khz, 8.17 * 10.0 ** (8.0 - 1990.0 / kelvin) / (1.0 + 0.0018 * (s - 35.0)))
    a1 = 8.86 / speed * 10.0 ** (0.78 * ph - 5.0)
    a2 = 21.44 * s / speed * (1.0 + 0.025 * t) * (1.0 - 1.37e-4 * d + 6.2e-9 * d**2)
    if t <= 20.0:
        a3 = 4.937e-4 - 2.59e-5 * t + 9.11e-7 * t**2 - 1.50e-8 * t**3
    else:
        a3 = 3.964e-4 - 1.146e-5 * t + 1.45e-7 * t**2 - 6.5e-10 * t**3
    return np.asarray(a1 * boric + a2 * sulphate + a3 * (1.0 - 3.83e-5 * d + 4.9e-10 * d**2) * f2_khz)


def sound_absorption_ainslie_mccolm(
    frequency_hz: ArrayLike, *, temperature_c: float, salinity_psu: float, depth_m: float, ph: float
) -> Array:
    """The same, dB/km, in the shorter form of Ainslie and McColm (J. Acoust. Soc. Am. 103:1671, 1998).

    Coefficients as in the public program `alphaAinslieMcColm.m` of ECOSONS; the paper itself was not available.
    Within 10 % of Francois and Garrison for 100 Hz … 1 MHz, −6 … 35 °C, 5 … 50 psu, pH 7.7 … 8.3, 0 … 7 km.
    """
    f2_khz = (np.asarray(frequency_hz, dtype=np.float64) / 1e3) ** 2
    t, s, z = temperature_c, salinity_psu, depth_m / 1e3
    boric = _relaxation(f2_khz, 0.78 * np.sqrt(s / 35.0) * np.exp(t / 26.0)) * np.exp((ph - 8.0) / 0.56)
    sulphate = (1.0 + t / 43.0) * (s / 35.0) * _relaxation(f2_khz, 42.0 * np.exp(t / 17.0)) * np.exp(-z / 6.0)
    return np.asarray(0.106 * boric + 0.52 * sulphate + 4.9e-4 * f2_khz * np.exp(-(t / 27.0 + z / 17.0)))


def _relaxation(f2: Array, relaxation: float) -> Array:
    """f₁f²/(f₁² + f²), and 0 where there is no relaxation."""
    return np.zeros_like(f2) if relaxation == 0.0 else np.asarray(relaxation * f2 / (relaxation**2 + f2))


def sound_attenuation_of_wavelength(wavelength_m: ArrayLike, *, speed_m_per_s: float, **water: Any) -> Array:
    """Intensity attenuation of sound, 1/m, against its wavelength: Eq. 2.1, then Francois and Garrison.

    `water`: the keywords of `sound_absorption_francois_garrison`.
    """
    frequency = frequency_eq2_1(wavelength_m, speed_m_per_s)
    return db_per_km_to_per_m(sound_absorption_francois_garrison(frequency, **water))
