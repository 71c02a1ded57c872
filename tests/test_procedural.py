"""Procedural shapes: what a seed draws stays in its box, is closed, is told apart, and no two of 500 seeds draw the same."""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from beambench.optics.rotation import rotation_matrix
from beambench.scenes.datasets.content import scene_content
from beambench.scenes.datasets.load import load_dataset
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.procedural.build import ProceduralMesh, procedural_mesh
from beambench.scenes.procedural.pipes import lateral
from beambench.scenes.scene import Scene

from ._recipes import RECIPES, shape_of

KINDS = sorted(RECIPES)
#: An image of the whole box.
CAMERA = {"rig.camera.rows": 40, "rig.camera.cols": 40, "rig.camera.pixel_pitch_m": 1.6e-4, "rig.delays.count": 8}


def scene_of(kind: str, seed: int, **changes: Any) -> Scene:
    return load_scene("tilted-wall", CAMERA | {"target.0.shape": shape_of(kind, seed, **changes)})


def mesh_of(kind: str, seed: int, **changes: Any) -> ProceduralMesh:
    return procedural_mesh(scene_of(kind, seed, **changes).target[0].shape)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_reaches_beyond_the_box_and_bodies_are_closed(kind: str) -> None:
    """Every body is closed and outside out, but the ground and the blades, which are open sheets."""
    for seed in range(4):
        mesh = mesh_of(kind, seed)
        shape = shape_of(kind, seed)
        local = (mesh.vertices - shape["center_m"]) @ rotation_matrix(tuple(shape["rotation_deg"]))
        assert (np.abs(local) <= 0.5 * np.array(shape["size_m"]) + 1e-9).all()
        assert len(mesh.faces) <= 20_000 and mesh.faces.max() < len(mesh.vertices)
        assert set(np.unique(mesh.instance)) == set(range(mesh.instances))
        whole = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        for body in whole.split(only_watertight=False):
            if body.is_watertight:
                assert body.is_winding_consistent and body.volume > -1e-12
            else:
                assert kind == "vegetation" or len(body.faces) == 2 * 48 * 48


@pytest.mark.parametrize("kind", KINDS)
def test_parts_are_the_whole(kind: str) -> None:
    whole, ground, objects = (mesh_of(kind, 3, part=part) for part in ("all", "ground", "objects"))
    assert ground.instances + objects.instances == whole.instances
    corners = np.concatenate([ground.vertices[ground.faces], objects.vertices[objects.faces]])
    found = whole.vertices[whole.faces]
    order = np.lexsort(corners.reshape(len(corners), -1).T), np.lexsort(found.reshape(len(found), -1).T)
    assert np.array_equal(corners[order[0]], found[order[1]])


def test_equal_parameters_give_equal_triangles_in_another_process() -> None:
    code = (
        "import sys, json, hashlib; from beambench.scenes.load import load_scene\n"
        "from beambench.scenes.procedural.build import procedural_mesh\n"
        "for s in json.loads(sys.argv[1]):\n"
        "    m = procedural_mesh(load_scene('tilted-wall', {'target.0.shape': s}).target[0].shape)\n"
        "    print(hashlib.sha256(m.vertices.tobytes() + m.faces.tobytes()).hexdigest())"
    )
    shapes = [shape_of(kind, 7) for kind in KINDS]
    out = subprocess.run([sys.executable, "-c", code, json.dumps(shapes)], capture_output=True, text=True, check=True)
    here = [mesh_of(kind, 7) for kind in KINDS]
    assert out.stdout.split() == [hashlib.sha256(m.vertices.tobytes() + m.faces.tobytes()).hexdigest() for m in here]


def views(kind: str, seed: int) -> tuple[Any, NDArray[Any], Any]:
    """(hits, directions, tracer) of the pixel centres."""
    from beambench.generator.rays.trace import Tracer, pixel_directions

    scene = scene_of(kind, seed)
    row, col = np.mgrid[:40, :40].reshape(2, -1)
    direction = pixel_directions(scene.rig.camera, row, col)
    tracer = Tracer(scene)
    return tracer.trace((0.0, 0.0, 0.0), direction), direction, tracer


@pytest.mark.parametrize("kind", KINDS)
def test_ranges_normals_and_pieces_are_those_of_another_ray_engine(kind: str) -> None:
    """trimesh's rays see the same; a ray in 500 may pass an edge on the other side."""
    pytest.importorskip("embreex")
    wrong = seen = 0
    for seed in range(3):
        hits, direction, tracer = views(kind, seed)
        mesh = mesh_of(kind, seed)
        body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        at, ray, face = body.ray.intersects_location(np.zeros((1600, 3)), direction.T, multiple_hits=False)
        distance, number = np.full(1600, np.inf), np.full(1600, -1)
        distance[ray], number[ray] = np.linalg.norm(at, axis=1), face
        both = np.isfinite(distance) & np.isfinite(hits.distance)
        normal = body.face_normals[number[both]].T
        normal *= -np.sign(np.einsum("in,in->n", normal, direction[:, both]))
        same = (np.abs(distance[both] - hits.distance[both]) < 2e-5) & (
            np.abs(normal - hits.normal[:, both]).max(axis=0) < 1e-4
        )
        same &= mesh.instance[number[both]] == tracer.instances(hits)[both]
        wrong += int((~same).sum()) + int((np.isfinite(distance) != np.isfinite(hits.distance)).sum())
        seen += int(both.sum())
    assert seen > 2000 and wrong <= seen / 500


@pytest.mark.parametrize("kind", KINDS)
def test_500_seeds_are_500_scenes_as_a_data_set_draws_them(kind: str) -> None:
    """Drawn as a data set draws: 500 hashes of the split, 500 meshes; the same draw again has the same hash."""
    shape = shape_of(kind, 0)
    base = load_scene("tilted-wall", {"target.0.shape": shape}).model_dump(mode="json")
    del shape["seed"]
    parameters = {"seed": {"kind": "integers", "low": 0, "high": 10**9, "paths": ["target.0.shape.seed"]}}
    scenes = [{"scene": "tilted-wall", "overrides": {"target.0.shape": base["target"][0]["shape"]}}]
    data = {"schema_version": 1, "dataset": "d", "captures": 500, "seed": 3, "fidelity": "direct", "rtol": 1e-3}
    draws = load_dataset(data | {"scenes": scenes, "parameters": parameters})
    drawn = [draws.drawn(number) for number in range(500)]
    assert len({draws.content(one) for one in drawn}) == 500
    scene = draws.scene(drawn[7])
    assert draws.content(drawn[7]) == scene_content(scene.model_dump(mode="json"), ("target", "medium"))
    first = scene.target[0].shape
    meshes = {
        hashlib.sha256(
            procedural_mesh(first.model_copy(update={"seed": one.values["seed"]})).vertices.tobytes()
        ).digest()
        for one in drawn[::10]
    }
    assert len(meshes) == 50


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_500_seeds_are_500_meshes_and_images(kind: str, long_run: None) -> None:
    seen = {hashlib.sha256(np.round(views(kind, seed)[0].distance, 4).tobytes()).digest() for seed in range(500)}
    assert len(seen) == 500
    assert len({mesh_of(kind, seed).vertices.tobytes() for seed in range(500)}) == 500


def test_ten_seeds_are_ten_images() -> None:
    for kind in KINDS:
        seen = {hashlib.sha256(np.round(views(kind, seed)[0].distance, 4).tobytes()).digest() for seed in range(10)}
        assert len(seen) == 10


def test_the_hash_counts_the_recipe(monkeypatch: pytest.MonkeyPatch) -> None:
    """A recipe that draws other triangles of the same parameters is another scene."""
    from beambench.scenes.procedural.spec import Rocks

    scene = scene_of("rocks", 1).model_dump(mode="json")
    before = scene_content(scene, ("target", "medium"))
    monkeypatch.setattr(Rocks, "recipe_version", 2)
    assert scene_content(scene, ("target", "medium")) != before


def test_bends_are_no_tighter_than_asked() -> None:
    shape = scene_of("pipes", 0, bends=3).target[0].shape
    x = np.linspace(-1.5, 1.5, 4001)
    for seed in range(50):
        y = lateral(x, shape, 1.0, np.random.default_rng(seed))  # type: ignore[arg-type]
        second = np.gradient(np.gradient(y, x), x)
        assert np.abs(second).max() < 1.02 / 0.5 and np.abs(y).max() <= 1.0 + 1e-12


@pytest.mark.parametrize(
    ("kind", "changes", "told"),
    [
        ("rocks", {"diameter_m": [0.8, 0.2]}, r"\[smallest, largest\]"),
        ("rocks", {"diameter_m": [0.2, 1.19]}, "upon the ground"),
        ("rocks", {"ground_rms_m": 0.3}, "depth"),
        ("pipes", {"bend_radius_m": 0.1}, "cut itself"),
        ("pipes", {"pipes": 4, "diameter_m": [0.2, 0.5]}, "side by side"),
        ("pipes", {"flange_spacing_m": 0.1}, "flange_spacing_m"),
        ("terraces", {"rise_m": [0.1, 0.9]}, "upon the ground"),
        ("terraces", {"blocks": 0, "part": "objects"}, "holds nothing"),
        ("vegetation", {"blade_width_m": 0.2}, "a fifth"),
        ("wreck", {"seed": -1}, "at least 0"),
        ("wreck", {"center_m": [0.0, 0.0, 0.3]}, "inside a target"),
        ("wreck", {"center_m": [0.0, 0.0, -4.0]}, "behind the camera"),
    ],
)
def test_what_cannot_be_is_refused(kind: str, changes: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError) as error:
        load_scene("tilted-wall", CAMERA | {"target.0.shape": shape_of(kind, 1) | changes})
    assert re.search(told, str(error.value))


def test_a_procedural_shape_takes_no_texture() -> None:
    with pytest.raises(InputError, match="materials of their own"):
        load_scene(scene_of("rocks", 1), {"target.0.texture": {"file": "library:relief.npz", "encoding": "linear"}})


def test_user_meshes_are_drawn_by_choice(tmp_path: Path) -> None:
    """Files beside a data set's file, by content: a copy of a mesh under another name is the same scene."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    for name, body in (("a.obj", ball), ("b.obj", ball), ("c.obj", trimesh.creation.box())):
        body.export(tmp_path / name)
    (tmp_path / "d.toml").write_text(
        'schema_version = 1\ndataset = "d"\ncaptures = 30\nseed = 1\nfidelity = "direct"\nrtol = 1e-3\n'
        '[[scenes]]\nscene = "tilted-wall"\n[scenes.overrides]\n'
        '"target.0.shape" = { kind = "mesh", file = "a.obj", size_m = 1.0, center_m = [0.0, 0.0, 4.0], '
        "rotation_deg = [0.0, 0.0, 0.0] }\n"
        '[parameters.body]\nkind = "choice"\nvalues = ["a.obj", "b.obj", "c.obj"]\npaths = ["target.0.shape.file"]\n',
        encoding="utf-8",
    )
    draws = load_dataset(tmp_path / "d.toml")
    drawn = [draws.drawn(number) for number in range(30)]
    hashes = {Path(one.values["body"]).name: draws.content(one) for one in drawn}
    assert set(hashes) == {"a.obj", "b.obj", "c.obj"}
    assert hashes["a.obj"] == hashes["b.obj"] != hashes["c.obj"]
    assert {Path(draws.scene(one).target[0].shape.file).name for one in drawn} == set(hashes)  # type: ignore[union-attr]
