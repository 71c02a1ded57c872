"""Scattered light of waveforms and AMCW samples against scipy's quadrature, closed forms and limits."""

from __future__ import annotations

import json
import warnings
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import quad
from scipy.special import expn

from beambench.captures.validate import validate
from beambench.generator.generate import GenerationWarning, generate
from beambench.generator.ranger.amcw_samples import amcw_ranger
from beambench.generator.ranger.footprint import Ranger
from beambench.generator.ranger.scatter import backscatter_ramp, forward_gain
from beambench.generator.ranger.waveform_signal import waveform_ranger
from beambench.generator.rays.trace import Tracer
from beambench.optics.constants import C_M_PER_S, PLANCK_J_S
from beambench.optics.correlation import detector_response, waveforms
from beambench.optics.water.beam import beam_halo
from beambench.optics.water.halo import forward_share
from beambench.optics.water.phase_forms import phase_density
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.medium_index import group_index
from beambench.scenes.rigs.amcw import amcw_rig
from beambench.scenes.rigs.waveform import waveform_rig
from beambench.scenes.scene import Scene

FF = {"kind": "fournier-forand", "index": 1.10, "slope": 3.58}
WATER: dict[str, Any] = {
    "medium.scattering_per_m": 0.3, "medium.absorption_per_m": 0.1, "medium.phase_function": FF,
    "rig.ambient_e_per_s": 0.0,
}  # fmt: skip
STARE = {"rig.record.shots": 2, "rig.record.scan_half_angle_rad": 0.0, "rig.laser.energy_fluctuation": 0.0,
         "rig.detector.dark_e_per_s": 0.0}  # fmt: skip


def beam(half_angle_rad: float, profile: str = "gaussian", offset: float = 0.0) -> dict[str, Any]:
    spec = {"profile": profile, "half_angle_rad": half_angle_rad, "offset_rad": [offset, 0.0]}
    return {"rig.laser.illumination": spec}


def water(name: str, **changes: Any) -> Scene:
    return load_scene(name, WATER | {k.replace("__", "."): v for k, v in changes.items()})


def made(scene: Scene, **arguments: Any) -> xr.Dataset:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GenerationWarning)
        return generate(scene, **({"seed": 1, "fidelity": "scatter", "truth_electrons": True} | arguments))


@pytest.mark.parametrize("half_angle", [2e-4, 4e-3, 0.06])
def test_the_gain_of_forward_scattering_is_its_integral_over_angle(half_angle: float) -> None:
    scene = load_scene("counter", WATER | beam(half_angle))
    phase, ranger, r = scene.medium.phase, waveform_ranger(scene), 4.0
    assert phase is not None
    theta = np.concatenate([[0.0], np.geomspace(1e-7, 1.35, 6001)])
    lamp, field = ranger.lamp, ranger.field_rad
    x = beam_halo(theta, lamp.profile, lamp.edge_rad, phase, 0.3 * r)
    y = beam_halo(theta, np.ones_like, field, phase, 0.3 * r)
    i, one, ring = lamp.profile(theta), theta <= field, 2 * np.pi * np.sin(theta)
    exact = np.trapezoid((i + x) * (one + y) * ring, theta) / np.trapezoid(i * one * ring, theta)
    # Tables of the halos are right to some 1e-3 of themselves; the edge of the field falls between two nodes here.
    assert forward_gain(scene, ranger, phase, r) == pytest.approx(exact, rel=3e-3)


def test_the_gain_has_its_limits() -> None:
    b, r = 0.3, 4.0
    every = np.exp(b * r * forward_share(load_scene("counter", WATER).medium.phase))  # type: ignore[arg-type]
    wide = {"rig.detector.active_diameter_m": 0.2}  # a field of 1.1 rad
    both = load_scene("counter", WATER | wide | beam(0.9, "flat-top"))
    pencil = load_scene("counter", WATER | wide | beam(1e-5))
    # What stays: light that leaves the beam for a place still in it counts, on both ways; some leaves at the edges.
    assert every**2 * 0.8 < forward_gain(both, waveform_ranger(both), both.medium.phase, r) < every**2  # type: ignore[arg-type]
    # A pencil within a wide field: all light scattered forward out is still lit, and seen from everywhere.
    assert every**2 * 0.8 < forward_gain(pencil, waveform_ranger(pencil), pencil.medium.phase, r) < every**2  # type: ignore[arg-type]
    narrow = load_scene("counter", WATER | {"rig.detector.active_diameter_m": 2e-6} | beam(1e-5))
    # A pencil seen through a pinhole keeps next to nothing of what is scattered.
    assert 1.0 < forward_gain(narrow, waveform_ranger(narrow), narrow.medium.phase, r) < 1.1  # type: ignore[arg-type]
    aside = load_scene("counter", WATER | beam(1e-3, "flat-top", 0.02))
    assert np.isinf(forward_gain(aside, waveform_ranger(aside), aside.medium.phase, r))  # type: ignore[arg-type]


def per_joule(scene: Scene, ranger: Ranger) -> float:
    """K b β̃(π) ∫_F I dΩ of a beam that lies in the field: photoelectrons per joule and metre of e^{−2cr}/r²."""
    area = np.pi * ranger.receiver.aperture_diameter_m**2 / 4
    joule = area * ranger.receiver.transmission * ranger.quantum_efficiency
    back = float(phase_density(scene.medium.phase, np.pi))  # type: ignore[arg-type]
    return joule * ranger.wavelength_m / (PLANCK_J_S * C_M_PER_S) * scene.medium.scattering_per_m * back


def test_single_backscatter_is_the_exponential_integral() -> None:
    scene = load_scene("counter", WATER | STARE | beam(1e-3, "flat-top"))
    ramp = backscatter_ramp(
        scene, waveform_ranger(scene), scene.medium.phase, Tracer(scene), step_m=0.02, furthest_m=np.inf,  # type: ignore[arg-type]
        forward=False,
    )  # fmt: skip
    near, k = 0.025, 2 * 0.4
    exact = per_joule(scene, waveform_ranger(scene)) * (expn(2, k * near) / near - expn(2, k * 4.0) / 4.0)
    # The wall is flat and the cone 1 mrad: r differs by 1e-6. The rays' lattice alone holds the beam's light to 2e-3 only.
    np.testing.assert_allclose(ramp.amplitude.sum(axis=1), exact, rtol=3e-4)
    index = group_index(scene.medium, 532e-9)
    assert ramp.tau.max() < 2 * index * 4.0 / C_M_PER_S, "nothing comes from behind the wall"
    # With forward scattering there is more at every range, and next to the lens as much.
    more = backscatter_ramp(
        scene, waveform_ranger(scene), scene.medium.phase, Tracer(scene), step_m=0.02, furthest_m=np.inf  # type: ignore[arg-type]
    )  # fmt: skip
    ratio = more.amplitude[0] / ramp.amplitude[0]
    assert (np.diff(ratio) > 0).all() and 1.0 < ratio[0] < 1.03 and ratio[-1] > 1.3


def test_the_waveform_of_the_ramp_is_its_convolution() -> None:
    early = {"rig.record.start_s": 4e-9, "rig.record.step_s": 5e-10, "rig.t0_s": 2e-10}
    narrow = {"kind": "henyey-greenstein", "g": 0.0}
    scene = load_scene("counter", WATER | STARE | early | beam(1e-3, "flat-top") | {"medium.phase_function": narrow})
    capture, echo = made(scene), made(scene, fidelity="direct")
    rig = waveform_rig(scene)
    veil = capture["truth_background"].values[0]
    index, k = group_index(scene.medium, 532e-9), 2 * 0.4
    pulse = waveforms.pulse_from_spec(rig.laser.pulse)
    edges = early["rig.record.start_s"] + 2e-10 + 5e-10 * (np.arange(rig.record.samples) - 0.5)

    def share(r: float, opening: float) -> float:
        t = opening - 2 * index * r / C_M_PER_S + (np.arange(64) + 0.5) / 64 * 5e-10
        return float(detector_response.detected_density(pulse, "gaussian", 3e-10, t).mean() * 5e-10)

    # Isotropic scattering keeps its light out of the beam and the field: the h of 1 mrad holds some 1e-3 of it.
    for sample in (6, 20, 50, 66, 70):
        centre = (edges[sample] + 2.5e-10) * C_M_PER_S / (2 * index)
        low, high = max(centre - 0.35, 0.025), min(centre + 0.35, 4.0)
        exact = quad(lambda r, e=edges[sample]: np.exp(-k * r) / r**2 * share(r, e), low, high, limit=100)[0]  # type: ignore[misc]
        exact *= per_joule(scene, waveform_ranger(scene)) * rig.laser.pulse_energy_j
        # Half σ cells, two points each.
        assert veil[sample] == pytest.approx(exact, rel=6e-3, abs=2e-3 * float(veil.max())), sample
    np.testing.assert_allclose(
        capture["truth_electrons"].values - capture["truth_background"].values,
        echo["truth_electrons"].values * (capture["truth_amplitude"] / echo["truth_amplitude"]).values[:, None],
        atol=4e-3 * float(echo["truth_electrons"].max()),
    )  # the wide halo's light comes a little later
    validate(capture)


def test_amcw_sees_the_fourier_component_of_the_ramp() -> None:
    scene = load_scene(
        "amcw", WATER | beam(1e-3, "flat-top") | {"medium.phase_function": {"kind": "henyey-greenstein", "g": 0.0},
        "rig.shots": 2, "rig.scan_half_angle_rad": 0.0, "rig.detector.dark_e_per_s": 0.0},
    )  # fmt: skip
    rig = amcw_rig(scene)
    with_ramp, echo = made(scene), made(scene, fidelity="direct")
    gain = float(with_ramp["truth_amplitude"].values[0] / echo["truth_amplitude"].values[0])
    veil = with_ramp["truth_electrons"].values[0].astype(float) - gain * echo["truth_electrons"].values[0]
    turn = np.exp(1j * with_ramp["phase"].values)
    index, k = group_index(scene.medium, 532e-9), 2 * 0.4
    watts = per_joule(scene, amcw_ranger(scene)) * rig.laser.power_w * rig.modulation.integration_s
    depth = 0.5 * rig.laser.modulation_depth * rig.detector.demodulation_contrast
    for number, frequency in enumerate(rig.modulation.frequencies_hz):
        omega = 2 * np.pi * frequency * 2 * index / C_M_PER_S
        real = quad(lambda r, w=omega: np.exp(-k * r) / r**2 * np.cos(w * r), 0.025, 4.0, limit=400)[0]  # type: ignore[misc]
        imaginary = quad(lambda r, w=omega: np.exp(-k * r) / r**2 * np.sin(w * r), 0.025, 4.0, limit=400)[0]  # type: ignore[misc]
        found = 2.0 * (veil[number] * turn).mean()
        exact = 0.5 * watts * depth * complex(real, imaginary)
        mean = 0.5 * watts * (expn(2, k * 0.025) / 0.025 - expn(2, k * 4.0) / 4.0)
        # float32 expectations of an echo as bright as the ramp, and .1-.3 % of isotropic light within beam and field.
        assert veil[number].mean() == pytest.approx(mean, rel=6e-3)
        assert abs(found - exact) < 6e-3 * abs(mean * depth), frequency


@pytest.mark.parametrize("name", ["counter", "single-photon", "amcw"])
def test_without_scattering_the_rungs_are_one_to_the_bit(name: str) -> None:
    scene = load_scene(name, {"medium.scattering_per_m": 0.0})
    one, two = made(scene), made(scene, fidelity="direct")
    xr.testing.assert_identical(one.drop_attrs(), two.drop_attrs())


@pytest.mark.parametrize("name", ["counter", "single-photon", "amcw"])
def test_noise_follows_the_brighter_light_and_effects_are_told(name: str) -> None:
    shots = "rig.shots" if name == "amcw" else "rig.record.shots"
    scene = load_scene(name, WATER | {shots: 6})
    one, two = made(scene, rtol=0.01), made(scene, rtol=0.01)
    xr.testing.assert_identical(one.drop_attrs(), two.drop_attrs())
    fidelity = json.loads(one.attrs["fidelity"])
    effects = {e["name"]: e for e in fidelity["effects"]}
    assert fidelity["rung"] == "scatter" and json.loads(one.attrs["provenance"])
    assert effects["forward-scattered light"]["modelled"] and effects["volume backscatter"]["modelled"]
    assert (
        not effects["multiple scattering"]["modelled"]
        and 0 < effects["multiple scattering"]["predicted_relative_size"] < 1
    )
    plain = made(scene, rtol=0.01, fidelity="direct")
    gain = float((one["truth_amplitude"] / plain["truth_amplitude"]).values[0])
    assert gain == pytest.approx(1 + effects["forward-scattered light"]["predicted_relative_size"], rel=0.02)
    assert (one["truth_electrons"].values >= 0).all() and np.isfinite(one["truth_electrons"].values).all()


def test_a_beam_outside_the_field_is_seen_by_its_scattered_light() -> None:
    scene = load_scene("counter", WATER | STARE | beam(1e-3, "flat-top", 0.02))
    capture = made(scene)
    assert float(capture["truth_amplitude"].values[0]) > 0
    with pytest.warns(GenerationWarning, match="no light"):
        generate(scene, seed=1)


def test_a_medium_that_scatters_needs_its_phase_function() -> None:
    for name in ("counter", "amcw"):
        with pytest.raises(InputError, match="phase function"):
            generate(load_scene(name), seed=1, fidelity="scatter")
