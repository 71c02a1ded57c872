"""Waters by source, and the attenuation of light and sound (Kusters 1992, Figure 2.1)."""

from __future__ import annotations

import numpy as np
import pytest

from beambench.optics.water import attenuation
from beambench.optics.water.phase_forms import phase_cdf
from beambench.optics.water.phase_function import asymmetry, backscatter_fraction
from beambench.optics.water.types import WATER_SOURCES, water_optics, water_types

SEA = {"temperature_c": 15.0, "salinity_psu": 35.0, "depth_m": 0.0, "ph": 8.0}


@pytest.mark.parametrize(
    ("kind", "a", "b"),
    [
        ("IB", 0.0532, 0.124), ("II", 0.0618, 0.179), ("III", 0.0812, 0.290), ("1C", 0.0951, 0.432),
        ("3C", 0.128, 0.651), ("5C", 0.168, 1.21),
    ],
)  # fmt: skip
def test_jerlov_types_as_printed_at_532_nm(kind: str, a: float, b: float) -> None:
    water = water_optics("williamson2022", kind, 532e-9)
    assert (water.absorption_per_m, water.scattering_per_m) == pytest.approx((a, b), rel=1e-9)
    assert water.attenuation_per_m == pytest.approx(a + b)
    assert water.phase is None and "Williamson" in water.citation and water.caveats


@pytest.mark.parametrize(
    ("kind", "a", "b", "backward"),
    [("clear", 0.114, 0.037, 0.044), ("coastal", 0.179, 0.219, 0.013), ("harbour", 0.366, 1.824, 0.020)],
)
def test_petzold_brings_his_scattering_function(kind: str, a: float, b: float, backward: float) -> None:
    water = water_optics("petzold1972", kind, 532e-9)
    assert (water.absorption_per_m, water.scattering_per_m) == pytest.approx((a, b), abs=6e-4)
    assert water.phase is not None
    assert backscatter_fraction(water.phase) == pytest.approx(backward, abs=6e-4)  # as printed, three decimals
    assert 0.85 < asymmetry(water.phase) < 0.96
    # the printed running integral, independent of ours: F(10°) by the trapezoid in the report
    import jerlov

    stations = {"clear": "AUTEC 8", "coastal": "HAOCE 11", "harbour": "NUC 2040"}
    table = jerlov.petzold_scattering(stations[kind])
    assert float(phase_cdf(water.phase, np.radians(0.1))) == pytest.approx(table.fraction_below_0_1_deg, rel=0.01)
    assert water.scattering_per_m == table.b


def test_pure_water_and_its_sources() -> None:
    fresh, sea = water_optics("pure", "fresh", 532e-9), water_optics("pure", "sea", 532e-9)
    assert fresh.absorption_per_m == pytest.approx(0.0445, abs=1e-4)
    assert fresh.scattering_per_m == pytest.approx(0.0017, abs=1e-4)
    assert sea.scattering_per_m > fresh.scattering_per_m
    assert sea.phase is not None and backscatter_fraction(sea.phase) == pytest.approx(0.5)


def test_sources_differ_and_are_never_mixed() -> None:
    ratio = (
        water_optics("solonenko2015", "III", 532e-9).scattering_per_m
        / water_optics("williamson2022", "III", 532e-9).scattering_per_m
    )
    assert ratio == pytest.approx(3.6, abs=0.1)
    for source in WATER_SOURCES:
        assert water_types(source)
    for bad in (
        ("nobody", "III", 532e-9), ("williamson2022", "I", 532e-9), ("petzold1972", "III", 532e-9),
        ("petzold1972", "harbour", 633e-9), ("pure", "fresh", 1.0e-6), ("williamson2022", "III", 1.0e-6),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=r"no |holds|measured|nm"):
            water_optics(*bad)


def test_eq_2_1_and_2_2() -> None:
    assert float(attenuation.frequency_eq2_1(1e-3, 1500.0)) == pytest.approx(1.5e6)
    assert float(attenuation.intensity_eq2_2(2.0, 0.5, 4.0)) == pytest.approx(2 * np.exp(-2))


def test_sound_absorption_by_two_fits_of_the_same_data() -> None:
    frequency = np.geomspace(1e2, 1e6, 200)
    for t in (0.0, 10.0, 15.0, 25.0):
        for depth in (0.0, 1000.0, 4000.0):
            kw = {"temperature_c": t, "salinity_psu": 35.0, "depth_m": depth, "ph": 8.0}
            one = attenuation.sound_absorption_francois_garrison(frequency, **kw)
            two = attenuation.sound_absorption_ainslie_mccolm(frequency, **kw)
            # Ainslie and McColm claim 10 % in these ranges; 15 % leaves room at the edges
            assert np.abs(two / one - 1).max() < 0.15
            assert np.all(np.diff(one) > 0)  # «attenuation also increases monotonically»
    fresh = attenuation.sound_absorption_francois_garrison(1e6, temperature_c=20, salinity_psu=0, depth_m=0, ph=7)
    # pure water at 20 °C: 25e-15 Np s²/m in amplitude, that is .217 dB/m at 1 MHz
    assert float(fresh) == pytest.approx(217, rel=0.03)


def test_figure_2_1() -> None:
    micrometres = np.linspace(0.35, 0.75, 161)
    light = {
        name: attenuation.light_attenuation(*water, micrometres * 1e-6)
        for name, water in attenuation.FIGURE_2_1_WATERS.items()
    }
    # the transmission window: clearest in the blue-green, later as the water gets more turbid
    best = {name: micrometres[np.nanargmin(value)] for name, value in light.items()}
    assert 0.38 < best["distilled"] < 0.48 and 0.46 < best["ocean"] < 0.52
    assert best["distilled"] < best["ocean"] <= best["coastal"] <= best["bay"] < 0.6
    # from distilled to bay water each is dimmer than the one before, at all wavelengths of the window
    window = (micrometres > 0.45) & (micrometres < 0.6)
    order = np.stack([light[name][window] for name in ("distilled", "ocean", "coastal", "bay")])
    assert np.all(np.diff(order, axis=0) > 0)
    assert np.isnan(attenuation.light_attenuation("williamson2022", "III", 1.0e-6))
    # sound: shorter waves, higher attenuation, as 1/λ² where the water itself absorbs (the .3 … 1.3 mm of the figure)
    millimetres = np.linspace(0.3, 1.3, 50)
    sound = attenuation.sound_attenuation_of_wavelength(millimetres * 1e-3, speed_m_per_s=1500.0, **SEA)
    assert np.all(np.diff(sound) < 0)
    slope = np.polyfit(np.log(millimetres), np.log(sound), 1)[0]
    assert slope == pytest.approx(-2.0, abs=0.15)
    assert float(attenuation.db_per_km_to_per_m(1000.0)) == pytest.approx(np.log(10) / 10)
