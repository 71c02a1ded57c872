"""The path tracer against what shares nothing with it: an integrating sphere in closed form, mitransient; and its finite lens and
lamp against closed forms. (Multiply scattered light to 1 %: `test_generator_walk_percent.py`.)"""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from beambench.generator.bsdf.plugin import mitsuba_bsdf
from beambench.generator.gated.gates import gate_tables
from beambench.generator.gated.view import view_of
from beambench.generator.paths.single import single_electrons
from beambench.generator.paths.world import PathWorld
from beambench.generator.rays.backend import mitsuba
from beambench.scenes.materials import Lambert
from beambench.scenes.rigs.gated import gated_rig

from ._gate_closed_form import C, electrons_per_radiance, gate_response, slices_of
from ._lit_wall import lit_wall, remainder

Float = NDArray[np.float64]


def test_shares_add_up_and_single_scattering_is_the_traced_one() -> None:
    """A post keeps the lamp's light from a part of the water that the camera sees: the quadrature less its shadow is what
    single scattering traced as such gives (eight slices over eight seeds, t < 6), and the shadow counts."""
    post = {
        "name": "post",
        "shape": {
            "kind": "rectangle", "center_m": [0.32, 0.05, 1.2], "width_m": 0.12, "height_m": 0.2, "tilt_x_deg": 0.0,
            "tilt_y_deg": 0.0,
        },
        "material": {"kind": "lambert", "albedo": 0.3},
    }  # fmt: skip
    changes: dict[str, Any] = {"rig.delays.start_s": 2.6 * 1.36 / C, "rig.laser.position_m": [0.5, 0.0, 0.0]}
    scene = lit_wall(0.3, 0.5, **changes)
    scene = scene.model_copy(update={"target": (*scene.target, lit_wall(0.3, 0.5, target=[post]).target[0])})
    runs = [remainder(scene, seed, 4096, parts=True) for seed in range(8)]
    for run in runs[:2]:
        total = sum(part.astype(float) for part in run.parts.values())
        assert np.abs(total - run.light).max() < 1e-4 * run.light.max()  # two returns of a bin in place of one, float32
    single = np.stack([run.parts["single"].mean(axis=(1, 2), dtype=float) for run in runs])
    traced = np.stack(
        [remainder(scene, 100 + seed, 30_000, "single").light.mean(axis=(1, 2), dtype=float) for seed in range(8)]
    )
    unshaded = remainder(scene.model_copy(update={"target": scene.target[:1]}), 0, 256, parts=True).parts["single"]
    assert 0.2 < single.mean(axis=0).sum() / unshaded.mean(axis=(1, 2), dtype=float).sum() < 0.95
    error = np.hypot(single.std(axis=0, ddof=1), traced.std(axis=0, ddof=1)) / np.sqrt(8)
    z = (single.mean(axis=0) - traced.mean(axis=0)) / np.hypot(error, 0.002 * traced.mean(axis=0))
    assert np.abs(z).max() < 6.0, z


@pytest.mark.parametrize("position", [[0.0, 0.0, 0.0], [0.05, 0.0, 0.0]], ids=["coaxial", "bistatic"])
def test_near_gates_see_the_same_single_scattering(position: list[float]) -> None:
    """Gates open while the pulse passes the water before the lens: the quadrature of `scatter` and `full` against single
    scattering traced. Both begin at baseline + 2 f/N; coaxial light then falls as 1/path² within one node. Six seeds, t < 7 over
    eight slices, 1 % for the nodes' width beside a lamp at 5 cm."""
    focal = 2.5e-2
    scene = lit_wall(
        0.3, 0.5,
        **{
            "rig.laser.position_m": position, "rig.delays.start_s": 0.0, "rig.delays.step_s": 0.3e-9,
            "rig.camera.focal_length_m": focal, "rig.camera.pixel_pitch_m": 13e-6 * focal / 2.5e-4,
        },
    )  # fmt: skip
    slices = slices_of(scene)
    known = single_electrons(
        scene, view_of(scene), gate_tables(scene), slices.gate, slices.delay_s, slices.scale, None
    ).mean(axis=(1, 2), dtype=float)
    traced = np.stack(
        [remainder(scene, seed, 30_000, "single").light.mean(axis=(1, 2), dtype=float) for seed in range(6)]
    )
    expected = traced.mean(axis=0)
    error = traced.std(axis=0, ddof=1) / np.sqrt(6)
    assert error.max() < 0.01 * expected.max()
    z = (known - expected) / np.hypot(error, (0.01 if position[0] else 0.001) * expected)
    assert np.abs(z).max() < 7.0, z


def test_stated_error_in_turbid_water_is_true() -> None:
    """Spread of 16 seeds against the stated standard error of the stack (18 %, 3 σ of χ² of 15 and more degrees of freedom),
    and no run far from the others: the tails are light."""
    scene = lit_wall(
        1.8, 0.9,
        **{
            "medium.phase_function": {"kind": "fournier-forand", "index": 1.1, "slope": 3.58},
            "target.0.shape.center_m": [0.0, 0.0, 1.0], "rig.delays.start_s": 1.5 * 1.36 / C,
            "rig.delays.step_s": 0.1 * 1.36 / C, "rig.camera.focal_length_m": 8e-5, "rig.laser.position_m": [0.0, 0.0, 0.0],
        },
    )  # fmt: skip
    runs = [remainder(scene, seed, 1024) for seed in range(16)]
    light = np.stack([r.light for r in runs]).astype(float)
    power = (light.mean(axis=0) ** 2).sum()
    epsilon = np.sqrt(light.var(axis=0, ddof=1).sum() / power)
    stated = np.sqrt(np.mean([r.epsilon**2 for r in runs]))
    assert stated == pytest.approx(epsilon, rel=0.25)
    assert epsilon < 0.05
    apart = np.sqrt(((light - light.mean(axis=0)) ** 2).sum(axis=(1, 2, 3)) / power)
    assert apart.max() < 2.0 * epsilon


def test_integrating_sphere() -> None:
    """White furnace through the loop: in a sphere of albedo ρ the light after the first surface is even, E = Φρ/(4πR²(1 − ρ)),
    wherever the lamp points. Every pixel of six runs, 4.5 σ over 16 values."""
    mi = mitsuba()
    albedo, radius = 0.8, 2.0
    scene = lit_wall(
        0.0, 0.5,
        **{
            "medium.absorption_per_m": 0.0, "rig.gates.0.width_s": 2e-6, "rig.delays.start_s": 1e-9,
            "rig.delays.count": 1,
        },
    )  # fmt: skip
    bsdf = mitsuba_bsdf(Lambert(albedo=albedo))
    cavity = mi.load_dict({"type": "scene", "o0": {"type": "sphere", "radius": radius, "bsdf": bsdf}})
    world = replace(PathWorld.of(scene, view_of(scene)), geometry=cavity)
    runs = np.stack(
        [remainder(scene, seed, 4096, "interreflection", world=world).light[0].astype(float) for seed in range(6)]
    )
    half = gated_rig(scene).laser.illumination.half_angle_rad
    # electrons_per_radiance holds the lamp's intensity of an even cone.
    flux = 2 * np.pi * (1 - np.cos(half))
    radiance = albedo / np.pi * albedo / (1 - albedo) * flux / (4 * np.pi * radius**2)
    expected = radiance * electrons_per_radiance(scene)
    error = runs.std(ddof=1) / np.sqrt(6)
    assert error < 0.02 * expected
    assert np.abs(runs.mean(axis=0) - expected).max() < 4.5 * error
    assert runs.mean() == pytest.approx(expected, abs=4.5 * error / 4 + 1e-3 * expected)


def test_a_lamp_of_finite_size_lights_later() -> None:
    """A disc of radius ρ before a wall at z: light from its point s comes √(z² + s²) far with (z/√(z² + s²))³ of the weight,
    so that the echo's mean path and amplitude are integrals over s² alone; point and finite lamp share their noise."""
    z, radius = 3.0, 0.9
    scene = lit_wall(
        0.0, 0.5,
        **{
            "rig.laser.position_m": [0.0, 0.0, 0.0], "rig.laser.source_radius_m": radius,
            "rig.laser.illumination.half_angle_rad": 0.8, "rig.camera.focal_length_m": 2.5e-2, "rig.gates.0.width_s": 0.4e-9,
            "rig.delays.step_s": 0.02 * 1.36 / C, "rig.delays.start_s": 5.5 * 1.36 / C, "rig.delays.count": 60,
        },
    )  # fmt: skip
    found = remainder(scene, 1, 4096, parts=True).light.sum(axis=(1, 2), dtype=float)
    s2 = radius**2 * (np.arange(2000) + 0.5) / 2000
    far = np.sqrt(z * z + s2)
    scale = 0.6 / np.pi * 16 * electrons_per_radiance(scene)

    def echo(path: Float, weight: Float) -> Float:
        return np.asarray(scale * (gate_response(scene, (z + path) * 1.36 / C) * weight).mean(axis=1))

    finite = echo(far, z / far**3 * np.exp(-0.05 * (z + far)))
    point = echo(np.array([z]), np.array([np.exp(-0.05 * 2 * z) / z**2]))
    assert np.abs(found - (finite - point)).max() < 3e-3 * point.max()
    assert np.abs(finite - point).max() > 0.1 * point.max()


def test_a_defocused_edge_is_as_wide_as_the_circle_of_confusion() -> None:
    """A wall that ends at x = 0, at twice the focus: its image is the edge under a disc of radius aperture·|1 − z/z_f|."""
    z, aperture = 4.0, 0.05
    scene = lit_wall(
        0.0, 0.5,
        **{
            "target.0.shape": {
                "kind": "rectangle", "center_m": [5.0, 0.0, z], "width_m": 10.0, "height_m": 10.0, "tilt_x_deg": 0.0,
                "tilt_y_deg": 0.0,
            },
            "rig.camera.rows": 1, "rig.camera.cols": 32, "rig.camera.focal_length_m": 0.1, "rig.camera.f_number": 1.0,
            "rig.camera.pixel_pitch_m": 1.2e-4, "rig.camera.focus_distance_m": 0.5 * z, "medium.absorption_per_m": 0.0,
            "rig.laser.position_m": [0.0, 0.0, 0.0], "rig.delays.count": 1, "rig.delays.start_s": 1e-9,
            "rig.gates.0.width_s": 100e-9,
        },
    )  # fmt: skip
    found = remainder(scene, 1, 20_000).light[0, 0].astype(float)
    whole = 0.6 / np.pi / z**2 * electrons_per_radiance(scene)
    x = (np.arange(32 * 50) + 0.5) / 50 - 16.0
    u = np.clip(x * 1.2e-4 / 0.1 * z / aperture, -1, 1)  # the edge in units of the disc's radius
    share = 0.5 + (u * np.sqrt(1 - u * u) + np.arcsin(u)) / np.pi
    blur = (share - (x > 0)).reshape(32, 50).mean(axis=1)
    # cosines of rays through the lens: up to 1.2e-3 here.
    assert np.abs(found / whole - blur).max() < 4e-3
    assert np.abs(blur).max() > 0.4


def test_points_leave_the_bits_as_they_were() -> None:
    plain = lit_wall(0.3, 0.5)
    told = lit_wall(0.3, 0.5, **{"rig.laser.source_radius_m": 0.0})
    assert plain == told and plain.model_dump_json() == told.model_dump_json()
    assert "source_radius_m" not in plain.model_dump_json() and "focus_distance_m" not in plain.model_dump_json()
    one, two = remainder(plain, 3, 256), remainder(told, 3, 256)
    assert one.light.tobytes() == two.light.tobytes()
    assert one.sigma.tobytes() == two.sigma.tobytes()
    assert one.finite is None and two.finite is None and not one.parts and not two.parts


@pytest.mark.skipif(importlib.util.find_spec("mitransient") is None, reason="the peer mitransient is not installed")
def test_against_mitransient() -> None:
    """Whole stacks in water (all light, their bins of σ/16) against ours with the direct rung: six and eight runs, t < 7
    over eight slices."""
    from beambench.benchmarks.peers.mitransient_volume import mitransient_reference
    from beambench.generator.gated.direct import render_direct
    from beambench.generator.gated.stack import expected_electrons

    scene = lit_wall(0.3, 0.5)
    slices = slices_of(scene)
    theirs = np.stack(
        [mitransient_reference(scene, slices, seed, 20_000).mean(axis=(1, 2), dtype=float) for seed in range(6)]
    )
    coords = {
        "actual": slices.delay_s, "gate": slices.gate, "laser_on": np.ones(8, dtype=bool), "pulses": np.full(8, 100),
    }  # fmt: skip
    light, ambient = expected_electrons(scene, render_direct(scene, 1e-3), coords, 0, 0)
    direct = (light - ambient.astype(np.float32)[:, None, None]).mean(axis=(1, 2), dtype=float)
    ours = direct + np.stack([remainder(scene, seed, 8192).light.mean(axis=(1, 2), dtype=float) for seed in range(8)])
    expected = theirs.mean(axis=0)
    error = np.hypot(theirs.std(axis=0, ddof=1) / np.sqrt(6), ours.std(axis=0, ddof=1) / np.sqrt(8))
    assert np.median(error / expected) < 0.03
    # Their bins' middles broaden R by 1e-4 of its width.
    z = (ours.mean(axis=0) - expected) / np.hypot(error, 1e-3 * expected)
    assert np.abs(z).max() < 7.0, z
