"""Generated waveforms against closed forms: delay, energy, shape, noise, pile-up; determinism, and refused scenes."""

from __future__ import annotations

import json
import warnings
from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.captures.validate import validate
from beambench.generator.generate import GenerationWarning, generate
from beambench.generator.ranger.footprint import sunflower_cone
from beambench.optics import pile_up
from beambench.optics.constants import C_M_PER_S, PLANCK_J_S
from beambench.optics.correlation import detector_response, waveforms
from beambench.scenes.declared import declared_rig
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.medium_index import group_index
from beambench.scenes.rigs.waveform import waveform_rig

#: One ray's worth of beam: its footprint is flat and its echo a point's.
PENCIL = {
    "rig.laser.illumination": {"profile": "flat-top", "half_angle_rad": 1e-5, "offset_rad": [0.0, 0.0]},
    "rig.laser.energy_fluctuation": 0.0,
    "rig.record.shots": 4,
}


def make(scene: str, changes: dict[str, Any] | None = None, **arguments: Any) -> tuple[xr.Dataset, Any]:
    loaded = load_scene(scene, changes or {})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GenerationWarning)
        return generate(loaded, **({"seed": 1} | arguments)), loaded


@pytest.mark.parametrize("pulse", [
    {"kind": "gaussian", "fwhm_s": 1e-9},
    {"kind": "trapezoidal", "rise_s": 0.3e-9, "top_s": 0.5e-9, "fall_s": 1.2e-9},
    {"kind": "exponential", "fwhm_s": 0.6e-9, "tail_s": 0.8e-9},
])  # fmt: skip
@pytest.mark.parametrize("shape", ["gaussian", "single-pole"])
def test_a_point_echo_is_pulse_and_response_at_twice_the_range(pulse: dict[str, Any], shape: str) -> None:
    changes = PENCIL | {"rig.laser.pulse": pulse, "rig.detector.response": {"shape": shape, "rise_time_s": 3e-10},
                        "rig.ambient_e_per_s": 0.0, "rig.detector.dark_e_per_s": 0.0,
                        "rig.record.scan_half_angle_rad": 0.0, "rig.t0_s": 0.3e-9}  # fmt: skip
    capture, scene = make("counter", changes, truth_electrons=True)
    rig = waveform_rig(scene)
    index = group_index(scene.medium, 532e-9)
    tau = 2 * index * 4.0 / C_M_PER_S
    # Sample k holds the charge of its interval; the quadrature of the convolution knows no correlation table.
    optic = waveforms.pulse_from_spec(rig.laser.pulse)
    edges = capture["time"].values - 0.5 * rig.record.step_s
    fine = (np.arange(400) + 0.5) / 400 * rig.record.step_s
    density = detector_response.detected_density(optic, rig.detector.response.shape, 3e-10, edges[:, None] + fine - tau)
    share = density.mean(axis=1) * rig.record.step_s
    found = capture["truth_electrons"].values[0] / capture["truth_amplitude"].values[0]
    # Tables of R are right to 1e-5 of their peak; Mitsuba's float32 ray is 2 µm (.02 ps) off: 5e-5 at the steepest.
    assert np.abs(found - share).max() < 1.5e-4 * share.max()
    assert found.sum() == pytest.approx(1.0, abs=2e-4)
    assert capture["truth_range"].values == pytest.approx(4.0, abs=1e-5)
    # The time axis is declared: the record starts at its setting plus t0.
    assert capture["time"].values[0] == pytest.approx(rig.record.start_s + 0.3e-9, abs=1e-18)


def test_energy_of_the_echo_is_the_ladar_equation() -> None:
    capture, scene = make("counter", PENCIL | {"rig.record.scan_half_angle_rad": 0.0})
    rig = waveform_rig(scene)
    c = scene.medium.attenuation_per_m
    # All light of a narrow beam, square on a Lambert wall: E ρ/π A/r² e^(−2cr) T QE λ/(hc).
    area = np.pi * rig.receiver.aperture_diameter_m**2 / 4
    joule = rig.laser.pulse_energy_j * 0.4 / np.pi * area / 16.0 * np.exp(-2 * c * 4.0)
    exact = joule * rig.receiver.transmission * rig.detector.quantum_efficiency * 532e-9 / (PLANCK_J_S * C_M_PER_S)
    assert capture["truth_amplitude"].values == pytest.approx(exact, rel=1e-4)


def test_the_field_of_view_cuts_a_wide_beam() -> None:
    # A flat beam of 20 mrad through a field of 4 mrad: a share of (4/20)² in solid angle.
    wide = {"profile": "flat-top", "half_angle_rad": 0.02, "offset_rad": [0.0, 0.0]}
    narrow, _ = make("counter", PENCIL | {"rig.record.scan_half_angle_rad": 0.0})
    cut, _ = make("counter", PENCIL | {"rig.record.scan_half_angle_rad": 0.0, "rig.laser.illumination": wide})
    share = float((cut["truth_amplitude"] / narrow["truth_amplitude"]).values[0])
    assert share == pytest.approx((np.arctan(0.004) / 0.02) ** 2, rel=1e-4)
    # A beam beside the field is not seen at all.
    aside = wide | {"half_angle_rad": 1e-3, "offset_rad": [0.01, 0.0]}
    with pytest.warns(GenerationWarning, match="no light"):
        generate(load_scene("counter", PENCIL | {"rig.laser.illumination": aside}), seed=1)


def test_a_tilted_wall_stretches_the_echo_by_its_footprint() -> None:
    # Flat beam of half angle θ on a wall tilted by β: ranges z(1 + tanβ·x), x over a disc: variance (zθ tanβ)²/4.
    flat = {"profile": "flat-top", "half_angle_rad": 2e-3, "offset_rad": [0.0, 0.0]}
    changes = {"rig.laser.illumination": flat, "target.0.shape.tilt_y_deg": 60.0, "target.0.material.kind": "lambert",
               "target.0.shape.width_m": 20.0, "rig.record.scan_half_angle_rad": 0.0, "rig.record.shots": 1,
               "rig.laser.energy_fluctuation": 0.0}  # fmt: skip
    capture, scene = make("counter", changes, truth_electrons=True, rtol=1e-3)
    flat_on, _ = make("counter", changes | {"target.0.shape.tilt_y_deg": 0.0}, truth_electrons=True)
    t = capture["time"].values

    def moments(data: xr.Dataset) -> tuple[float, float]:
        w = data["truth_electrons"].values[0].astype(float) - float(data["truth_background"].values[0])
        mean = (w * t).sum() / w.sum()
        return mean, (w * (t - mean) ** 2).sum() / w.sum()

    per_m = 2 * group_index(scene.medium, 532e-9) / C_M_PER_S
    extra = moments(capture)[1] - moments(flat_on)[1]
    # Lambert's cosine and 1/r² change over the footprint by some 1e-2: so does the variance.
    assert extra == pytest.approx((4.0 * 2e-3 * np.tan(np.radians(60)) / 2 * per_m) ** 2, rel=0.02, abs=0.0)


def test_the_lattice_is_even_and_converges() -> None:
    for half in (1e-5, 0.02, 0.5):
        direction, solid = sunflower_cone(half, 4096)
        np.testing.assert_allclose(np.linalg.norm(direction, axis=0), 1.0, atol=1e-12)
        assert solid * 4096 == pytest.approx(2 * np.pi * (1 - np.cos(half)), rel=1e-5)
        # ⟨θ²⟩ of a small disc is half²/2; the lattice balances about its axis to 1e-2 of its radius.
        assert np.abs(direction[:2].mean(axis=1)).max() < 1e-2 * half
    theta = np.hypot(*sunflower_cone(0.02, 4096)[0][:2])
    assert (theta**2).mean() == pytest.approx(0.02**2 / 2, rel=1e-3)
    exact = 0.5 * 0.01**2 / 0.02**2 * (1 - np.exp(-2 * 0.02**2 / 0.01**2))
    assert np.exp(-2 * (theta / 0.01) ** 2).mean() == pytest.approx(exact, rel=1e-3)


def test_analog_noise_has_its_mean_and_variance() -> None:
    changes = PENCIL | {"rig.record.shots": 4000, "rig.record.scan_half_angle_rad": 0.0,
                        "rig.detector.readout.read_noise_e": 5.0, "rig.detector.readout.gain_dn_per_e": 2.0,
                        "rig.ambient_e_per_s": 4e10}  # fmt: skip
    capture, _ = make("counter", changes, truth_electrons=True, rtol=0.01)
    expected = capture["truth_electrons"].values[0].astype(float)
    signal = capture["signal"].values.astype(float)
    variance = 4.0 * (expected + 25.0) + 1 / 12
    z = (signal.mean(axis=0) - (2 * expected + 40.0)) / np.sqrt(variance / 4000)
    # 128 samples, each of 4000 draws: the largest of 128 normal z is below 4.5 but once in 1000; χ² per sample ±.28.
    assert np.abs(z).max() < 4.5 and (z**2).mean() == pytest.approx(1.0, abs=4 * np.sqrt(2 / 128))
    ratio = signal.var(axis=0) / variance
    assert np.abs(ratio - 1).max() < 4.5 * np.sqrt(2 / 4000) and ratio.mean() == pytest.approx(1.0, abs=0.008)
    neighbours = np.corrcoef(signal[:, 10], signal[:, 11])[0, 1]
    assert abs(neighbours) < 4.5 / np.sqrt(4000)


def test_an_avalanche_multiplies_noise_by_its_excess() -> None:
    tube = {"gain": 50.0, "excess_noise_factor": 4.0}
    changes = PENCIL | {"rig.record.shots": 3000, "rig.record.scan_half_angle_rad": 0.0, "rig.detector.readout.avalanche": tube,
                        "rig.detector.readout.gain_dn_per_e": 0.02, "rig.detector.readout.adc_bits": 16,
                        "rig.detector.readout.read_noise_e": 0.0, "rig.ambient_e_per_s": 4e11}  # fmt: skip
    capture, _ = make("counter", changes, truth_electrons=True, rtol=0.01)
    expected = capture["truth_electrons"].values[0].astype(float)
    signal = capture["signal"].values.astype(float) - 40.0
    assert signal.mean() == pytest.approx(expected.mean(), rel=3e-3)
    ratio = (signal.var(axis=0) - 1 / 12) / (4.0 * expected)
    assert ratio.mean() == pytest.approx(1.0, abs=4 * np.sqrt(2 / 3000 / 128) * 1.5)


@pytest.mark.parametrize("dead_s", [0.0, 2e-10, 1e-9, 1.0])  # one bin more or less shows best in the second
def test_single_photon_histograms_pile_up_as_the_law_says(dead_s: float) -> None:
    changes = PENCIL | {"rig.record.shots": 400, "rig.record.scan_half_angle_rad": 0.0,
                        "rig.detector.readout.dead_time_s": dead_s}  # fmt: skip
    capture, scene = make("single-photon", changes, truth_electrons=True, rtol=0.01)
    pulses = waveform_rig(scene).pulses_per_shot
    rate = capture["truth_electrons"].values[0].astype(float) / pulses
    dead = pile_up.dead_bins(dead_s, 1e-10, rate.size)
    expected, live = pile_up.expected_counts(rate, pulses, dead)
    counts = capture["signal"].values.astype(float)
    # Binomial in M pulses; bins of one pulse exclude each other, which only lowers the variance of long dead times.
    spread = np.sqrt(expected / pulses * (1 - expected / pulses) * pulses / 400) + 1e-12
    z = (counts.mean(axis=0) - expected) / spread
    assert np.abs(z[expected > 0.05]).max() < 4.5
    if dead_s >= 1e-9:
        assert live.min() < 0.75 * pulses and counts.sum(axis=1).max() <= (pulses if dead_s == 1.0 else np.inf)
    assert capture["signal"].dtype == np.uint16


def test_energy_fluctuation_and_jitter_belong_to_the_shot() -> None:
    changes = PENCIL | {"rig.record.shots": 3000, "rig.record.scan_half_angle_rad": 0.0, "rig.laser.energy_fluctuation": 0.1,
                        "rig.laser.jitter_shot_s": 0.2e-9}  # fmt: skip
    capture, _ = make("counter", changes, truth_electrons=True, rtol=0.01)
    light = capture["truth_electrons"].values.astype(float) - capture["truth_background"].values[:, None]
    energy = light.sum(axis=1) / capture["truth_amplitude"].values
    assert energy.mean() == pytest.approx(1.0, abs=4 * 0.1 / np.sqrt(3000))
    assert energy.std() == pytest.approx(0.1, rel=4 / np.sqrt(6000))
    centre = (light * capture["time"].values).sum(axis=1) / light.sum(axis=1)
    assert centre.std() == pytest.approx(0.2e-9, rel=4 / np.sqrt(6000))


def test_jitter_of_pulses_broadens() -> None:
    base = PENCIL | {"rig.record.shots": 1, "rig.record.scan_half_angle_rad": 0.0}
    widths = []
    for jitter in (0.0, 0.4e-9):
        capture, _ = make("single-photon", base | {"rig.laser.jitter_pulse_s": jitter}, truth_electrons=True)
        w = capture["truth_electrons"].values[0] - capture["truth_background"].values[0]
        t = capture["time"].values
        mean = (w * t).sum() / w.sum()
        widths.append((w * (t - mean) ** 2).sum() / w.sum())
    # Differences of float32 sums: 1e-3.
    assert widths[1] - widths[0] == pytest.approx(0.16e-18, rel=3e-3, abs=0.0)


def test_same_bits_for_equal_seeds_and_other_noise_for_others() -> None:
    for name in ("counter", "single-photon"):
        small = {"rig.record.shots": 40}
        one, _ = make(name, small, seed=5)
        two, _ = make(name, small, seed=5)
        other, _ = make(name, small, seed=6)
        xr.testing.assert_identical(one.drop_attrs(), two.drop_attrs())
        assert (one["signal"] != other["signal"]).any()
        validate(one)
        # Shots are drawn in blocks of 16: the first block does not change with the number of shots.
        fewer, _ = make(name, {"rig.record.shots": 40, "rig.record.scan_half_angle_rad": 0.0}, seed=5, capture_key=3)
        more, _ = make(name, {"rig.record.shots": 64, "rig.record.scan_half_angle_rad": 0.0}, seed=5, capture_key=3)
        np.testing.assert_array_equal(fewer["signal"].values[:16], more["signal"].values[:16])


def test_declared_rig_shows_samples_and_what_was_declared_wrong() -> None:
    scene = load_scene(
        "counter", {"declared": {"t0_s": 1e-10, "medium.index": {"kind": "explicit", "phase": 1.33, "group": 1.33}}}
    )
    rig = declared_rig(scene)
    assert rig["t0_s"] == 1e-10 and rig["medium"]["group_index"] == 1.33
    value, step = np.array(rig["response"]["value"]), rig["response"]["step_s"]
    assert value.sum() * step == pytest.approx(1.0, abs=1e-6)
    capture = generate(scene, seed=1)
    assert json.loads(capture.attrs["rig"])["t0_s"] == 1e-10
    assert capture["time"].values[0] == pytest.approx(30e-9 + 1e-10, abs=1e-18)


def test_effects_are_listed_and_neglected_scatter_is_told() -> None:
    with pytest.warns(GenerationWarning, match="forward-scattered"):
        capture = generate(load_scene("counter", {"medium.scattering_per_m": 0.1, "rig.record.shots": 2}), seed=1)
    effects = {e["name"]: e for e in json.loads(capture.attrs["fidelity"])["effects"]}
    assert effects["detector's impulse response"]["modelled"] and not effects["volume backscatter"]["modelled"]
    assert effects["forward-scattered light"]["predicted_relative_size"] == pytest.approx(np.expm1(0.8), rel=0.05)


@pytest.mark.parametrize(("changes", "where"), [
    ({"rig.record.samples": 2}, "rig.record.samples"),
    ({"rig.laser.pulse_energy_j": -1.0}, "rig.laser.pulse_energy_j"),
    ({"rig.detector.response.rise_time_s": 0.0}, "rig.detector.response.rise_time_s"),
    ({"rig.detector.readout.kind": "film"}, "rig.detector.readout"),
    ({"rig.delays": 3}, "rig.delays"),
])  # fmt: skip
def test_impossible_rigs_are_refused_by_their_path(changes: dict[str, Any], where: str) -> None:
    with pytest.raises(InputError) as error:
        load_scene("counter", changes)
    assert where in error.value.where and "rig.waveform" not in str(error.value)


def test_a_gated_function_refuses_a_waveform_scene() -> None:
    from beambench.generator.gated.direct import render_direct

    with pytest.raises(InputError, match="gated"):
        render_direct(load_scene("counter"), 1e-2)
