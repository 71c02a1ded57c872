"""Numbers that the two documents print, and constants that stand behind their figures, held to where they were read.

A reproduction that compares a printed number with a computed one is worth as much as the printed number. Here these stand
as literals, and each is looked up in the text of its document where the folder of documents is at hand.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from beambench.benchmarks.reproduce import accuracy, photodetector, stacks, table_1
from beambench.optics.correlation.pulses import GaussianPulse, pulse_variance
from beambench.optics.water import attenuation

C = 299_792_458.0
SEA = {"temperature_c": 8.0, "salinity_psu": 33.0, "depth_m": 500.0, "ph": 7.9}


@pytest.fixture(scope="module")
def documents(project: Path) -> dict[str, str]:
    """Texts of both documents by their numbers; skips where they are missing."""
    folder = project.parent / "shared" / "seeds"
    found = {path.name[:3]: path.read_text(encoding="utf-8", errors="replace") for path in folder.glob("00*.txt")}
    if not {"000", "001"} <= found.keys():
        pytest.skip("the texts of the two documents are not beside the project (../shared/seeds)")
    return found


# --- Guo et al. 2017 ----------------------------------------------------------------------------------------------


def test_table_1_holds_the_printed_percentages() -> None:
    assert table_1.PUBLISHED == {
        "set-up": (1.85, 2.22), "weighted average": (12.65, 14.11), "proposed": (2.26, 2.93),
    }  # fmt: skip
    assert accuracy.RANGE_ACCURACY_M == 8.894e-3
    assert accuracy.DEPTHS_M == (0.48, 0.40)


def test_table_1_is_that_of_the_text(documents: dict[str, str]) -> None:
    """The rows «Object 1 1.85% 12.65% 2.26%» of the text, against what the reproduction holds."""
    text = documents["000"]
    rows = re.findall(r"^Object ([12])\s+([\d.]+)%\s+([\d.]+)%\s+([\d.]+)%", text, re.MULTILINE)
    assert [row[0] for row in rows] == ["1", "2"]
    for column, name in enumerate(("set-up", "weighted average", "proposed"), start=1):
        assert table_1.PUBLISHED[name] == tuple(float(row[column]) for row in rows)
    (depth_1, depth_2) = re.findall(r"have ([\d.]+)m and ([\d.]+)m depth measured from background", text)[0]
    assert (float(depth_1), float(depth_2)) == accuracy.DEPTHS_M
    printed = {float(v) for v in re.findall(r"delta r \\approx ([\d.]+)\$ mm", text)}
    assert len(printed) == 1 and printed.pop() == pytest.approx(1e3 * accuracy.RANGE_ACCURACY_M)


def test_printed_percentages_are_consistent() -> None:
    """8.894 mm over .48 and .40 m: 1.853 and 2.2235 %, printed 1.85 and 2.22. Another depth or accuracy would not fit."""
    for depth, printed in zip(accuracy.DEPTHS_M, table_1.PUBLISHED["set-up"], strict=True):
        assert round(100.0 * 8.894e-3 / depth, 2) == printed


def test_the_photodetectors_set_up_is_that_of_the_text(documents: dict[str, str]) -> None:
    text = documents["000"]
    setup = photodetector.Setup()
    for pattern, value in (
        (r"wavelength (\d+) nm", 1e9 * setup.wavelength_m),
        (r"output energy up to (\d+)\s*mJ", 1e3 * setup.energy_j),
        (r"active diameter of (\d+) um", 1e6 * setup.diameter_m),
        (r"<(\d+) ps rise", 1e12 * setup.rise_s),
        (r"surfaces captured at (\d+) m", photodetector.RANGE_M),
        (r"average of (\d+) measurements", photodetector.MEASUREMENTS),
    ):
        (printed,) = set(re.findall(pattern, text))
        assert float(printed) == pytest.approx(value), pattern


def test_the_photodetectors_set_up_in_numbers() -> None:
    setup = photodetector.Setup()
    assert (setup.energy_j, setup.wavelength_m, setup.diameter_m, setup.rise_s) == (1e-3, 532e-9, 400e-6, 300e-12)
    assert (photodetector.RANGE_M, photodetector.MEASUREMENTS) == (5.0, 30)


@pytest.mark.parametrize("angle_deg", [30.0, 60.0, 75.0])
def test_a_tilted_footprint_lengthens_the_pulse(angle_deg: float) -> None:
    """The variance that the tilt adds, against a quadrature over the beam.

    Intensity exp(−2θ²/w²) over the angle θ = ρ/r to the axis; a ray at lateral place x of the tilted plane comes later by
    2x·tanβ/c. The variance of x is (w r/2)², so that σ = w r tanβ/c; twice as much stretch would quadruple it. Tolerance 1 %:
    second moments of a record cut at ± 10 ns in samples of 50 ps.
    """
    setup = photodetector.Setup(beam_half_angle_rad=0.02, sample_s=25e-12)
    target = photodetector.Surface("", 0.0, 0.3, 0.3)
    t = photodetector.times(setup)

    def variance(angle: float) -> float:
        signal = photodetector.mean_signal(setup, target, math.radians(angle))
        mean = float((signal * t).sum() / signal.sum())
        return float((signal * (t - mean) ** 2).sum() / signal.sum())

    x, y = np.meshgrid(np.linspace(-0.3, 0.3, 601), np.linspace(-0.3, 0.3, 601))  # six half widths of .1 m at 5 m
    weight = np.exp(-2.0 * (x**2 + y**2) / (0.02 * 5.0) ** 2)
    late = 2.0 * x * math.tan(math.radians(angle_deg)) / C
    spread = float((weight * late**2).sum() / weight.sum())
    assert variance(angle_deg) - variance(0.0) == pytest.approx(spread, rel=0.01, abs=0.0)


def test_the_detectors_rise_lengthens_the_pulse() -> None:
    """A Gaussian response rises from 10 to 90 % in 2·1.2816 σ: variances add."""
    setup = photodetector.Setup()
    signal = photodetector.mean_signal(setup, photodetector.Surface("", 0.0, 0.3, 0.3), 0.0)
    t = photodetector.times(setup)
    mean = float((signal * t).sum() / signal.sum())
    got = float((signal * (t - mean) ** 2).sum() / signal.sum())
    want = pulse_variance(GaussianPulse(setup.pulse_fwhm_s)) + (300e-12 / (2.0 * 1.281_551_565_5)) ** 2
    assert got == pytest.approx(want, rel=2e-3, abs=0.0)


def test_a_written_stack_is_the_gaussian_that_it_says() -> None:
    """Echo of the background: peak 1·(its brightness), variance σ², centre at its range: 6 σ of slices on both sides."""
    rig = stacks.Rig(
        sigma_s=1.5e-9, step_s=0.3e-9, background_m=6.0, near_sigmas=8.0, far_sigmas=8.0, wall=1.0, weaker=0.5
    )
    r, echo = stacks.slices(rig, 6.0, 1.0, 0.48)
    mean = float((r * echo).sum() / echo.sum())
    assert mean == pytest.approx(6.0, abs=1e-4)
    got = float(((r - mean) ** 2 * echo).sum() / echo.sum())
    assert got == pytest.approx((0.5 * C * 1.5e-9) ** 2, rel=1e-3)


# --- Kusters 1992, Figure 2.1 -------------------------------------------------------------------------------------


def relaxations(frequency_khz: float, *, t: float, s: float, d: float, ph: float) -> tuple[float, float, float]:
    """Boric acid, magnesium sulphate and pure water, dB/km, 0 … 20 °C.

    Read from the manual of MB-System's `mbabsorption`, which prints Francois and Garrison (1982): 8.86 and 21.44 among
    them. Kusters' text prints neither: his figure names its waters, the constants are the source's.
    """
    speed, kelvin, f2 = 1412.0 + 3.21 * t + 1.19 * s + 0.0167 * d, 273.0 + t, frequency_khz**2
    f_b = 2.8 * math.sqrt(s / 35.0) * 10.0 ** (4.0 - 1245.0 / kelvin)
    f_m = 8.17 * 10.0 ** (8.0 - 1990.0 / kelvin) / (1.0 + 0.0018 * (s - 35.0))
    boric = 8.86 / speed * 10.0 ** (0.78 * ph - 5.0) * f_b * f2 / (f2 + f_b**2)
    sulphate = (
        21.44 * s * (1.0 + 0.025 * t) / speed * (1.0 - 0.000137 * d + 0.0000000062 * d * d) * f_m * f2 / (f2 + f_m**2)
    )
    water = 0.0004937 - 0.0000259 * t + 0.000000911 * t**2 - 0.000000015 * t**3
    return boric, sulphate, water * (1.0 - 0.0000383 * d + 0.00000000049 * d * d) * f2


@pytest.mark.parametrize(("khz", "largest"), [(0.8, 0), (60.0, 1), (5000.0, 2)])
def test_sound_is_absorbed_by_three_causes(khz: float, largest: int) -> None:
    """At .8 kHz boric acid leads, at 60 kHz magnesium sulphate, at 5 MHz the water: each constant is seen where it leads."""
    parts = relaxations(khz, t=8.0, s=33.0, d=500.0, ph=7.9)
    assert max(parts) == parts[largest] and parts[largest] > 0.6 * sum(parts)
    got = float(attenuation.sound_absorption_francois_garrison(1e3 * khz, **SEA))
    assert got == pytest.approx(sum(parts), rel=1e-9)


def test_figure_2_1_is_about_sound_and_four_waters(documents: dict[str, str]) -> None:
    text = documents["001"]
    assert "Spectral attenuation of optical and acoustical radiation" in text
    for water in ("Distilled", "Ocean", "Coastal", "Bay"):
        assert f"{water} Water" in text
    assert list(attenuation.FIGURE_2_1_WATERS) == ["distilled", "ocean", "coastal", "bay"]


@pytest.mark.parametrize(
    ("name", "kind", "absorption", "scattering"),
    [("ocean", "IB", 0.0398, 0.128), ("coastal", "1C", 0.104, 0.440), ("bay", "5C", 0.199, 1.23)],
)
def test_the_figures_waters_by_their_values(name: str, kind: str, absorption: float, scattering: float) -> None:
    """c at 500 nm of Williamson and Hollins 2022: bay water is Jerlov 5C (1.429 1/m), not 3C (.808 1/m)."""
    import jerlov

    table = jerlov.water(kind, source="williamson2022")
    assert (float(table.a(500.0)), float(table.b(500.0))) == pytest.approx((absorption, scattering), rel=1e-9)
    got = float(attenuation.light_attenuation(*attenuation.FIGURE_2_1_WATERS[name], 500e-9))
    assert got == pytest.approx(absorption + scattering, rel=1e-9)


def test_distilled_water_is_pure() -> None:
    """c at 500 nm: absorption of pure water .0204 1/m (Pope and Fry 1997) to .026 (others), scattering .002 1/m."""
    got = float(attenuation.light_attenuation(*attenuation.FIGURE_2_1_WATERS["distilled"], 500e-9))
    assert 0.018 < got < 0.03


# --- Ciddor 1996 --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("celsius", [-40.0, 20.0, 100.0])
def test_air_thins_out_with_the_absolute_temperature(celsius: float) -> None:
    """(n − 1) over that of 15 °C at one pressure: T₀Z₀/(TZ), Z of dry air by BIPM-91 as Ciddor's Appendix A prints it.

    A Kelvin scale that began at −273 °C would move the ratio by 1.2e-4 at −40 °C; the tolerance is 1e-7.
    """
    from beambench.optics.water.refraction import air_phase_index

    def kelvin_z(t: float) -> float:
        kelvin = 273.15 + t
        p_over_t = 101_325.0 / kelvin
        z = 1.0 - p_over_t * (1.58123e-6 - 2.9331e-8 * t + 1.1043e-10 * t**2) + p_over_t**2 * 1.83e-11
        return kelvin * z

    got = (air_phase_index(633e-9, celsius, 101_325.0) - 1.0) / (air_phase_index(633e-9, 15.0, 101_325.0) - 1.0)
    assert got == pytest.approx(kelvin_z(15.0) / kelvin_z(celsius), rel=1e-7)
