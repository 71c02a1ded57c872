"""Refractive indices of water and air, phase and group, against vacuum wavelength.

Light pulses travel at c/n_g with the group index n_g = n − λ dn/dλ, here differentiated analytically; rays bend by n.

Water: Quan and Fry, Applied Optics 34:3477 (1995), fitted for 0-30 °C, 0-35 psu and 400-700 nm at atmospheric
pressure. Their index is relative to *air*; as in Zhang, Hu and He, Optics Express 17:5698 (2009), it is multiplied by
the index of standard air to give the absolute index that a time of flight needs (3.7e-4 more). It then agrees with the
absolute measurements of Daimon and Masumura, Applied Optics 46:3811 (2007), within 4e-5, and in n_g within 1e-4.
Air: Ciddor, Applied Optics 35:1566 (1996), dry, 450 ppm CO2, with the BIPM-91 compressibility; −40-100 °C,
80-120 kPa, 300-1690 nm.
"""

from __future__ import annotations

__all__ = ["air_group_index", "air_phase_index", "quan_fry_index", "water_group_index", "water_phase_index"]

#: Conditions of standard air (Ciddor 1996): 15 °C, 101 325 Pa.
_STANDARD_C, _STANDARD_PA = 15.0, 101_325.0


def _within(name: str, value: float, low: float, high: float, unit: str) -> float:
    if not low <= value <= high:  # NaN fails too
        raise ValueError(f"{name} is {value!r} {unit}, outside {low:g} … {high:g} {unit}, the range of the formula")
    return float(value)


def quan_fry_index(wavelength_m: float, temperature_c: float, salinity_psu: float) -> float:
    """Index of water *relative to air*, as published by Quan and Fry (1995).

    n = n0 + (n1 + n2 T + n3 T²) S + n4 T² + (n5 + n6 S + n7 T)/λ + n8/λ² + n9/λ³, λ in nm.
    Raises ValueError outside 400-700 nm, 0-30 °C, 0-35 psu.
    """
    return _quan_fry(wavelength_m, temperature_c, salinity_psu)[0]


def water_phase_index(wavelength_m: float, temperature_c: float, salinity_psu: float) -> float:
    """Absolute phase index of water: Quan and Fry's index times that of standard air.

    Main arguments:
        wavelength_m: vacuum wavelength, 4e-7 to 7e-7 m.
        temperature_c: 0 to 30 °C.
        salinity_psu: practical salinity, 0 to 35.
    Raises ValueError outside these ranges.
    """
    return _quan_fry(wavelength_m, temperature_c, salinity_psu)[0] * _air(wavelength_m, _STANDARD_C, _STANDARD_PA)[0]


def water_group_index(wavelength_m: float, temperature_c: float, salinity_psu: float) -> float:
    """Absolute group index of water, n − λ dn/dλ, of `water_phase_index`; same arguments and errors."""
    n, dn = _quan_fry(wavelength_m, temperature_c, salinity_psu)
    air, d_air = _air(wavelength_m, _STANDARD_C, _STANDARD_PA)
    return n * air - wavelength_m * (dn * air + n * d_air)


def air_phase_index(wavelength_m: float, temperature_c: float, pressure_pa: float) -> float:
    """Phase index of dry air with 450 ppm CO2 (Ciddor 1996).

    Main arguments:
        wavelength_m: vacuum wavelength, 3e-7 to 1.69e-6 m.
        temperature_c: −40 to 100 °C.
        pressure_pa: 80 000 to 120 000 Pa.
    Raises ValueError outside these ranges. Saturated humid air at 20 °C has an index lower by about 1e-6.
    """
    return _air(wavelength_m, temperature_c, pressure_pa)[0]


def air_group_index(wavelength_m: float, temperature_c: float, pressure_pa: float) -> float:
    """Group index n − λ dn/dλ of `air_phase_index`; same arguments and errors."""
    n, dn = _air(wavelength_m, temperature_c, pressure_pa)
    return n - wavelength_m * dn


def _quan_fry(wavelength_m: float, temperature_c: float, salinity_psu: float) -> tuple[float, float]:
    """(n, dn/dλ [1/m]) relative to air."""
    nm = _within("wavelength", 1e9 * wavelength_m, 400.0, 700.0, "nm")
    t = _within("temperature_c", temperature_c, 0.0, 30.0, "°C")
    s = _within("salinity_psu", salinity_psu, 0.0, 35.0, "psu")
    base = 1.31405 + (1.779e-4 - 1.05e-6 * t + 1.6e-8 * t * t) * s - 2.02e-6 * t * t
    first, second, third = 15.868 + 0.01155 * s - 0.00423 * t, -4382.0, 1.1455e6
    n = base + first / nm + second / nm**2 + third / nm**3
    return n, 1e9 * (-first / nm**2 - 2.0 * second / nm**3 - 3.0 * third / nm**4)


def _air(wavelength_m: float, temperature_c: float, pressure_pa: float) -> tuple[float, float]:
    """(n, dn/dλ [1/m]): standard refractivity times the ratio of densities."""
    um = _within("wavelength", 1e9 * wavelength_m, 300.0, 1690.0, "nm") * 1e-3
    t = _within("temperature_c", temperature_c, -40.0, 100.0, "°C")
    p = _within("pressure_pa", pressure_pa, 8e4, 1.2e5, "Pa")
    ratio = (p / _compressible_kelvin(t, p)) / (_STANDARD_PA / _compressible_kelvin(_STANDARD_C, _STANDARD_PA))
    square = um**-2
    terms = ((5_792_105e-8, 238.0185), (167_917e-8, 57.362))
    n = 1.0 + ratio * sum(k / (pole - square) for k, pole in terms)
    # d(1/λ²)/dλ = −2/λ³ per µm, and 1e6 µm in a metre
    return n, ratio * 1e6 * sum(k / (pole - square) ** 2 * -2.0 * um**-3 for k, pole in terms)


def _compressible_kelvin(temperature_c: float, pressure_pa: float) -> float:
    """Z·T of dry air in K: density is p M/(R Z T) (BIPM-91, in Ciddor 1996, Appendix A)."""
    kelvin = temperature_c + 273.15
    x = pressure_pa / kelvin
    a = 1.58123e-6 + temperature_c * (-2.9331e-8 + temperature_c * 1.1043e-10)
    z = 1.0 - x * a + x * x * 1.83e-11
    return z * kelvin
