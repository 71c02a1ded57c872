"""Textures on the traced rung: the same value at the same place as the direct rung's, and the light that bounces on them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from beambench.generator.gated.direct import render_direct
from beambench.generator.gated.full import Limits, Slices, render_remainder
from beambench.generator.gated.stack import expected_electrons
from beambench.generator.gated.view import view_of
from beambench.generator.generate import generate
from beambench.generator.paths.world import PathWorld
from beambench.generator.rays.backend import mitsuba
from beambench.generator.rays.echo import textured_response
from beambench.generator.rays.trace import Tracer, pixel_directions
from beambench.optics.reflection.angles import monostatic
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.scene import Scene

Float = NDArray[np.float64]

#: Bilinear between its texels, and another at every place.
IMAGE = (0.1 + 0.8 * np.linspace(0, 1, 64))[None, :] * (1.0 - 0.5 * np.linspace(0, 1, 48))[:, None]

LAWS: dict[str, dict[str, Any]] = {
    "lambert": {"kind": "lambert", "albedo": 0.5},
    "phong": {"kind": "phong", "diffuse_albedo": 0.4, "specular_albedo": 0.3, "exponent": 8.0},
    "cook-torrance": {
        "kind": "cook-torrance", "diffuse_albedo": 0.4, "f0": 0.1, "roughness": 0.4, "distribution": "ggx",
    },
    "chua": {
        "kind": "chua", "k_s": 0.1, "k_d": 0.16, "slope": 0.35, "diffusivity": 1.4, "convention": "reciprocal",
    },
}  # fmt: skip


def saved(tmp_path: Path, image: Float) -> dict[str, Any]:
    np.save(tmp_path / "image.npy", image)
    return {"file": str(tmp_path / "image.npy"), "encoding": "linear"}


def textured(kind: str, texture: dict[str, Any], law: str, tmp_path: Path, **more: Any) -> Scene:
    """One textured object of this kind in front of a small camera."""
    shapes: dict[str, tuple[str, dict[str, Any]]] = {
        "rectangle": ("flat-wall", {
            "kind": "rectangle", "width_m": 2.0, "height_m": 1.5, "tilt_x_deg": 10.0, "tilt_y_deg": 20.0,
            "center_m": [0.1, -0.05, 3.0],
        }),
        "relief": ("relief-tank", {}),
        "sphere": ("sphere", {}),
        "mesh": ("flat-wall", {
            "kind": "mesh", "file": str(tmp_path / "plate.obj"), "size_m": 2.0, "center_m": [0.1, -0.05, 3.0],
            "rotation_deg": [0.0, 20.0, 0.0],
        }),
    }  # fmt: skip
    (tmp_path / "plate.obj").write_text(
        "v -1 -0.75 0\nv 1 -0.75 0\nv 1 0.75 0\nv -1 0.75 0\nvt 0 1\nvt 1 1\nvt 1 0\nvt 0 0\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
    )
    name, shape = shapes[kind]
    item = load_scene(name).target[0].model_dump(mode="json")
    item |= {"texture": texture, "material": LAWS[law]}
    item["shape"] = shape or item["shape"]
    # The traced rung wants a phase function of what scatters: here nothing does.
    clear = {"medium.scattering_per_m": 0.0}
    focal = {"rig.camera.focal_length_m": 4e-3} if kind == "sphere" else {}
    small: dict[str, Any] = {"target": [item], "rig.camera.rows": 24, "rig.camera.cols": 32}
    return load_scene(name, small | clear | focal | more)


@pytest.mark.parametrize(
    ("kind", "law"),
    [(kind, "lambert") for kind in ("rectangle", "relief", "sphere", "mesh")]
    + [("rectangle", law) for law in ("phong", "cook-torrance", "chua")],
)
def test_both_rungs_see_the_same_texture(kind: str, law: str, tmp_path: Path) -> None:
    """The path tracer's surfaces, asked toward the camera, respond as the direct rung's. Hits are float32: 1e-6 m of the object
    times 64 texels of .013; a sphere's longitude is uncertain where the ray grazes it, as on the direct rung."""
    scene = textured(kind, saved(tmp_path, IMAGE), law, tmp_path)
    camera = gated_rig(scene).camera
    direction = pixel_directions(camera, *(a.ravel() for a in np.mgrid[: camera.rows, : camera.cols]))
    hits = Tracer(scene).trace((0.0, 0.0, 0.0), direction)
    mine = hits.target == 0
    assert mine.sum() > 100
    a = monostatic(np.clip(-np.einsum("in,in->n", hits.normal, direction)[mine], 0.0, 1.0))
    wanted = textured_response(scene.target[0], a, hits.shade[mine])
    mi = mitsuba()
    d = mi.Vector3f(*(mi.Float(v) for v in direction[:, mine].astype(np.float32)))
    world = PathWorld.of(scene, view_of(scene))
    si = world.geometry.ray_intersect(mi.Ray3f(mi.Point3f(0.0), d))
    found = np.asarray(si.bsdf().eval(mi.BSDFContext(), si, si.wi)[0].numpy(), dtype=np.float64)
    # A ray along the edge of two facets meets either of them: only rays that meet the same one see the same slope.
    normal = np.stack([np.asarray(si.n[axis].numpy(), dtype=np.float64) for axis in range(3)])
    same = np.abs((normal * hits.normal[:, mine]).sum(axis=0)) > 1 - 1e-6
    assert same.mean() > 0.95
    np.testing.assert_allclose(found[same], wanted[same], atol=1e-4 if kind == "sphere" else 1e-5)


def corner(left: list[dict[str, Any]], size: int = 4) -> Scene:
    """Two square walls of 1 m that meet at a right angle 5 m away; the left one is made of `left`."""
    half = float(np.sqrt(0.125))
    right = {
        "name": "right", "material": {"kind": "lambert", "albedo": 0.8},
        "shape": {"kind": "rectangle", "center_m": [half, 0.0, 5.0 - half], "width_m": 1.0, "height_m": 1.0,
                  "tilt_x_deg": 0.0, "tilt_y_deg": 45.0},
    }  # fmt: skip
    changes = {
        "target": [*left, right], "rig.camera.rows": size, "rig.camera.cols": size,
        "rig.camera.focal_length_m": 1.2e-4 * size, "rig.delays.start_s": 31.0e-9, "rig.delays.step_s": 1e-9,
        "rig.delays.count": 5,
    }  # fmt: skip
    return load_scene("flat-wall", changes)


def left_wall(name: str, albedo: float, y: float, height: float, **more: Any) -> dict[str, Any]:
    half = float(np.sqrt(0.125))
    return {
        "name": name, "material": {"kind": "lambert", "albedo": albedo},
        "shape": {"kind": "rectangle", "center_m": [-half, y, 5.0 - half], "width_m": 1.0, "height_m": height,
                  "tilt_x_deg": 0.0, "tilt_y_deg": -45.0},
    } | more  # fmt: skip


def bounced(scene: Scene, seed: int) -> Float:
    spec = gated_rig(scene).delays
    delay = spec.start_s + spec.step_s * np.arange(spec.count)
    slices = Slices(delay, np.ones(spec.count), np.zeros(spec.count, dtype=np.int32), None)
    coords = {
        "actual": delay, "gate": slices.gate, "laser_on": np.ones(spec.count, dtype=bool),
        "pulses": np.full(spec.count, gated_rig(scene).pulses_per_slice),
    }  # fmt: skip
    light, ambient = expected_electrons(scene, render_direct(scene, 0.01), coords, 0, 0)
    direct = light - ambient.astype(np.float32)[:, None, None]
    limits = Limits(most_samples=8_000)
    found = render_remainder(scene, direct, slices, 1e-9, seed, 0, component="interreflection", limits=limits)
    return found.light.astype(float)


def test_a_texture_of_two_halves_bounces_as_two_walls(tmp_path: Path) -> None:
    """A wall whose upper half is bright and whose lower half is dark, by texture and by two untextured walls: all bounces
    between it and a bright wall. z of every pixel's sum and every slice's over six runs each; the texture's step is one
    texel of 512 wide, even about the border, so that it moves no light to first order. 5 σ over 21 values of Student's t
    with 10 degrees of freedom is a chance of 1e-2 at worst, the seeds are fixed, and a texture that is ignored, upside
    down or turned is off by tens of σ."""
    image = np.full((512, 4), 0.25)
    image[:256] = 1.0
    one = corner([left_wall("left", 0.8, 0.0, 1.0, texture=saved(tmp_path, image))])
    two = corner([left_wall("upper", 0.8, -0.25, 0.5), left_wall("lower", 0.2, 0.25, 0.5)])
    a, b = (np.stack([bounced(scene, seed) for seed in range(6)]) for scene in (one, two))
    for axes in ((0,), (1, 2)):
        x, y = (np.sum(v, axis=tuple(k + 1 for k in axes)) for v in (a, b))
        error = np.sqrt((x.var(axis=0, ddof=1) + y.var(axis=0, ddof=1)) / 6)
        z = (x.mean(axis=0) - y.mean(axis=0)) / np.maximum(error, 1e-9 * y.mean())
        assert np.abs(z).max() < 5.0, z
    ratio = a.sum() / b.sum()
    assert abs(ratio - 1.0) < 0.01
    # What the test would see of a texture that is ignored: the whole wall bright.
    assert abs(bounced(corner([left_wall("left", 0.8, 0.0, 1.0)]), 0).sum() / b[0].sum() - 1.0) > 0.2


def test_rungs_nest_on_a_textured_wall(tmp_path: Path) -> None:
    """Nothing bounces on one flat wall in clear air: the traced rung is the direct one."""
    scene = textured("rectangle", saved(tmp_path, IMAGE), "phong", tmp_path, **{"rig.delays.start_s": 16e-9})
    full, direct = (generate(scene, seed=1, fidelity=rung, truth_electrons=True) for rung in ("full", "direct"))  # type: ignore[arg-type]
    one, two = (c["truth_electrons"].values.astype(float) for c in (full, direct))
    assert two.max() > 10.0
    assert np.sqrt(np.sum((one - two) ** 2) / np.sum(two**2)) < 3e-3
