"""Indices of water and air: published values, the derivative against differences, ranges."""

from __future__ import annotations

import numpy as np
import pytest

from beambench.optics.water.refraction import (
    air_group_index,
    air_phase_index,
    quan_fry_index,
    water_group_index,
    water_phase_index,
)

GREEN = 532e-9


def test_water_at_532_nm() -> None:
    # Rounded to the three decimals in which they are usually quoted (fresh, 20 °C; sea, 20 °C and 35 psu).
    assert round(water_phase_index(GREEN, 20.0, 0.0), 3) == 1.335
    assert round(water_group_index(GREEN, 20.0, 0.0), 3) == 1.357
    assert round(water_phase_index(GREEN, 20.0, 35.0), 3) == 1.342
    assert round(water_group_index(GREEN, 20.0, 35.0), 3) == 1.364


#: Sellmeier fits A λ²/(λ² − B), λ in µm, of the absolute index of distilled water: Daimon and Masumura, Applied Optics
#: 46:3811 (2007), at 19.0 and 21.5 °C.
DAIMON = {
    19.0: (
        (5.672526103e-1, 5.085550461e-3),
        (1.736581125e-1, 1.814938654e-2),
        (2.121531502e-2, 2.617260739e-2),
        (1.138493213e-1, 1.073888649e1),
    ),
    21.5: (
        (5.689093832e-1, 5.110301794e-3),
        (1.719708856e-1, 1.825180155e-2),
        (2.062501582e-2, 2.624158904e-2),
        (1.123965424e-1, 1.067505178e1),
    ),
}


@pytest.mark.parametrize("wavelength_um", [0.45, 0.532, 0.5893, 0.65])
@pytest.mark.parametrize("temperature_c", DAIMON)
def test_water_against_measurement(temperature_c: float, wavelength_um: float) -> None:
    square = wavelength_um**2
    n = np.sqrt(1.0 + sum(a * square / (square - b) for a, b in DAIMON[temperature_c]))
    # n_g = n − λ dn/dλ with d(n²)/dλ = −2λ Σ A B/(λ² − B)²
    group = n + square / n * sum(a * b / (square - b) ** 2 for a, b in DAIMON[temperature_c])
    at = (wavelength_um * 1e-6, temperature_c, 0.0)
    # Quan and Fry state an error of 1.5e-5 against their data, which are good to a few 1e-5. Their index relative to
    # air is lower by 3.7e-4: ten times that, so that this distinguishes the two.
    assert abs(water_phase_index(*at) - n) < 4e-5
    assert abs(water_group_index(*at) - group) < 1e-4
    assert 3e-4 < n - quan_fry_index(*at) < 4.2e-4


def test_water_falls_with_temperature_and_rises_with_salt() -> None:
    t = [water_phase_index(GREEN, x, 0.0) for x in np.linspace(0.0, 30.0, 31)]
    s = [water_phase_index(GREEN, 15.0, x) for x in np.linspace(0.0, 35.0, 36)]
    assert np.all(np.diff(t) < 0.0)
    assert np.all(np.diff(s) > 0.0)


def test_air_known_refractivity() -> None:
    # Ciddor 1996, dry air, 15 °C, 101 325 Pa, 450 ppm CO2, 632.8 nm: n − 1 = 2.76532e-4 at the printed dispersion.
    assert abs(air_phase_index(632.8e-9, 15.0, 101_325.0) - 1.000276533) < 1e-9
    assert 2.72e-4 < air_phase_index(GREEN, 20.0, 101_325.0) - 1.0 < 2.75e-4
    assert 2.77e-4 < air_phase_index(GREEN, 15.0, 101_325.0) - 1.0 < 2.79e-4
    # Ideal-gas scaling from 15 to 20 °C; real air departs by the change of compressibility, below 1e-4 of n − 1.
    ratio = (air_phase_index(GREEN, 20.0, 101_325.0) - 1.0) / (air_phase_index(GREEN, 15.0, 101_325.0) - 1.0)
    assert abs(ratio - 288.15 / 293.15) < 1e-4


@pytest.mark.parametrize("wavelength_m", [450e-9, 532e-9, 650e-9])
def test_group_index_is_the_derivative(wavelength_m: float) -> None:
    # Central differences, h = 0.1 nm: truncation λ h² n'''/6 < 1e-9 (n''' < 1e-9 nm⁻³), rounding 1e-16·λ/h < 1e-12.
    h = 1e-10
    for phase, group, at in (
        (water_phase_index, water_group_index, (12.0, 20.0)),
        (air_phase_index, air_group_index, (12.0, 95_000.0)),
    ):
        slope = (phase(wavelength_m + h, *at) - phase(wavelength_m - h, *at)) / (2.0 * h)
        assert abs(group(wavelength_m, *at) - (phase(wavelength_m, *at) - wavelength_m * slope)) < 1e-8


@pytest.mark.parametrize(
    ("function", "arguments", "says"),
    [
        (water_phase_index, (390e-9, 20.0, 0.0), "390"),
        (water_group_index, (532e-9, 31.0, 0.0), "31"),
        (water_phase_index, (532e-9, 20.0, 36.0), "36"),
        (water_phase_index, (532e-9, float("nan"), 0.0), "nan"),
        (air_phase_index, (2e-6, 20.0, 101_325.0), "1690"),
        (air_group_index, (532e-9, -50.0, 101_325.0), "-40"),
        (air_group_index, (532e-9, 20.0, 1.0), "80000"),
    ],
)
def test_outside_the_range_of_the_formula(function: object, arguments: tuple[float, ...], says: str) -> None:
    with pytest.raises(ValueError, match="range of the formula") as caught:
        function(*arguments)  # type: ignore[operator]
    assert says in str(caught.value)
