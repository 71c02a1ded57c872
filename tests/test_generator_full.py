"""The full rung against quadratures that share none of its code; nesting, stated error, and equal bits."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from beambench.generator.gated.direct import render_direct
from beambench.generator.gated.full import Limits, Remainder, render_remainder
from beambench.generator.gated.stack import expected_electrons
from beambench.generator.generate import generate
from beambench.generator.rays.trace import pixel_directions
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.scene import Scene

from ._gate_closed_form import gate_response, slices_of

C = 299_792_458.0
Float = NDArray[np.float64]


def corner(albedo: float, size: int = 6, **more: Any) -> Scene:
    """Two square walls of 1 m that meet at a right angle 5 m away, open toward the camera."""
    half = np.sqrt(0.125)
    lambert = {"kind": "lambert", "albedo": albedo}
    walls = [
        {
            "name": name,
            "shape": {
                "kind": "rectangle", "center_m": [x, 0.0, 5.0 - half], "width_m": 1.0, "height_m": 1.0,
                "tilt_x_deg": 0.0, "tilt_y_deg": tilt,
            },
            "material": lambert,
        }
        for name, x, tilt in (("left", -half, -45.0), ("right", half, 45.0))
    ]  # fmt: skip
    changes = {
        "target": walls,
        "rig.camera.rows": size,
        "rig.camera.cols": size,
        "rig.camera.focal_length_m": 1.2e-4 * size,
        "rig.delays.start_s": 31.0e-9,
        "rig.delays.step_s": 0.25e-9,
        "rig.delays.count": 20,
    }
    return load_scene("flat-wall", changes | more)


def direct_of(scene: Scene, rtol: float = 1e-3) -> NDArray[np.float32]:
    slices = slices_of(scene)
    coords = {
        "actual": slices.delay_s, "gate": slices.gate, "laser_on": np.ones(len(slices.delay_s), dtype=bool),
        "pulses": np.full(len(slices.delay_s), gated_rig(scene).pulses_per_slice),
    }  # fmt: skip
    light, ambient = expected_electrons(scene, render_direct(scene, rtol), coords, 0, 0)
    return light - ambient.astype(np.float32)[:, None, None]


def remainder(scene: Scene, rtol: float, seed: int = 1, **more: Any) -> Remainder:
    return render_remainder(scene, direct_of(scene), slices_of(scene), rtol, seed, 0, **more)


def wall_points(side: float, along: int, up: int) -> tuple[Float, Float, Float]:
    """Midpoints (n, 3), areas (n) and normal of a corner's wall (side −1 left, +1 right), finer toward the edge."""
    s = (np.arange(along) + 0.5) / along
    distance, stretch = s**2, 2.0 * s  # from the edge; dA follows
    y = (np.arange(up) + 0.5) / up - 0.5
    root = np.sqrt(0.5)
    grid_d, grid_y = np.meshgrid(distance, y, indexing="ij")
    point = np.stack([side * root * grid_d, grid_y, 5.0 - root * grid_d], axis=-1).reshape(-1, 3)
    area = np.repeat(stretch / along / up, up)
    return point, area, np.array([-side * root, 0.0, -root])


def two_bounce(scene: Scene, albedo: float) -> Float:
    """Photoelectrons (slices, rows, cols) of light that meets both walls once, by the midpoint rule over the other wall
    and 4×4 points of each pixel: L = ρ/π ∫ [ρ/π I cosθ_l/d_l²] cosθ₁cosθ₂/d² dA, at the path's own time."""
    rig = gated_rig(scene)
    camera, laser = rig.camera, rig.laser
    solid = 2 * np.pi * (1 - np.cos(laser.illumination.half_angle_rad))
    joule = laser.pulse_energy_j / solid * camera.pixel_pitch_m**2 * np.pi / (4 * camera.f_number**2)
    electrons = rig.pulses_per_slice * joule * camera.transmission * camera.quantum_efficiency
    electrons *= laser.wavelength_m / (6.62607015e-34 * C)
    per_metre = 1.00028 / C  # air; its error moves times by less than 1e-13 s
    fine = 4
    sub = (np.arange(fine * camera.rows) + 0.5) / fine - 0.5
    row, col = np.meshgrid(sub, sub, indexing="ij")
    direction = pixel_directions(camera, row.ravel(), col.ravel())
    out = np.zeros((len(slices_of(scene).delay_s), row.size))
    for index, d in enumerate(direction.T):
        side = np.sign(d[0])
        # The ray meets the wall side·x + z = 5.
        r = 5.0 / (side * d[0] + d[2])
        x1 = d * r
        if np.hypot(x1[0], x1[2] - 5.0) > 1.0 or abs(x1[1]) > 0.5:
            continue
        normal1 = np.array([-side, 0.0, -1.0]) * np.sqrt(0.5)
        x2, area, normal2 = wall_points(-side, 48, 48)
        lamp = np.linalg.norm(x2, axis=1)
        lit = np.arccos(x2[:, 2] / lamp) <= laser.illumination.half_angle_rad
        between = x2 - x1
        d12 = np.linalg.norm(between, axis=1)
        cos1, cos2 = between @ normal1 / d12, -(between @ normal2) / d12
        cos_lamp = -(x2 @ normal2) / lamp
        value = lit * (albedo / np.pi) ** 2 * cos_lamp / lamp**2 * cos1 * cos2 / d12**2 * area
        out[:, index] = gate_response(scene, (r + d12 + lamp) * per_metre) @ value
    n = camera.rows
    return electrons * out.reshape(-1, n, fine, n, fine).mean(axis=(2, 4))


def test_second_bounce_of_a_diffuse_corner() -> None:
    """Walls of albedo .002 (third bounces below 1e-3 of the second): z-scores of six runs, every pixel's sum and every
    slice's, and the scale; 5 σ over 6·56 values is a chance of 2e-4."""
    albedo = 0.002
    scene = corner(albedo)
    expected = two_bounce(scene, albedo)
    runs = np.stack(
        [
            remainder(scene, 1e-9, seed, limits=Limits(most_samples=6_000)).light.astype(float)
            for seed in range(6)
        ]
    )  # fmt: skip
    for axes in ((0,), (1, 2)):
        got, want = runs.sum(axis=tuple(a + 1 for a in axes)), expected.sum(axis=axes)
        bright = want > 0.05 * want.max()
        error = got.std(axis=0, ddof=1)
        # The quadrature itself is good to 3e-3 (checked by doubling its nodes).
        z = (got.mean(axis=0) - want) / np.sqrt(error**2 / 6 + (3e-3 * want) ** 2)
        assert np.abs(z[bright]).max() < 5.0
    assert runs.mean(axis=0).sum() == pytest.approx(expected.sum(), rel=3e-3)


def corner_by_numpy(scene: Scene, albedo: float, paths: int, bounces: int = 40) -> tuple[float, float]:
    """Ratio of indirect to direct light of the whole image and its standard error: analogue reflection between two
    planes in double precision, weight ρ at each, the lamp's irradiance added at each."""
    rng = np.random.default_rng(11)
    camera = gated_rig(scene).camera
    half_angle = gated_rig(scene).laser.illumination.half_angle_rad
    row, col = rng.uniform(-0.5, camera.rows - 0.5, paths), rng.uniform(-0.5, camera.cols - 0.5, paths)
    d = pixel_directions(camera, row, col).T
    side = np.sign(d[:, 0])
    x = d * (5.0 / (side * d[:, 0] + d[:, 2]))[:, None]
    alive = (np.hypot(x[:, 0], x[:, 2] - 5.0) <= 1.0) & (np.abs(x[:, 1]) <= 0.5)
    direct, indirect = np.zeros(paths), np.zeros(paths)
    weight = np.full(paths, albedo)
    root = np.sqrt(0.5)
    for bounce in range(bounces):
        lamp = np.linalg.norm(x, axis=1)
        normal = np.stack([-side * root, np.zeros(paths), np.full(paths, -root)], axis=1)
        lit = np.arccos(x[:, 2] / lamp) <= half_angle
        given = alive * lit * weight * -np.einsum("ij,ij->i", x, normal) / lamp**3
        if bounce:
            indirect += given
        else:
            direct += given
        # Cosine-distributed directions: a point of the unit sphere about the normal's tip.
        z, phi = rng.uniform(-1, 1, paths), rng.uniform(0, 2 * np.pi, paths)
        s = np.sqrt(1 - z * z)
        d = normal + np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1)
        side = -side
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (5.0 - side * x[:, 0] - x[:, 2]) / (side * d[:, 0] + d[:, 2])
        x = x + d * np.nan_to_num(t, posinf=0.0, neginf=0.0)[:, None]
        near = (np.hypot(x[:, 0], x[:, 2] - 5.0) <= 1.0) & (np.abs(x[:, 1]) <= 0.5) & (side * x[:, 0] >= 0)
        alive &= (t > 0) & near
        weight *= albedo
    scale = direct.mean()
    ratio = float(indirect.mean() / scale)
    return ratio, float(np.std(indirect - ratio * direct) / scale / np.sqrt(paths))


def test_all_bounces_of_a_corner() -> None:
    """Albedo .8: ratio of indirect to direct light of the image, by an independent tracer between two planes (4 σ)."""
    albedo = 0.8
    wide_gate = {"rig.gates.0.width_s": 60e-9, "rig.delays.start_s": 1e-9, "rig.delays.count": 1}
    scene = corner(albedo, size=16, **wide_gate | {"rig.camera.focal_length_m": 5.5e-4})  # sees both walls whole
    result = remainder(scene, 1e-3)
    direct = np.asarray(render_direct(scene, 1e-4).truth["truth_amplitude"])
    ratio, error = corner_by_numpy(scene, albedo, 400_000)
    ours = float(result.amplitude.sum() / direct.sum())
    ours_error = float(np.sqrt(np.sum(result.sigma**2)) / direct.sum())
    assert abs(ours - ratio) < 4.0 * np.hypot(error, ours_error)
    assert error < 0.006 * ratio and ours_error < 0.003 * ratio


@pytest.mark.parametrize("name", ["flat-wall", "tilted-wall"])
def test_convex_scene_in_air_has_no_remainder(name: str) -> None:
    scene = load_scene(name, {"rig.camera.rows": 8, "rig.camera.cols": 8, "rig.camera.focal_length_m": 4e-4})
    assert not remainder(scene, 3e-3).light.any()


def test_stated_error_is_true() -> None:
    """Differences between seeds against the stated error of the stack and of the pixels (16 runs: 18 %, 3.5 σ)."""
    scene = corner(0.5)
    whole = direct_of(scene)
    runs = [remainder(scene, 1e-9, seed, limits=Limits(most_samples=400)) for seed in range(16)]
    light = np.stack([r.light for r in runs]).astype(float)
    epsilon = np.sqrt((light.var(axis=0, ddof=1)).sum() / ((whole + light.mean(axis=0)) ** 2).sum())
    assert np.mean([r.epsilon for r in runs]) == pytest.approx(epsilon, rel=0.2)
    # A lattice is more even than the independent numbers that the pixels' standard errors suppose: they are upper bounds.
    amplitude = np.stack([r.amplitude for r in runs])
    stated = np.sqrt(np.mean([r.sigma**2 for r in runs], axis=0))
    assert np.sqrt(np.mean(amplitude.var(axis=0, ddof=1))) < 1.2 * np.sqrt(np.mean(stated**2))


def test_error_asked_for_is_reached_and_cost_is_kept_down() -> None:
    scene = corner(0.5)
    coarse, fine = remainder(scene, 3e-2), remainder(scene, 3e-3)
    assert coarse.reached and coarse.epsilon <= 3e-2
    assert fine.reached and fine.epsilon <= 3e-3
    assert coarse.samples < fine.samples
    short = remainder(scene, 1e-6, limits=Limits(most_samples=64))
    assert not short.reached and short.epsilon > 1e-6


def test_equal_seeds_give_equal_bits_whatever_the_tiles() -> None:
    scene = corner(0.5, size=20)
    one, two = (remainder(scene, 1e-2, 5) for _ in range(2))
    tiled = remainder(scene, 1e-2, 5, limits=Limits(memory_bytes=1))
    other = remainder(scene, 1e-2, 6)
    assert one.light.tobytes() == two.light.tobytes() == tiled.light.tobytes()
    assert one.sigma.tobytes() == tiled.sigma.tobytes()
    assert one.light.tobytes() != other.light.tobytes()
    for result in (one, other):
        assert np.isfinite(result.light).all() and (result.light >= 0).all()


def test_generate_full_adds_the_remainder_as_background() -> None:
    scene = corner(0.7, size=8)
    full = generate(scene, seed=3, fidelity="full", rtol=1e-2, truth_electrons=True)
    # The full rung gives its rays .7 of rtol, its paths the same.
    plain = generate(scene, seed=3, fidelity="direct", rtol=0.7e-2, truth_electrons=True)
    extra = full["truth_electrons"].values - plain["truth_electrons"].values
    ambient = plain["truth_background"].values[:, None, None]
    assert np.allclose(full["truth_background"].values - ambient, extra, atol=1e-3 * extra.max())
    assert np.array_equal(full["truth_amplitude"].values, plain["truth_amplitude"].values)
    assert extra.sum() > 0.2 * (plain["truth_electrons"].values - ambient).sum()
    told = json.loads(full.attrs["fidelity"])
    assert told["reached"] and told["standard_error"] <= 1e-2 and told["samples_per_pixel"] > 0
    assert {e["name"]: e["modelled"] for e in told["effects"]}["interreflection"]
    again = generate(scene, seed=3, fidelity="full", rtol=1e-2, truth_electrons=True)
    assert again["counts"].values.tobytes() == full["counts"].values.tobytes()


def test_shares_of_the_light_are_kept_on_request() -> None:
    """Their sum is the light, the counts are the same with and without them, and a store takes them."""
    scene = load_scene(
        "harbour-wall",
        {"rig.camera.rows": 6, "rig.camera.cols": 6, "rig.camera.pixel_pitch_m": 8e-5, "rig.delays.count": 6},
    )
    kept = generate(scene, seed=3, fidelity="full", rtol=0.1, truth_electrons=True, truth_components=True)
    plain = generate(scene, seed=3, fidelity="full", rtol=0.1)
    names = [f"truth_{name}" for name in ("direct", "interreflection", "single", "multiple")]
    rig = scene.rig.model_dump()
    open_s = rig["pulses_per_slice"] * rig["gates"][0]["width_s"]  # ambient light enters while the gate is open
    dark = rig["detector"]["dark_current_e_per_s"] * rig["detector"]["exposure_s"]
    assert np.allclose(kept["truth_ambient"].values, dark + rig["ambient_e_per_s"] * open_s, rtol=1e-6)
    total = np.sum([kept[name].values.astype(float) for name in names], axis=0)
    rest = kept["truth_electrons"].values - total
    assert np.ptp(rest, axis=(1, 2)).max() < 1e-3 * total.max()  # ambient and dark: the same in every pixel
    assert np.array_equal(kept["counts"].values, plain["counts"].values)
    assert all(name not in plain for name in names)
    assert (kept["truth_standard_error"].values > 0).all()
    assert kept["truth_single"].values.sum() > 0 and kept["truth_multiple"].values.sum() > 0
    with pytest.raises(InputError, match="kept apart"):
        generate(scene, seed=3, fidelity="auto", truth_components=True)


def test_convex_scene_is_the_direct_one() -> None:
    """In clear air the rungs differ by nothing but their share of rtol."""
    scene = load_scene("flat-wall", {"rig.camera.rows": 8, "rig.camera.cols": 8, "rig.camera.focal_length_m": 4e-4})
    full = generate(scene, seed=1, fidelity="full", rtol=3e-3)
    plain = generate(scene, seed=1, fidelity="direct", rtol=0.7 * 3e-3)
    assert np.array_equal(full["counts"].values, plain["counts"].values)


def test_surfaces_that_amplify_light_are_refused() -> None:
    law = {"kind": "chua", "k_s": 0.0, "k_d": 1.0, "slope": 0.3, "diffusivity": 1.0, "convention": "brdf"}
    with pytest.raises(InputError, match="more light than it gets"):
        generate(load_scene("flat-wall", {"target.0.material": law}), seed=1, fidelity="full")


def test_scattering_medium_without_phase_function_is_refused() -> None:
    with pytest.raises(InputError, match="phase function"):
        generate(load_scene("flat-wall", {"medium.scattering_per_m": 0.1}), seed=1, fidelity="full")
