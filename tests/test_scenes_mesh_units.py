"""Meshes that are as large as their file says: units, the file's own origin, and the hint at a wrong unit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.meshes import shape_mesh
from beambench.scenes.shapes import MeshFile
from beambench.scenes.whole import check_whole

#: 1000 × 2000 in its own unit, its origin at a corner.
TRIANGLE = "v 0 0 0\nv 1000 0 0\nv 0 2000 0\nf 1 3 2\n"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "part.obj"
    path.write_text(TRIANGLE)
    return path


def scene_with(file: Path, **more: Any) -> Any:
    shape = {"kind": "mesh", "file": str(file), "center_m": [0.0, 0.0, 5.0], "rotation_deg": [0.0, 0.0, 0.0]}
    return load_scene("flat-wall", {"target.wall.shape": shape | more})


def corners(file: Path, **more: Any) -> Any:
    shape = scene_with(file, **more).target[0].shape
    vertices = shape_mesh(shape, "target")[0]
    return vertices[np.lexsort(vertices.T)]


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("cm", 1e-2), ("in", 0.0254), ("ft", 0.3048), ("m", 1.0)])
def test_a_unit_keeps_the_size(file: Path, unit: str, metres: float) -> None:
    scaled = np.ptp(corners(file, unit=unit, center_m=[0.0, 0.0, 5e3 * metres]), axis=0)
    assert scaled == pytest.approx([1000 * metres, 2000 * metres, 0.0])


def test_the_middle_or_the_files_origin_lies_at_the_centre(file: Path) -> None:
    assert corners(file, unit="mm").min(axis=0) == pytest.approx([-0.5, -1.0, 5.0])
    assert corners(file, unit="mm", origin="file").min(axis=0) == pytest.approx([0.0, 0.0, 5.0])
    turned = corners(file, unit="mm", origin="file", rotation_deg=[0.0, 0.0, 180.0])
    assert turned.min(axis=0) == pytest.approx([-1.0, -2.0, 5.0])


def test_size_and_unit_give_the_same_mesh(file: Path) -> None:
    assert np.allclose(corners(file, unit="mm"), corners(file, size_m=2.0), atol=1e-12)


@pytest.mark.parametrize(
    ("unit", "hint"),
    [("m", '1000 times too large: unit = "mm"?'), ("um", '1000 times too small: unit = "mm"?')],
)
def test_a_wrong_unit_gets_a_hint(file: Path, unit: str, hint: str) -> None:
    with pytest.raises(InputError, match="than its distance") as error:
        check_whole(scene_with(file, unit=unit))
    assert hint in error.value.next_step
    assert error.value.where == "flat-wall: target.wall.shape.unit"


def test_size_or_unit_and_not_both(file: Path) -> None:
    for more in ({}, {"unit": "mm", "size_m": 1.0}, {"size_m": 1.0, "origin": "file"}):
        with pytest.raises(InputError, match="size_m"):
            scene_with(file, **more)


def test_scenes_of_before_keep_their_data() -> None:
    """Absent options are left out, so that hashes and random streams of old scenes stay."""
    shape = MeshFile(file="a.obj", size_m=1.0, center_m=(0.0, 0.0, 1.0), rotation_deg=(0.0, 0.0, 0.0))
    assert sorted(shape.model_dump(mode="json")) == ["center_m", "file", "kind", "rotation_deg", "size_m"]
