"""Mitsuba's first hits against trimesh's own ray engine, on scanned and built-in surfaces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beambench.generator.rays.trace import Tracer, pixel_directions
from beambench.scenes.load import load_scene
from beambench.scenes.meshes import shape_mesh
from beambench.scenes.scene import Scene

CAMERA = {"rig.camera.rows": 160, "rig.camera.cols": 160, "rig.camera.focal_length_m": 9.0e-3}


def mesh_scene(file: str, rotation: list[float]) -> Scene:
    shape = {"kind": "mesh", "file": file, "size_m": 0.9, "center_m": [0.0, 0.0, 4.6], "rotation_deg": rotation}
    return load_scene("flat-wall", CAMERA | {"target.0.shape": shape})


def compare(scene: Scene) -> tuple[float, float]:
    """(share of rays on which both agree that there is a hit, largest relative difference away from edges)."""
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("embreex")
    vertices, faces = shape_mesh(scene.target[0].shape, "test")
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    row, col = (a.ravel() for a in np.mgrid[:160, :160])
    direction = pixel_directions(scene.rig.camera, row, col)
    ours = Tracer(scene).trace((0.0, 0.0, 0.0), direction)
    # trimesh refines Embree's hit by intersecting the triangle's plane in double precision.
    points, rays, triangle = mesh.ray.intersects_location(np.zeros((160 * 160, 3)), direction.T, multiple_hits=False)
    theirs = np.full(160 * 160, np.inf)
    theirs[rays] = np.linalg.norm(points, axis=1)
    slope = np.zeros(160 * 160)
    slope[rays] = np.abs(np.einsum("ni,in->n", mesh.face_normals[triangle], direction[:, rays]))
    both = np.isfinite(ours.distance) & np.isfinite(theirs)
    # Away from edges: the neighbours see the surface at nearly the same range, and not at a grazing angle.
    picture = np.where(both, theirs, np.inf).reshape(160, 160)
    calm = np.zeros((160, 160), dtype=bool)
    with np.errstate(invalid="ignore"):
        spread = np.max([np.abs(np.roll(picture, s, a) - picture) for s in (1, -1) for a in (0, 1)], axis=0)
    calm[1:-1, 1:-1] = spread[1:-1, 1:-1] < 0.02
    chosen = both & calm.ravel() & (slope > 0.2)
    assert chosen.sum() > 1000
    agree = float(np.mean(np.isfinite(ours.distance) == np.isfinite(theirs)))
    return agree, float(np.abs(ours.distance[chosen] / theirs[chosen] - 1).max())


@pytest.mark.data
@pytest.mark.parametrize(
    ("file", "rotation"), [("bunny_npm.obj", [180.0, 20.0, 0.0]), ("dragon_vrip_res3.ply.gz", [180.0, 0.0, 0.0])]
)
def test_first_hits_on_scanned_meshes_agree_with_trimesh(real_data: Path, file: str, rotation: list[float]) -> None:
    agree, worst = compare(mesh_scene(str(real_data / "mesh_stanford" / file), rotation))
    assert agree > 0.999
    assert worst < 1e-5


def test_first_hits_on_the_shipped_relief_agree_with_trimesh() -> None:
    relief = load_scene("relief-tank").target[0].model_dump(mode="json")
    agree, worst = compare(load_scene("flat-wall", CAMERA | {"target": [relief]}))
    assert agree > 0.999
    assert worst < 1e-5


def test_sphere_is_exact() -> None:
    scene = load_scene("sphere", CAMERA)
    direction = pixel_directions(scene.rig.camera, np.arange(160.0), np.full(160, 79.5))
    hits = Tracer(scene).trace((0.0, 0.0, 0.0), direction)
    mine = hits.target == 0
    assert mine.sum() > 30
    b = direction[2] * 4.7
    expected = b - np.sqrt(np.maximum(b**2 - 4.7**2 + 0.3**2, 0.0))
    assert np.abs(hits.distance[mine] / expected[mine] - 1).max() < 1e-5
    point = direction[:, mine] * hits.distance[mine]
    normal = (point - np.array([[0.0], [0.0], [4.7]])) / 0.3
    assert np.abs(hits.normal[:, mine] - normal).max() < 2e-4  # float32 hit points over a radius of 0.3 m


def test_an_exception_inside_mitsuba_is_an_exception_here() -> None:
    """libLLVM's C++ runtime must not take over Mitsuba's exceptions: the process would end without a word."""
    import subprocess
    import sys

    code = (
        "import numba, scipy.special\nfrom beambench.generator.rays.backend import mitsuba\nmi = mitsuba()\n"
        "try:\n    mi.load_dict({'type': 'scene', 'x': {'type': 'no-such-plugin'}})\n"
        "except Exception as error:\n    print('caught', type(error).__name__)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.startswith("caught")
