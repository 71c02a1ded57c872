"""Values that no instrument can have are refused when the scene is loaded, with path and limits; unusual ones are not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from beambench.generator.detector import FixedPattern, detect
from beambench.optics.correlation.waveforms import GaussianPulse, RectangularGate, sample_pulse
from beambench.scenes.declared import declared_rig
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.overrides import apply_overrides, parse_assignments
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.sampling import MOST_SAMPLES, response_table

BAD = [
    ("flat-wall", "rig.laser.jitter_frame_s", 1e300),
    ("flat-wall", "rig.laser.jitter_shot_s", 100.0),
    ("flat-wall", "rig.laser.pulse.fwhm_s", 5.0),
    ("flat-wall", "rig.laser.pulse.fwhm_s", 1e300),
    ("flat-wall", "rig.laser.pulse.fwhm_s", 1e-20),
    ("flat-wall", "rig.laser.pulse_energy_j", 1e300),
    ("flat-wall", "rig.laser.position_m", [0.0, 1e300, 0.0]),
    ("flat-wall", "rig.camera.pixel_pitch_m", 1e300),
    ("flat-wall", "rig.camera.focal_length_m", 1e-300),
    ("flat-wall", "rig.camera.f_number", 1e300),
    ("flat-wall", "rig.camera.f_number", 1e-300),
    ("flat-wall", "rig.delays.start_s", 1e300),
    ("flat-wall", "rig.t0_s", -1e300),
    ("flat-wall", "rig.pulses_per_slice", 10**30),
    ("flat-wall", "rig.detector.exposure_s", 1e300),
    ("flat-wall", "rig.detector.full_well_e", 1e300),
    ("flat-wall", "rig.ambient_e_per_s", 1e300),
    ("flat-wall", "rig.gates.0.transmission", 1e-300),
    ("counter", "rig.laser.pulse_energy_j", 1e300),
    ("counter", "rig.receiver.focal_length_m", 1e-300),
    ("counter", "rig.detector.response.rise_time_s", 1.0),
    ("counter", "rig.record.start_s", 1e300),
    ("single-photon", "rig.detector.readout.dead_time_s", 1e300),
    ("amcw", "rig.laser.power_w", 1e300),
    ("amcw", "rig.modulation.frequencies_hz", [1e300]),
    ("amcw", "rig.range_window_m", [0.0, 1e300]),
]


@pytest.mark.parametrize(("scene", "path", "value"), BAD)
def test_impossible_values_are_refused_with_their_limit(scene: str, path: str, value: Any) -> None:
    with pytest.raises(InputError) as told:
        load_scene(scene, {path: value})
    last = [part for part in path.split(".") if not part.isdigit()][-1]
    assert (
        last in told.value.where and told.value.allowed.startswith(("at least ", "at most ")) and told.value.next_step
    )


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("rig.laser.pulse.fwhm_s", 2e-12),
        ("rig.laser.jitter_frame_s", 1e-3),
        ("rig.camera.f_number", 0.5),
        ("rig.camera.f_number", 1000.0),
        ("rig.camera.pixel_pitch_m", 1e-3),
        ("rig.laser.pulse_energy_j", 1e3),
        ("rig.laser.pulse_energy_j", 1e-19),
    ],
)
def test_what_could_be_built_is_allowed(path: str, value: float) -> None:
    declared_rig(load_scene("flat-wall", {path: value}))


def test_pulse_and_gates_that_cannot_be_declared_are_refused_as_the_scene_is_loaded() -> None:
    with pytest.raises(InputError, match="too many") as told:
        load_scene("flat-wall", {"rig.gates.0.width_s": 1e-3, "rig.detector.exposure_s": 1.0})
    assert told.value.where == "flat-wall: rig.gates.0" and str(MOST_SAMPLES) in told.value.allowed
    with pytest.raises(InputError, match="too short") as told:
        load_scene("flat-wall", {"rig.laser.pulse.fwhm_s": 1e-15})
    assert told.value.where == "flat-wall: rig.laser.pulse"


def test_a_response_that_cannot_be_tabulated_is_told_with_its_gate() -> None:
    # 2²¹ cells over 1 ms are 5·10⁻¹⁰ s each: a pulse of 1 ps lies within one.
    with pytest.raises(InputError, match="tabulated") as told:
        response_table(GaussianPulse(1e-12), RectangularGate(1e-3, 1.0), 1e-4, "wall: rig.gates.0")
    assert told.value.where == "wall: rig.gates.0" and "rtol" in str(told.value.value)


def test_samples_of_a_pulse_are_bounded() -> None:
    with pytest.raises(ValueError, match="more than"):
        sample_pulse(GaussianPulse(5.0), 1e-12)


def test_light_beyond_all_numbers_fills_the_well_or_is_told() -> None:
    detector = gated_rig(load_scene("flat-wall")).detector
    pattern = FixedPattern(np.ones((2, 2), dtype=np.float32), np.zeros((2, 2), dtype=np.float32))
    flood = np.full((1, 2, 2), np.inf, dtype=np.float32)
    full = min(detector.full_well_e * detector.gain_dn_per_e + detector.offset_dn, 2.0**detector.adc_bits - 1)
    # The well is full in every pixel; read noise moves the count by no more than six of its σ.
    slack = 6 * detector.read_noise_e * detector.gain_dn_per_e + 1
    assert np.all(np.abs(detect(flood, detector, pattern, 1, 0) - full) <= slack)
    flood[0, 0, 0] = np.nan
    with pytest.raises(InputError, match="no number"):
        detect(flood, detector, pattern, 1, 0)


@pytest.mark.parametrize("text", ["NaN", "Infinity", "-Infinity", "1e999", "[1, 1e999]"])
def test_a_number_that_is_none_is_told_with_its_path_and_what_to_do(text: str) -> None:
    with pytest.raises(InputError, match="finite") as told:
        parse_assignments([f"rig.laser.pulse.fwhm_s={text}"])
    assert told.value.where == "--set rig.laser.pulse.fwhm_s"
    assert told.value.allowed and "rig.laser.pulse.fwhm_s" in told.value.next_step


def test_overrides_of_another_kind_are_told() -> None:
    with pytest.raises(InputError, match="text"):
        apply_overrides({}, {5: 1})  # type: ignore[dict-item]
    with pytest.raises(InputError, match="table"):
        apply_overrides({}, ["a=1"])  # type: ignore[arg-type]
    with pytest.raises(InputError, match="list"):
        parse_assignments("rig.camera.rows=1")


@pytest.mark.parametrize("key", ["--1", "²", "9", "-9", "", "9" * 5000])
def test_a_key_that_is_no_place_in_a_list_is_told(key: str) -> None:
    with pytest.raises(InputError, match="names an element that the list does not have") as told:
        apply_overrides({"target": [{"name": "wall"}]}, {f"target.{key}.name": "x"})
    assert told.value.allowed == "0..0, wall" and told.value.next_step
