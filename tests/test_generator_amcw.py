"""Generated AMCW samples against the closed form, their noise, ambiguity and determinism, and refused rigs."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.captures.validate import validate
from beambench.generator.generate import generate
from beambench.optics.amcw import correlation_sample
from beambench.optics.constants import C_M_PER_S, PLANCK_J_S
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.medium_index import group_index
from beambench.scenes.rigs.amcw import amcw_rig

PENCIL: dict[str, Any] = {
    "rig.laser.illumination": {"profile": "flat-top", "half_angle_rad": 1e-5, "offset_rad": [0.0, 0.0]},
    "rig.scan_half_angle_rad": 0.0,
    "rig.shots": 4,
}


def test_samples_of_a_point_are_the_closed_form() -> None:
    scene = load_scene("amcw", PENCIL | {"rig.t0_s": 0.4e-9, "rig.modulation.phase_steps": 5})
    capture = generate(scene, seed=1, truth_electrons=True)
    rig = amcw_rig(scene)
    area = np.pi * 0.025**2 / 4
    watt = 5e-3 * 0.4 / np.pi * area / 16.0 * np.exp(-2 * scene.medium.attenuation_per_m * 4.0)
    electrons = watt * 5e-6 * 0.8 * 0.4 * 532e-9 / (PLANCK_J_S * C_M_PER_S)
    tau = 2 * group_index(scene.medium, 532e-9) * 4.0 / C_M_PER_S - 0.4e-9
    phase = 2 * np.pi * np.arange(5) / 5
    f = np.asarray(rig.modulation.frequencies_hz)[:, None]
    # The detector is open half of the time: half of the light, half of the ambient light, all of the dark current.
    exact = correlation_sample(electrons / 2, 0.9 * 0.8 / 2, tau, f, phase) + (0.5 * 1e6 + 1e5) * 5e-6
    assert capture["truth_amplitude"].values == pytest.approx(electrons / 2, rel=1e-4)
    # 2 µm of a float32 ray are 2e-5 rad at 200 MHz.
    np.testing.assert_allclose(capture["truth_electrons"].values[0], exact, rtol=1e-4)
    np.testing.assert_allclose(capture["phase"].values, phase)
    validate(capture)


def test_ranges_half_a_wavelength_apart_give_the_same_samples() -> None:
    scene = load_scene("amcw", PENCIL | {"rig.modulation.frequencies_hz": [1e8], "medium.absorption_per_m": 0.0,
                                         "medium.scattering_per_m": 0.0})  # fmt: skip
    half = C_M_PER_S / (2 * group_index(scene.medium, 532e-9) * 1e8)
    near = generate(scene, seed=1, truth_electrons=True)
    far_scene = load_scene(scene, {"target.0.shape.center_m": [0.0, 0.0, 4.0 + half]})
    far = generate(far_scene, seed=1, truth_electrons=True)
    background = (0.5 * 1e6 + 1e5) * 5e-6
    ratio = (near["truth_electrons"].values - background) / (far["truth_electrons"].values - background)
    # But for 1/r² they are equal.
    np.testing.assert_allclose(ratio, ((4.0 + half) / 4.0) ** 2, rtol=3e-4)


def test_a_deep_footprint_loses_contrast() -> None:
    # A beam of half angle θ on a steep wall: phases spread over a disc, |J₁(k)/(k/2)| of the modulation is left,
    # k = half the spread of ωτ.
    wide = {"profile": "flat-top", "half_angle_rad": 3.9e-3, "offset_rad": [0.0, 0.0]}
    changes = PENCIL | {"rig.laser.illumination": wide, "target.0.shape.tilt_y_deg": 80.0,
                        "target.0.shape.width_m": 60.0, "medium.absorption_per_m": 0.0}  # fmt: skip
    scene = load_scene("amcw", changes)
    capture = generate(scene, seed=1, truth_electrons=True)
    from scipy.special import j1

    z = capture["truth_electrons"].values[0]
    phasor = np.abs((z * np.exp(1j * capture["phase"].values)).sum(axis=1)) / 2
    contrast = phasor / capture["truth_amplitude"].values[0] / 0.36
    omega = 2 * np.pi * np.asarray(amcw_rig(scene).modulation.frequencies_hz)
    k = omega * 2 * group_index(scene.medium, 532e-9) / C_M_PER_S * 4.0 * 3.9e-3 * np.tan(np.radians(80.0))
    # cosθ and 1/r² change by 5 % across this footprint: second order in the modulus, plus 1e-3 of the lattice.
    np.testing.assert_allclose(contrast, np.abs(2 * j1(k) / k), atol=0.01)
    assert contrast[0] > 0.999 and contrast[2] < 0.9


def test_noise_is_poisson_and_read() -> None:
    scene = load_scene("amcw", PENCIL | {"rig.shots": 4000})
    capture = generate(scene, seed=2, truth_electrons=True, rtol=0.01)
    expected = capture["truth_electrons"].values[0].astype(float)
    counts = capture["samples"].values.astype(float)
    variance = 0.25 * (expected + 25.0) + 1 / 12
    z = (counts.mean(axis=0) - (0.5 * expected + 100)) / np.sqrt(variance / 4000)
    assert np.abs(z).max() < 4
    assert np.abs(counts.var(axis=0) / variance - 1).max() < 4.5 * np.sqrt(2 / 4000)
    assert np.abs(np.corrcoef(counts.reshape(4000, -1).T) - np.eye(12)).max() < 5 / np.sqrt(4000)


def test_equal_seeds_give_equal_bits_and_the_rig_is_declared() -> None:
    scene = load_scene("amcw", {"rig.shots": 20, "declared": {"t0_s": 1e-9}, "rig.laser.power_fluctuation": 0.1})
    one, two, other = generate(scene, seed=1), generate(scene, seed=1), generate(scene, seed=2)
    xr.testing.assert_identical(one.drop_attrs(), two.drop_attrs())
    assert (one["samples"] != other["samples"]).any()
    rig = json.loads(one.attrs["rig"])
    assert rig["t0_s"] == 1e-9 and rig["range_window_m"] == [0.5, 55.0] and rig["kind"] == "amcw"
    effects = {e["name"]: e for e in json.loads(one.attrs["fidelity"])["effects"]}
    assert effects["power fluctuation"]["modelled"]


@pytest.mark.parametrize(("changes", "where"), [
    ({"rig.modulation.frequencies_hz": [1e6, 1e6]}, "rig.modulation"),
    ({"rig.modulation.phase_steps": 2}, "rig.modulation.phase_steps"),
    ({"rig.range_window_m": [5.0, 4.0]}, "rig"),
    ({"rig.laser.modulation_depth": 1.5}, "rig.laser.modulation_depth"),
])  # fmt: skip
def test_impossible_rigs_are_refused(changes: dict[str, Any], where: str) -> None:
    with pytest.raises(InputError) as error:
        load_scene("amcw", changes)
    assert where in error.value.where


def test_the_full_rung_is_refused_and_not_silently_left_out() -> None:
    for name in ("amcw", "counter"):
        scene = load_scene(name)
        with pytest.raises(InputError, match=f"'full' is not built for {scene.modality} scenes"):
            generate(scene, seed=1, fidelity="full")
