"""Scenes: the library loads, overrides mean the same everywhere, and invalid input is refused with a clear message."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.optics.rotation import rotation_matrix
from beambench.scenes.declared import declared_rig
from beambench.scenes.errors import InputError
from beambench.scenes.load import list_scenes, load_scene
from beambench.scenes.meshes import load_grid, measure_shape, shape_mesh
from beambench.scenes.overrides import apply_overrides, parse_assignments
from beambench.scenes.scene import Scene
from beambench.scenes.spec_files import LIBRARY


def test_the_library_is_not_empty_and_every_scene_loads() -> None:
    names = list_scenes()
    assert {"flat-wall", "tilted-wall", "step", "sphere", "panel", "object1", "object2", "relief-tank"} <= set(names)
    for name in names:
        scene = load_scene(name)
        assert scene.name == name
        assert Scene.model_validate_json(scene.model_dump_json()) == scene


def plain(name: str) -> dict[str, Any]:
    return tomllib.loads((LIBRARY / f"{name}.toml").read_text())


def numbers(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    if isinstance(node, dict):
        return [p for k, v in node.items() for p in numbers(v, (*path, k))]
    if isinstance(node, list):
        return [p for k, v in enumerate(node) for p in numbers(v, (*path, k))]
    return [path] if isinstance(node, int | float) and not isinstance(node, bool) else []


@pytest.mark.parametrize("path", numbers(plain("flat-wall")), ids=lambda p: ".".join(map(str, p)))
def test_no_physical_value_has_a_silent_default(path: tuple[Any, ...]) -> None:
    """Taking any number out of a scene file is an error, except the counts that have a documented default."""
    data = plain("flat-wall")
    node: Any = data
    for key in path[:-1]:
        node = node[key]
    if isinstance(node, list):
        del node[path[-1]]
    else:
        del node[path[-1]]
    if path in {("schema_version",), ("rig", "delays", "laser_off"), ("rig", "delays", "repeats")}:
        assert load_scene(data) == load_scene("flat-wall")
        return
    with pytest.raises(InputError):
        load_scene(data)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("rig.laser.pulse_energy_j", -1.0), ("rig.laser.pulse_energy_j", 0.0), ("rig.laser.pulse_energy_j", "1e-6"),
        ("rig.camera.rows", 0), ("rig.camera.rows", 2.5), ("rig.camera.quantum_efficiency", 1.5),
        ("rig.camera.f_number", True), ("medium.absorption_per_m", -0.1), ("rig.detector.adc_bits", 17),
        ("rig.gates", []), ("rig.gates.0.transmission", 2.0), ("target", []), ("rig.laser.pulse.kind", "sech"),
        ("rig.delays.count", 0), ("name", "../escape"), ("name", ""), ("rig.laser.pulse.tail_s", 1e-9),
        ("target.0.shape.tilt_x_deg", 90.0), ("schema_version", 2), ("rig.detector.intensifier", {"gain": 10.0}),
    ],
)  # fmt: skip
def test_impossible_values_are_refused_with_their_path(path: str, value: object) -> None:
    with pytest.raises(InputError) as caught:
        load_scene("flat-wall", {path: value})
    assert path.split(".")[0] in caught.value.where


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_numbers_are_finite(value: float) -> None:
    with pytest.raises(InputError):
        load_scene("flat-wall", {"rig.laser.pulse_energy_j": value})


def test_unknown_names_come_with_near_matches() -> None:
    with pytest.raises(InputError, match="relief-tank"):
        load_scene("relieftank")
    with pytest.raises(InputError, match="rows"):
        load_scene("flat-wall", {"rig.camera.row": 5})
    with pytest.raises(InputError, match="camera"):
        load_scene("flat-wall", {"rig.camra.rows": 5})


def test_command_line_and_python_overrides_give_the_same_scene(tmp_path: Path) -> None:
    typed = parse_assignments(
        ["rig.camera.rows=32", 'target.wall.material={"kind": "lambert", "albedo": 0.25}', "title=A wall"]
    )
    python = {
        "rig.camera.rows": 32,
        "target.0.material": {"kind": "lambert", "albedo": 0.25},
        "title": "A wall",
    }
    scene = load_scene("flat-wall", typed)
    assert scene == load_scene("flat-wall", python)
    saved = tmp_path / "mine.json"
    saved.write_text(scene.model_dump_json())
    assert load_scene(saved) == scene
    assert load_scene(json.loads(saved.read_text())) == scene


@pytest.mark.parametrize("text", ["rows", "=3", "a=1=2x", "rig.camera.rows=NaN"])
def test_malformed_assignments(text: str) -> None:
    if text == "a=1=2x":
        assert parse_assignments([text]) == {"a": "1=2x"}
        return
    with pytest.raises(InputError):
        parse_assignments([text])
    with pytest.raises(InputError):
        parse_assignments(["a=1", "a=2"])


def test_overrides_leave_their_input_alone() -> None:
    data = {"a": {"b": [1, {"c": 2}]}}
    changed = apply_overrides(data, {"a.b.1.c": 5})
    assert data == {"a": {"b": [1, {"c": 2}]}} and changed == {"a": {"b": [1, {"c": 5}]}}


@pytest.mark.parametrize("content", [b"", b"\x00\xff\xfe", b"[[[", b"{" * 100_000, b"a = 1\na = 2"])
@pytest.mark.parametrize("suffix", [".toml", ".json"])
def test_damaged_scene_files(tmp_path: Path, content: bytes, suffix: str) -> None:
    path = tmp_path / f"broken{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError):
        load_scene(path)


def test_declared_values_change_what_estimators_are_told_and_nothing_else() -> None:
    honest = load_scene("flat-wall")
    wrong = load_scene(
        "flat-wall", {"declared": {"medium.index": {"kind": "explicit", "phase": 1.1, "group": 1.1}, "t0_s": 1e-9}}
    )
    assert wrong.rig == honest.rig and wrong.medium == honest.medium
    told = declared_rig(wrong)
    assert told["medium"]["group_index"] == 1.1 and told["t0_s"] == 1e-9
    assert declared_rig(honest)["t0_s"] == 0.0
    with pytest.raises(InputError):
        declared_rig(load_scene("flat-wall", {"declared": {"laser.pulse.fwhm_s": -1.0}}))
    with pytest.raises(InputError):
        declared_rig(load_scene("flat-wall", {"declared": {"lasr.pulse": 1}}))


def test_the_declared_rig_holds_samples_not_closed_forms() -> None:
    told = declared_rig(load_scene("flat-wall"))
    text = json.dumps(told)
    assert "fwhm" not in text and "gaussian" not in text
    pulse = told["pulse"]
    value = np.array(pulse["value"])
    t = pulse["start_s"] + pulse["step_s"] * np.arange(len(value))
    assert np.trapezoid(value, t) == pytest.approx(1.0, abs=1e-6)
    assert np.trapezoid(value * t, t) == pytest.approx(0.0, abs=1e-15)
    gate = told["gates"][0]
    assert np.sum(gate["value"]) * gate["step_s"] == pytest.approx(1e-9, rel=1e-6)


def test_meshes_that_cannot_be_read(tmp_path: Path) -> None:
    def load(name: str, content: bytes | None) -> None:
        path = tmp_path / name
        if content is not None:
            path.write_bytes(content)
        shape = {
            "kind": "mesh", "file": str(path), "size_m": 1.0, "center_m": [0.0, 0.0, 5.0], "rotation_deg": [0.0] * 3,
        }  # fmt: skip
        scene = load_scene("flat-wall", {"target.0.shape": shape})
        shape_mesh(scene.target[0].shape, "target.wall")

    for name, content in [
        ("missing.obj", None), ("empty.obj", b""), ("junk.ply", b"\x00" * 100), ("points.obj", b"v 0 0 0\nv 1 0 0\n"),
        ("kind.xyz", b"0 0 0\n"), ("broken.stl", b"solid x\nfacet"), ("junk.ply.gz", b"\x1f\x8bjunk"),
        ("nan.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    ]:  # fmt: skip
        with pytest.raises(InputError) as caught:
            load(name, content)
        assert "target.wall" in caught.value.where, name


def test_grids_that_cannot_be_read(tmp_path: Path) -> None:
    good = np.arange(12.0).reshape(3, 4)
    np.save(tmp_path / "good.npy", good)
    assert np.array_equal(load_grid(str(tmp_path / "good.npy"), "x"), good)
    np.savez(tmp_path / "two.npz", a=good, b=good)
    np.save(tmp_path / "flat.npy", np.ones((3, 3)))
    np.save(tmp_path / "nan.npy", np.full((3, 3), np.nan))
    np.save(tmp_path / "line.npy", np.arange(5.0))
    np.save(tmp_path / "pickled.npy", np.array([[{}, 1], [2, 3]], dtype=object), allow_pickle=True)
    (tmp_path / "cut.npy").write_bytes((tmp_path / "good.npy").read_bytes()[:-9])
    for name in ("two.npz", "flat.npy", "nan.npy", "line.npy", "pickled.npy", "cut.npy", "missing.npy"):
        with pytest.raises(InputError):
            load_grid(str(tmp_path / name), "x")
    for escape in ("library:../load.py", "library:/etc/passwd", "library:nothing.npz"):
        with pytest.raises(InputError):
            load_grid(escape, "x")


def test_rotations_are_right_handed_and_applied_x_then_y_then_z() -> None:
    assert np.allclose(rotation_matrix((90, 0, 0)) @ [0, 1, 0], [0, 0, 1])
    assert np.allclose(rotation_matrix((0, 90, 0)) @ [0, 0, 1], [1, 0, 0])
    assert np.allclose(rotation_matrix((0, 0, 90)) @ [1, 0, 0], [0, 1, 0])
    assert np.allclose(rotation_matrix((90, 90, 0)) @ [0, 1, 0], [1, 0, 0])


def test_a_height_grid_is_scaled_and_faces_the_camera() -> None:
    scene = load_scene("relief-tank")
    vertices, faces = shape_mesh(scene.target[0].shape, "x")
    assert np.ptp(vertices[:, 0]) == pytest.approx(1.5)
    assert vertices[:, 2].max() == pytest.approx(2.55) and np.ptp(vertices[:, 2]) == pytest.approx(0.15)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    assert (np.cross(b - a, c - a)[:, 2] < 0).all()


def test_meshes_are_measured() -> None:
    box = load_scene("object1").target[0].shape
    told = measure_shape(box, "x")
    assert told["watertight"] and told["loose_edges"] == 0
    assert told["volume_m3"] == pytest.approx(0.9 * 0.9 * 0.12)
    assert told["area_m2"] == pytest.approx(2 * (0.81 + 2 * 0.108))
    wall = measure_shape(load_scene("flat-wall").target[0].shape, "x")
    assert wall["area_m2"] == pytest.approx(36.0) and not wall["watertight"] and wall["loose_edges"] == 4


@pytest.mark.data
def test_scanned_meshes_are_measured(real_data: Path) -> None:
    def shape(file: str) -> dict[str, object]:
        return {
            "kind": "mesh", "file": str(real_data / "mesh_stanford" / file), "size_m": 1.0, "center_m": [0.0, 0.0, 5.0],
            "rotation_deg": [0.0] * 3,
        }  # fmt: skip

    bunny = measure_shape(load_scene("flat-wall", {"target.0.shape": shape("bunny_npm.obj")}).target[0].shape, "x")
    assert bunny["watertight"] and bunny["faces"] == 3674
    dragon = load_scene("flat-wall", {"target.0.shape": shape("dragon_vrip_res3.ply.gz")})
    told = measure_shape(dragon.target[0].shape, "x")
    assert told["faces"] == 47794 and not told["watertight"] and told["loose_edges"] > 0


def test_the_next_step_of_a_wrong_scene_shows_one_with_the_same_kind_of_rig() -> None:
    for name in list_scenes():
        data = load_scene(name).model_dump(mode="json")
        data["rig"]["no_such_key"] = 1
        with pytest.raises(InputError) as caught:
            load_scene(data)
        shown = caught.value.next_step.split()[3]
        assert load_scene(shown).modality == load_scene(name).modality, name


@pytest.mark.parametrize("kind", [[], {}, 7, None, "no-such-rig"])
def test_a_kind_of_rig_that_is_no_name_is_refused(kind: Any) -> None:
    data = load_scene("flat-wall").model_dump(mode="json")
    data["rig"]["kind"] = kind
    with pytest.raises(InputError) as caught:
        load_scene(data)
    assert caught.value.next_step
