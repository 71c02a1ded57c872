"""Impossible scenes are refused with the reason, at the command line: exit 2, the place, no traceback."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.cli import main
from beambench.scenes.errors import InputError
from beambench.scenes.load import list_scenes, load_scene
from beambench.scenes.possible import check_possible, inside_closed

SPHERE = {"kind": "sphere", "center_m": [0.0, 0.0, 0.5], "radius_m": 1.0}
BOX = {"kind": "box", "center_m": [0.0, 0.0, 0.2], "size_m": [1.0, 1.0, 1.0], "rotation_deg": [10.0, 40.0, 0.0]}
PLATE = {
    "kind": "rectangle",
    "center_m": [0.0, 0.0, 0.0],
    "width_m": 1.0,
    "height_m": 1.0,
    "tilt_x_deg": 0.0,
    "tilt_y_deg": 30.0,
}
BESIDE = {"kind": "sphere", "center_m": [1.0, 0.0, 1.0], "radius_m": 0.5}
ROD = {"kind": "box", "center_m": [0.0, 0.0, 3.0], "size_m": [0.2, 0.2, 1.0], "rotation_deg": [0.0, 0.0, 0.0]}

IMPOSSIBLE: list[tuple[str, dict[str, Any], str, str]] = [
    # scene, overrides, what it says, where
    ("flat-wall", {"target.0.shape": SPHERE}, "camera is inside", "target.wall"),
    ("flat-wall", {"target.0.shape": BOX}, "camera is inside", "target.wall"),
    ("flat-wall", {"target.0.shape": PLATE}, "camera is inside", "target.wall"),
    ("counter", {"target.0.shape": SPHERE}, "camera is inside", "target.wall"),
    ("amcw", {"target.0.shape": BOX}, "camera is inside", "target.wall"),
    ("flat-wall", {"target.0.shape": BESIDE, "rig.laser.position_m": [1.0, 0.0, 0.8]}, "laser is inside", "target.wall"),
    ("flat-wall", {"target.0.shape.center_m": [0.0, 0.0, -5.0]}, "behind the camera", "target.wall"),
    ("sphere", {"target.1.shape.center_m": [0, 0, -1.0], "target.0.shape.center_m": [0, 0, -2.0]}, "behind the camera", "target"),
    ("counter", {"target.0.shape.center_m": [0.0, 0.0, -4.0]}, "behind the camera", "target.wall"),
    ("flat-wall", {"rig.laser.position_m": [0.0, 0.0, 6.0]}, "behind the target", "rig.laser.position_m"),
    ("tilted-wall", {"rig.laser.position_m": [20.0, 0.0, 4.9], "target.0.shape.tilt_y_deg": 45.0}, "behind the target",
     "rig.laser.position_m"),
    ("relief-tank", {"rig.laser.position_m": [0.0, 0.1, -0.2]}, "behind the window", "rig.laser.position_m"),
    ("flat-wall", {"medium.absorption_per_m": -0.1, "medium.scattering_per_m": 0.3}, "at least 0",
     "medium.absorption_per_m"),  # b = .3 exceeds c = .2
    ("flat-wall", {"medium.scattering_per_m": -0.1}, "at least 0", "medium.scattering_per_m"),
    ("flat-wall", {"medium.attenuation_per_m": 0.1}, "Unknown key", "medium.attenuation_per_m"),
    ("flat-wall", {"medium.index": {"kind": "explicit", "phase": 0.9, "group": 1.0}}, "at least 1", "medium.index"),
    ("flat-wall", {"target.0.shape.width_m": 0.0}, "above 0", "shape"),
    ("sphere", {"target.0.shape.radius_m": 0.0}, "above 0", "shape"),
    ("flat-wall", {"target.0.shape": BOX | {"size_m": [1.0, 0.0, 1.0]}}, "above 0", "shape"),
    ("relief-tank", {"target.0.shape.relief_m": 0.0}, "above 0", "shape"),
    ("flat-wall", {"target.0.shape.tilt_x_deg": 90.0}, "below 90", "shape"),
    ("flat-wall", {"rig.gates.0.width_s": 2e-5}, "longer than the time between two pulses", "rig.gates.0"),
    ("flat-wall", {"rig.pulses_per_slice": 10_000_000}, "longer than the time between two pulses", "rig.gates.0"),
    ("amcw", {"rig.modulation.integration_s": 1e-8}, "less than one period", "rig.modulation.integration_s"),
    ("flat-wall", {"rig.gates.0.width_s": 0.0}, "at least 1e-", "rig.gates"),
    ("flat-wall", {"rig.laser.pulse.fwhm_s": -1e-9}, "at least 1e-", "rig.laser.pulse"),
    ("flat-wall", {"rig.laser.illumination.half_angle_rad": 1.6}, "below 1.5", "half_angle_rad"),
    ("flat-wall", {"target.0.material.albedo": 1.2}, "at most 1", "albedo"),
    ("flat-wall", {"rig.camera.focal_length_m": 0.0}, "at least 1e-", "focal_length_m"),
    ("amcw", {"rig.range_window_m": [5.0, 5.0]}, "end beyond its start", "rig"),
    ("counter", {"rig.record.samples": 1}, "at least 4", "rig.record.samples"),
]  # fmt: skip


@pytest.mark.parametrize(("scene", "changes", "says", "where"), IMPOSSIBLE)
def test_impossible_scenes_are_refused(
    scene: str, changes: dict[str, Any], says: str, where: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    words = [w for path, value in changes.items() for w in ("--set", f"{path}={json.dumps(value)}")]
    out = tmp_path / "never.zarr"
    assert main(["generate", scene, *words, "-o", str(out)]) == 2
    told = capsys.readouterr().err
    assert says in told and where in told and "Traceback" not in told
    assert not out.exists()


@pytest.mark.parametrize("text", ["NaN", "Infinity", "-Infinity"])
def test_numbers_that_are_none(text: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["scenes", "show", "flat-wall", "--set", f"rig.laser.pulse_energy_j={text}"]) == 2
    assert "finite" in capsys.readouterr().err
    file = tmp_path / "x.toml"
    number = {"NaN": "nan", "Infinity": "inf", "-Infinity": "-inf"}[text]
    source = Path(load_scene.__code__.co_filename).parent / "library" / "flat-wall.toml"
    file.write_text(source.read_text().replace("pulse_energy_j = 2.5e-6", f"pulse_energy_j = {number}"))
    assert main(["generate", str(file), "-o", str(tmp_path / "y.zarr")]) == 2
    assert "finite" in capsys.readouterr().err


def test_inside_a_closed_mesh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import trimesh

    ball = trimesh.creation.icosphere(3, 1.0)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces)
    for point, expected in (([0, 0, 0], True), ([0.5, 0.3, -0.4], True), ([0.9, 0.9, 0], False), ([0, 0, 1.5], False)):
        assert inside_closed(np.asarray(point, float), vertices, faces) == expected
    assert not inside_closed(np.zeros(3), vertices, faces[:-1]), "a shell with a hole has no inside"
    ring = trimesh.creation.torus(1.0, 0.3)
    assert not inside_closed(np.zeros(3), np.asarray(ring.vertices), np.asarray(ring.faces)), (
        "the hole of a torus is outside"
    )
    assert inside_closed(np.array([1.0, 0.0, 0.1]), np.asarray(ring.vertices), np.asarray(ring.faces))
    file = tmp_path / "ball.ply"
    ball.export(file)
    shape = {
        "kind": "mesh",
        "file": str(file),
        "size_m": 2.0,
        "center_m": [0.0, 0.0, 0.3],
        "rotation_deg": [0.0, 0.0, 0.0],
    }
    words = ["--set", f"target.0.shape={json.dumps(shape)}", "-o", str(tmp_path / "z.zarr")]
    assert main(["generate", "flat-wall", *words]) == 2
    assert "camera is inside" in capsys.readouterr().err
    aside = shape | {"center_m": [1.5, 0.0, 3.0]}
    words = ["--set", f"target.0.shape={json.dumps(aside)}", "--set", "rig.laser.position_m=[1.5,0.0,2.5]"]
    assert main(["generate", "flat-wall", *words, "-o", str(tmp_path / "z.zarr")]) == 2
    assert "laser is inside" in capsys.readouterr().err


def test_what_is_possible_is_not_refused() -> None:
    for name in list_scenes():
        check_possible(load_scene(name))
    # Beside a box, before a tilted wall's near edge, inside a room that has no front wall.
    load_scene("flat-wall", {"target.0.shape": ROD, "rig.laser.position_m": [0.11, 0.0, 3.0]})
    load_scene("flat-wall", {"rig.laser.position_m": [0.0, 0.0, -0.3]})
    load_scene("flat-wall", {"rig.laser.position_m": [0.0, 0.0, 4.9]})
    with pytest.raises(InputError, match="laser is inside"):
        load_scene("flat-wall", {"target.0.shape": ROD, "rig.laser.position_m": [0.09, 0.0, 3.0]})


def test_a_scene_made_in_python_is_checked_when_it_is_traced() -> None:
    from beambench.generator.rays.trace import Tracer

    scene = load_scene("sphere")
    near = scene.target[0].shape.model_copy(update={"center_m": (0.0, 0.0, 0.1)})
    item = scene.target[0].model_copy(update={"shape": near})
    with pytest.raises(InputError, match="camera is inside"):
        Tracer(scene.model_copy(update={"target": (item, *scene.target[1:])}))


@pytest.mark.parametrize(("pulses", "fine"), [(100, True), (25_000, True), (26_000, False), (100_000, False)])
def test_delays_beyond_the_next_pulse_are_refused(pulses: int, fine: bool) -> None:
    """Behind every later pulse the echo of an earlier one lies in the gates; the last of flat-wall opens after 38.95 ns, and
    1 ms holds 25,000 pulses 40 ns apart, 26,000 of them 38.5 ns."""
    changes = {"rig.pulses_per_slice": pulses}
    if fine:
        load_scene("flat-wall", changes)
        return
    with pytest.raises(InputError, match="next pulse") as caught:
        load_scene("flat-wall", changes)
    assert "pulses_per_slice" in caught.value.where
