"""What `generate` refuses is refused by `scenes show` and before any light is traced: files of a scene, and declared paths."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import beambench
from beambench import InputError
from beambench.generator.generate import generate
from beambench.scenes.declared import declared_rig
from beambench.scenes.kept import Kept
from beambench.scenes.load import load_scene
from beambench.scenes.meshes import shape_mesh
from beambench.scenes.shapes import MeshFile

TRIANGLE = "v -1 -1 0\nv 1 -1 0\nv 0 1 0\nf 1 3 2\n"


def mesh(file: Path, **more: Any) -> dict[str, Any]:
    shape = {
        "kind": "mesh",
        "file": str(file),
        "size_m": 1.0,
        "center_m": [0.0, 0.0, 5.0],
        "rotation_deg": [0.0, 0.0, 0.0],
    }
    return {"target.wall.shape": shape | more}


def cases(folder: Path) -> dict[str, tuple[dict[str, Any], str]]:
    """What is wrong -> (overrides of flat-wall, the place that the message names)."""
    (folder / "empty.obj").write_text("v 0 0 0\nv 1 0 0\n")
    (folder / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    (folder / "whole.obj").write_text(TRIANGLE)
    np.save(folder / "level.npy", np.zeros((3, 3)))
    np.save(folder / "bright.npy", np.full((3, 3), 2.0))
    grid = {"kind": "height-grid", "file": str(folder / "level.npy"), "center_m": [0.0, 0.0, 5.0]}
    grid |= {"width_m": 1.0, "relief_m": 0.1, "tilt_x_deg": 0.0, "tilt_y_deg": 0.0}
    texture = {"target.wall.texture": {"file": str(folder / "bright.npy"), "encoding": "linear"}}
    return {
        "no mesh": (mesh(folder / "hole.obj"), "flat-wall: target.wall.shape.file"),
        "no triangles": (mesh(folder / "empty.obj"), "flat-wall: target.wall.shape.file"),
        "no area": (mesh(folder / "flat.obj"), "flat-wall: target.wall.shape.file"),
        "level grid": ({"target.wall.shape": grid}, "flat-wall: target.wall.shape.file"),
        "too bright a texture": (texture, "flat-wall: target.wall.texture"),
        "no uv": (
            mesh(folder / "whole.obj")
            | {"target.wall.texture": {"file": "library:checkerboard.npz", "encoding": "linear"}},
            "flat-wall: target.wall.shape.file",
        ),
        "declared path with rig": ({"declared": {"rig.t0_s": 1e-9}}, "flat-wall: declared: rig.t0_s"),
        "declared path misspelt": (
            {"declared": {"lazer.pulse.fwhm_s": 1e-9}},
            "flat-wall: declared: lazer.pulse.fwhm_s",
        ),
        "declared key unknown": ({"declared": {"t0": 1e-9}}, "flat-wall: declared: t0"),
        "declared value": ({"declared": {"t0_s": "late"}}, "flat-wall: declared: t0_s"),
    }


NAMES = (
    "no mesh", "no triangles", "no area", "level grid", "too bright a texture", "no uv", "declared path with rig",
    "declared path misspelt", "declared key unknown", "declared value",
)  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_show_plan_and_generate_refuse_alike(name: str, tmp_path: Path) -> None:
    changes, where = cases(tmp_path)[name]
    said = []
    for verb in (
        lambda: beambench.scenes_show("flat-wall", overrides=changes),
        lambda: beambench.generate("flat-wall", overrides=changes, plan=True),
        lambda: generate(load_scene("flat-wall", changes), seed=1),
    ):
        with pytest.raises(InputError) as error:
            verb()
        said.append(str(error.value))
        assert error.value.where == where
    assert len(set(said)) == 1


def test_the_remedy_of_a_declared_path_is_told() -> None:
    for path, remedy in (("rig.t0_s", 'write "t0_s"'), ("lazer.pulse", "did you mean laser?")):
        with pytest.raises(InputError) as error:
            load_scene("flat-wall", {"declared": {path: 1e-9}})
        assert error.value.next_step == remedy


def test_a_file_of_nearly_this_name_is_told(tmp_path: Path) -> None:
    (tmp_path / "wall.obj").write_text(TRIANGLE)
    with pytest.raises(InputError, match=r"did you mean wall\.obj"):
        beambench.scenes_show("flat-wall", overrides=mesh(tmp_path / "wal.obj"))


def test_a_camera_inside_a_mesh_is_refused_before_tracing(tmp_path: Path) -> None:
    box = mesh(tmp_path / "box.obj", size_m=4.0, center_m=[0.5, 0.5, 0.5])
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    sides = ((1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4))
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f " + " ".join(map(str, side)) for side in sides]
    (tmp_path / "box.obj").write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match="inside a target"):
        beambench.scenes_show("flat-wall", overrides=box)


def test_a_file_that_changes_is_read_again(tmp_path: Path) -> None:
    """What is kept belongs to the file's state; whoever gets it cannot change it."""
    file = tmp_path / "one.obj"
    file.write_text(TRIANGLE)
    shape = MeshFile(file=str(file), size_m=2.0, center_m=(0.0, 0.0, 5.0), rotation_deg=(0.0, 0.0, 0.0))
    first = shape_mesh(shape, "target")[0]
    assert np.array_equal(first, shape_mesh(shape, "target")[0])
    file.write_text(TRIANGLE.replace("v 0 1 0", "v 0 3 0"))
    assert not np.allclose(first, shape_mesh(shape, "target")[0])
    with pytest.raises(ValueError, match="read-only"):
        shape_mesh(shape, "target")[1][0, 0] = 7


def test_kept_holds_the_last_few_small_files(tmp_path: Path) -> None:
    kept: Kept[str] = Kept(most=2, most_bytes=8)
    for name, text in (("a", "one"), ("b", "two"), ("c", "three"), ("long", "far too long")):
        (tmp_path / name).write_text(text)
    read: list[str] = []

    def of(name: str) -> str:
        def now() -> str:
            read.append(name)
            return (tmp_path / name).read_text()

        return kept.of(tmp_path / name, now)

    for name in ("a", "a", "b", "c", "a", "long", "long"):
        assert of(name) == (tmp_path / name).read_text()
    assert read == ["a", "b", "c", "a", "long", "long"]


#: A scene of each modality in water, and the rungs that need its phase function.
WET = {
    "flat-wall": ("scatter", "full"),
    "amcw": ("scatter", "auto"),
    "counter": ("scatter", "auto"),
    "spotscan-wall": ("scatter", "full", "auto"),
}


@pytest.mark.parametrize("name", WET)
def test_a_plan_needs_the_phase_function_of_water(name: str) -> None:
    """It was asked for after twenty seconds of generating; a rung that does not need it goes on without."""
    cloudy = {"medium.scattering_per_m": 0.1, "medium.phase_function": None, "medium.water_type": None}
    for rung in WET[name]:
        with pytest.raises(InputError, match="phase function") as error:
            beambench.generate(name, overrides=cloudy, fidelity=rung, plan=True)  # type: ignore[arg-type]
        assert "fournier-forand" in error.value.allowed
    assert beambench.generate(name, overrides=cloudy, fidelity="direct", plan=True).plan


def test_a_preset_gives_way_to_a_declared_value() -> None:
    """The stress of a wrong pitch was refused on a sensor that is given by its preset."""
    scene = load_scene("gated-turbulence", {"declared": {"lenslets.pitch_m": 1.6e-4}})
    assert declared_rig(scene)["lenslets"]["pitch_m"] == 1.6e-4
