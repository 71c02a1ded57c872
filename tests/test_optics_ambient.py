"""Ambient light: Planck, CIE daylight, lux, and the way to photoelectrons, against closed forms and colour-science."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from beambench.optics import ambient
from beambench.optics.constants import C_M_PER_S, PLANCK_J_S

WAVE = np.arange(300, 831, 1.0) * 1e-9


def test_planck_integrates_to_stefan_boltzmann_and_peaks_by_wien() -> None:
    wave = np.geomspace(5e-8, 1e-3, 40_000)
    for kelvin in (300.0, 3000.0, 5772.0):
        radiance = ambient.planck_radiance(wave, kelvin)
        assert np.isfinite(radiance).all()
        total = np.pi * np.trapezoid(radiance, wave)
        assert total == pytest.approx(5.670374419e-8 * kelvin**4, rel=1e-4)
        # The grid's points are .025 % apart.
        assert wave[np.argmax(radiance)] * kelvin == pytest.approx(2.897771955e-3, rel=5e-4)
    # Far in the ultraviolet of a cold body: no overflow.
    assert ambient.planck_radiance(1e-9, 300.0) == 0.0


def test_daylight_is_d65_at_the_values_that_the_cie_tabulates() -> None:
    # CIE 15:2004, table T.1, D65.
    d65 = ambient.daylight_spectrum(np.array([400.0, 500.0, 560.0, 700.0, 780.0]) * 1e-9, 6503.6)
    np.testing.assert_allclose(d65, [82.7549, 109.354, 100.0, 71.6091, 63.3828], atol=1e-3)
    assert ambient.daylight_spectrum(900e-9, 6504.0) == 0.0


def test_daylight_and_lux_agree_with_colour_science() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        colour = pytest.importorskip("colour")
        for kelvin in (5003.0, 9300.0):
            xy = colour.temperature.CCT_to_xy_CIE_D(kelvin)
            theirs = colour.sd_CIE_illuminant_D_series(xy)
            nm = np.arange(380, 781, 10)
            np.testing.assert_allclose(
                ambient.daylight_spectrum(nm * 1e-9, kelvin), [float(theirs[int(n)]) for n in nm], atol=0.05
            )
        sd = colour.SpectralDistribution(dict(zip(range(380, 781, 10), np.linspace(1, 2, 41), strict=True)))
        theirs_lm = colour.luminous_flux(sd)
    wave = np.arange(380, 781, 1) * 1e-9
    ours = ambient.illuminance_lux(wave, np.interp(wave, np.arange(380, 781, 10) * 1e-9, np.linspace(1, 2, 41)) * 1e9)
    # V(λ) read linearly between 10 nm steps against theirs at 1 nm: 3e-3.
    assert ours == pytest.approx(theirs_lm, rel=3e-3)


def test_lux_of_a_line_at_555_nm_is_683_lumen_per_watt() -> None:
    wave = np.linspace(550e-9, 560e-9, 2001)
    line = np.exp(-0.5 * ((wave - 555e-9) / 0.2e-9) ** 2)
    line /= np.trapezoid(line, wave)
    # V is 1 at 555 nm; the line between its values of .995 at 550 and 560 nm misses .5 %.
    assert ambient.illuminance_lux(wave, line) == pytest.approx(683.0, rel=6e-3)
    scaled = ambient.scaled_to_lux(WAVE, ambient.daylight_spectrum(WAVE, 6504.0), 1e5)
    assert ambient.illuminance_lux(WAVE, scaled) == pytest.approx(1e5, rel=1e-12)
    # Full daylight, about 100 klx, carries 400 to 550 W/m² of visible light (250 lm/W at most, D65 about 204).
    visible = (WAVE >= 380e-9) & (WAVE <= 780e-9)
    assert 1e5 / np.trapezoid(scaled[visible], WAVE[visible]) == pytest.approx(204.0, rel=0.02)


def test_photoelectrons_of_a_flat_spectrum_through_a_square_filter_are_the_closed_form() -> None:
    wave = np.linspace(500e-9, 560e-9, 60_001)
    radiance = ambient.diffuse_radiance(np.full(wave.size, 1.5e9), 0.4)
    rate = ambient.photoelectron_rate(
        wave, radiance, etendue_m2_sr=2e-11,
        filter_transmission=ambient.band_filter(wave, 532e-9, 10e-9, 0.9, square=True), quantum_efficiency=0.3,
    )  # fmt: skip
    low, high = 527e-9, 537e-9
    exact = 2e-11 * 1.5e9 * 0.4 / np.pi * 0.9 * 0.3 * 0.5 * (high**2 - low**2) / (PLANCK_J_S * C_M_PER_S)
    # Steps of 1 pm at the filter's two edges of a 10 nm band: 1e-4.
    assert rate == pytest.approx(exact, rel=2e-4)


def test_water_takes_its_share_of_each_wavelength() -> None:
    attenuation = np.array([0.05, 0.3])
    assert ambient.through(attenuation, 3.0) == pytest.approx(np.exp([-0.15, -0.9]))
    # In series, paths add.
    both = ambient.through(attenuation, 1.0) * ambient.through(attenuation, 2.0)
    assert both == pytest.approx(ambient.through(attenuation, 3.0))


def test_a_gaussian_filter_has_its_half_width() -> None:
    at = np.array([532.0, 527.0, 537.0]) * 1e-9
    assert ambient.band_filter(at, 532e-9, 10e-9, 0.8) == pytest.approx([0.8, 0.4, 0.4])


@pytest.mark.parametrize(
    "call",
    [
        lambda: ambient.planck_radiance(5e-7, 0.0),
        lambda: ambient.daylight_spectrum(5e-7, 3000.0),
        lambda: ambient.scaled_to_lux(WAVE, np.zeros(WAVE.size), 10.0),
        lambda: ambient.scaled_to_lux(WAVE, np.ones(WAVE.size), -1.0),
        lambda: ambient.band_filter(WAVE, 5e-7, 0.0, 0.5),
        lambda: ambient.illuminance_lux(WAVE[::-1], np.ones(WAVE.size)),
    ],
)
def test_impossible_light_is_refused(call) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError):
        call()
