"""Ambient light of a rig from a spectrum: closed forms, colour-science's own tables, water, and bad input."""

from __future__ import annotations

import json
import tomllib
from typing import Any

import numpy as np
import pytest

from beambench.cli import main
from beambench.generator.generate import generate
from beambench.optics import ambient, colorimetry
from beambench.optics.constants import C_M_PER_S, PLANCK_J_S
from beambench.scenes.declared import declared_rig
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.scene import Scene
from beambench.scenes.spec_files import LIBRARY

LIGHT: dict[str, Any] = {
    "kind": "spectrum", "illuminant": "D65", "illuminance_lux": 1000.0, "reflectance": 0.5,
    "filter": {"shape": "gaussian", "centre_m": 532e-9, "fwhm_m": 3e-9, "peak": 0.8},
    "water": "none", "quantum_efficiency": "of the detector",
}  # fmt: skip


def lit(name: str, **light: Any) -> Scene:
    data = tomllib.loads((LIBRARY / f"{name}.toml").read_text())
    data["rig"].pop("ambient_e_per_s")
    data["rig"]["ambient"] = {k: v for k, v in (LIGHT | light).items() if v is not None}
    return load_scene(data)


def test_a_flat_spectrum_through_a_square_filter_is_the_closed_form() -> None:
    flat = {"wavelength_m": [400e-9, 700e-9], "value": [1.0, 1.0]}
    square = {"shape": "rectangular", "centre_m": 532e-9, "fwhm_m": 10e-9, "peak": 0.9}
    scene = lit(
        "flat-wall", illuminant=None, spectrum=flat, illuminance_lux=None, irradiance_w_per_m2=30.0, filter=square
    )
    # 30 W/m² over 300 nm; L = ρE/π; a pixel of 13 µm at F/2 with T = .8 and QE = .4.
    radiance = 0.5 / np.pi * 30.0 / 300e-9
    etendue = (13e-6) ** 2 * np.pi / (4 * 2.0**2) * 0.8
    low, high = 527e-9, 537e-9
    exact = etendue * radiance * 0.9 * 0.4 * 0.5 * (high**2 - low**2) / (PLANCK_J_S * C_M_PER_S)
    # The filter's edges are resolved to 1e-9 of a wavelength; the trapezoid of a line is exact.
    assert scene.rig.ambient_e_per_s == pytest.approx(exact, rel=1e-6)


def test_lux_are_counted_by_colour_science() -> None:
    wave, power = colorimetry.illuminant_spectrum("D65")
    scaled = power * 1000.0 / colorimetry.illuminance_of(wave, power)
    # Our own table of V(λ) at 10 nm, an independent path: 2e-3 for broad light.
    assert ambient.illuminance_lux(wave, scaled) == pytest.approx(1000.0, rel=3e-3)
    # CIE daylight by our own components: relative to 560 nm, as the CIE rounds them.
    ours = ambient.daylight_spectrum(wave, 6503.6)
    np.testing.assert_allclose(power, ours, atol=0.05)
    scene = lit("flat-wall")
    at = np.linspace(520e-9, 544e-9, 4801)
    spectral = np.interp(at, wave, ambient.scaled_to_lux(wave, ours, 1000.0))
    rate = ambient.photoelectron_rate(
        at, ambient.diffuse_radiance(spectral, 0.5), etendue_m2_sr=(13e-6) ** 2 * np.pi / 16 * 0.8,
        filter_transmission=ambient.band_filter(at, 532e-9, 3e-9, 0.8), quantum_efficiency=0.4,
    )  # fmt: skip
    assert scene.rig.ambient_e_per_s == pytest.approx(rate, rel=4e-3)


@pytest.mark.parametrize("name", ["flat-wall", "counter", "amcw"])
def test_every_rig_takes_it_and_keeps_it_as_it_was_given(name: str) -> None:
    scene = lit(name)
    assert scene.rig.ambient_e_per_s > 0
    again = Scene.model_validate_json(scene.model_dump_json())
    assert again == scene and "ambient_e_per_s" not in scene.model_dump()["rig"]
    assert declared_rig(scene)["ambient_e_per_s"] == scene.rig.ambient_e_per_s
    # Twice the light and half the transmission: what changes in the rig changes the rate.
    brighter = load_scene(scene, {"rig.ambient.illuminance_lux": 2000.0})
    assert brighter.rig.ambient_e_per_s == pytest.approx(2 * scene.rig.ambient_e_per_s, rel=1e-12)
    lens = "rig.camera.transmission" if name == "flat-wall" else "rig.receiver.transmission"
    assert load_scene(scene, {lens: 0.4}).rig.ambient_e_per_s == pytest.approx(
        0.5 * scene.rig.ambient_e_per_s, rel=1e-12
    )
    # The plain choice reads as it always did.
    assert "ambient" not in load_scene(name).model_dump()["rig"]


def test_a_rangers_etendue_is_that_of_lens_and_field() -> None:
    # Detector 400 µm behind 50 mm, lens 25 mm: A·Ω with Ω ≈ π (4 mrad)²; gated pixel for the same light: A_px π/(4F²).
    share = lit("counter").rig.ambient_e_per_s / lit("flat-wall").rig.ambient_e_per_s
    lens = np.pi * 0.025**2 / 4 * np.pi * 0.004**2
    assert share == pytest.approx(lens / ((13e-6) ** 2 * np.pi / 16), rel=2e-5)


def test_water_takes_its_share_down_and_back() -> None:
    dry = lit("flat-wall").rig.ambient_e_per_s
    one = {"source": "solonenko2015", "type": "II", "down_m": 5.0, "view_m": 0.0}
    down = lit("flat-wall", water=one).rig.ambient_e_per_s / dry
    # A 3 nm filter sees one K_d, that of 532 nm, within its slope of 1e-3 over the band.
    import jerlov

    assert down == pytest.approx(np.exp(-5.0 * jerlov.water("II", source="solonenko2015").kd(532.0)), rel=2e-3)
    both = lit("flat-wall", water=one | {"view_m": 3.0}).rig.ambient_e_per_s / dry
    back = lit("flat-wall", water=one | {"down_m": 0.0, "view_m": 3.0}).rig.ambient_e_per_s / dry
    assert both == pytest.approx(down * back, rel=1e-4) and back < 1
    pure = (
        lit("flat-wall", water={"source": "pure", "type": "sea", "down_m": 2.0, "view_m": 0.0}).rig.ambient_e_per_s
        / dry
    )
    assert 0.9 < pure < 0.92  # a + b/2 of about .046 1/m, 2 m


def test_a_black_body_and_a_spectral_efficiency() -> None:
    red = lit("flat-wall", illuminant=None, temperature_k=2856.0)
    a = lit("flat-wall", illuminant="A")
    # CIE illuminant A is a black body at 2856 K; the CIE's c₂ of its day differs by 5e-4.
    assert red.rig.ambient_e_per_s == pytest.approx(a.rig.ambient_e_per_s, rel=3e-3)
    efficiency = {"wavelength_m": [500e-9, 600e-9], "value": [0.2, 0.2]}
    assert lit("flat-wall", quantum_efficiency=efficiency).rig.ambient_e_per_s == pytest.approx(
        0.5 * lit("flat-wall").rig.ambient_e_per_s, rel=1e-6
    )


def test_it_reaches_the_capture() -> None:
    scene = load_scene(lit("flat-wall"), {"rig.camera.rows": 4, "rig.camera.cols": 4})
    plain = load_scene(
        "flat-wall", {"rig.camera.rows": 4, "rig.camera.cols": 4, "rig.ambient_e_per_s": scene.rig.ambient_e_per_s}
    )
    one, two = (generate(s, seed=3, capture_key=1) for s in (scene, plain))
    np.testing.assert_array_equal(one["counts"].values, two["counts"].values)
    assert json.loads(one.attrs["truth_scene"])["rig"]["ambient"]["illuminant"] == "D65"


@pytest.mark.parametrize(
    ("light", "says"),
    [
        ({"illuminant": "D66"}, "D65"),
        ({"illuminant": None}, "one of illuminant"),
        ({"temperature_k": 3000.0}, "one of illuminant"),
        ({"illuminance_lux": None}, "one of illuminance_lux"),
        ({"illuminance_lux": -1.0}, "at least 0"),
        ({"filter": None}, "must be given"),
        ({"water": {"source": "williamson2022", "type": "II", "down_m": 1.0, "view_m": 0.0}}, "no diffuse attenuation K_d"),
        ({"water": {"source": "pure", "type": "salt", "down_m": 1.0, "view_m": 0.0}}, "fresh"),
        (
            {
                "illuminant": None,
                "temperature_k": 3000.0,
                "filter": "none",
                "water": {"source": "pure", "type": "sea", "down_m": 1.0, "view_m": 0.0},
            },
            "no value for",
        ),
        ({"spectrum": {"wavelength_m": [5e-7, 4e-7], "value": [1.0, 1.0]}, "illuminant": None}, "ascend"),
    ],
)  # fmt: skip
def test_bad_light_is_refused_with_the_reason(light: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError) as caught:
        lit("flat-wall", **light)
    assert says in str(caught.value) or says in caught.value.allowed


DAY = {"shape": "gaussian", "centre_m": 850e-9, "fwhm_m": 10e-9, "peak": 0.9}
SILICON = {"wavelength_m": [400e-9, 600e-9, 1000e-9], "value": [0.3, 0.5, 0.1]}
LINE = {"wavelength_m": [600e-9, 640e-9, 680e-9], "value": [0.0, 1.0, 0.0]}
CUT = {"wavelength_m": [600e-9, 640e-9, 680e-9], "value": [0.0, 1.0, 0.5]}


@pytest.mark.parametrize(
    ("light", "says"),
    [
        ({"filter": DAY}, "not known above 780 nm"),
        ({"filter": DAY | {"centre_m": 785e-9}}, "not known above 780 nm"),
        ({"filter": DAY | {"centre_m": 776e-9, "shape": "rectangular"}}, "not known above 780 nm"),
        ({"filter": DAY | {"centre_m": 290e-9}}, "not known below 300 nm"),
        ({"filter": "none", "quantum_efficiency": SILICON}, "not known above 780 nm"),
        ({"filter": "none"}, "has no end"),
        (
            {"illuminant": None, "temperature_k": 5772.0, "filter": DAY | {"centre_m": 1550e-9}},
            "not known above 1200 nm",
        ),
        ({"illuminant": None, "spectrum": CUT, "filter": DAY | {"centre_m": 690e-9}}, "not known above 680 nm"),
    ],
)
def test_light_is_not_dark_where_its_spectrum_is_unknown(light: dict[str, Any], says: str) -> None:
    """Daylight at 808 and 905 nm was 0, and at 785 nm an eighth of its value: beyond a table is not dark but unknown."""
    with pytest.raises(InputError) as caught:
        lit("flat-wall", **light)
    assert says in caught.value.allowed


def test_a_table_that_ends_in_zero_is_dark_beyond() -> None:
    assert lit("flat-wall", illuminant=None, spectrum=LINE, filter=DAY).rig.ambient_e_per_s == 0.0
    # The tail of a Gaussian that reaches past the table by 1e-4 of its area is let pass: 770 nm ± 6.4 nm (3.6 σ) to 780.
    near = DAY | {"centre_m": 768e-9, "fwhm_m": 8e-9}
    assert lit("flat-wall", filter=near).rig.ambient_e_per_s > 0
    # What is not seen need not be known: an efficiency that ends at 760 nm, behind a wide filter.
    short = {"wavelength_m": [500e-9, 760e-9], "value": [0.3, 0.0]}
    assert lit("flat-wall", filter=DAY | {"fwhm_m": 100e-9}, quantum_efficiency=short).rig.ambient_e_per_s > 0


def test_ambient_light_is_told_once(capsys: pytest.CaptureFixture[str]) -> None:
    text = json.dumps(LIGHT)
    assert main(["scenes", "show", "flat-wall", "--set", f"rig.ambient={text}"]) == 2
    assert "either ambient_e_per_s or ambient" in capsys.readouterr().err
    data = tomllib.loads((LIBRARY / "flat-wall.toml").read_text())
    data["rig"].pop("ambient_e_per_s")
    with pytest.raises(InputError, match="ambient_e_per_s"):
        load_scene(data)
