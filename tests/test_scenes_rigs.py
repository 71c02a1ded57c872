"""Kinds of rig: each record is complete and agrees with its spec, and a kind that is only listed in the table works everywhere."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from beambench.scenes.declared import declared_rig
from beambench.scenes.errors import InputError
from beambench.scenes.load import list_scenes, load_scene
from beambench.scenes.rigs import RIGS, rig_kind
from beambench.scenes.rigs.roles import ROLES, Steps, check_roles
from beambench.scenes.scene import sizes_of

#: A role whose value lies in an option that a scene may leave out, and the option.
OPTIONS: dict[str, dict[str, Any]] = {
    "phosphor": {"rig.detector.intensifier": {"gain": 9.0, "excess_noise_factor": 2.0, "phosphor_sigma_px": 1.0}},
    "screen": {"rig.screen": {"distance_m": 0.5, "coverage": 0.5, "albedo": 0.5}},
    "motion": {"rig.motion_m_per_s": [0.0, 0.0, 1.0]},
}


def _scenes_of(kind: str) -> list[str]:
    return [name for name in list_scenes() if load_scene(name).modality == kind]


def _held(scene: Any, path: str) -> Any:
    node = scene.model_dump(mode="json")
    for part in path.split("."):
        node = node[part]
    return node


@pytest.mark.parametrize("name", RIGS)
def test_a_record_is_true_of_its_spec(name: str) -> None:
    kind = rig_kind(name)
    assert kind.name == name and kind.spec.model_fields["kind"].default == name
    scene = load_scene(_scenes_of(name)[0])
    assert type(scene.rig) is kind.spec
    assert scene.rig.wavelength_m == pytest.approx(532e-9)
    assert declared_rig(scene)["kind"] == name
    assert kind.places(scene.rig)["camera"] == (0.0, 0.0, 0.0)
    view = kind.view(scene.rig)
    assert view.beam is not None and (view.camera is None) == (view.shots > 1)


@pytest.mark.parametrize("name", RIGS)
def test_a_resized_scene_has_so_many_elements(name: str) -> None:
    for source in _scenes_of(name):
        scene = load_scene(source, rig_kind(name).resize(6))
        samples, rows, cols = sizes_of(scene)
        assert rows * cols == (1 if name == "wavefront" else 36) and samples == sizes_of(load_scene(source))[0]


def _moving(scenes: list[str]) -> str:
    """The first scene whose rig may move: one at stations stands still."""
    return next(source for source in scenes if not getattr(load_scene(source).rig, "stations", None))


@pytest.mark.parametrize("name", RIGS)
def test_every_role_leads_to_a_value_of_a_scene(name: str) -> None:
    for role, where in rig_kind(name).roles.items():
        assert ROLES[role]
        scene = load_scene(_moving(_scenes_of(name)), OPTIONS.get(role))
        if isinstance(where, Steps):
            assert _held(scene, where.step) > 0 and _held(scene, where.count) >= where.least
            load_scene(scene, {where.count: where.least})
            if where.least > 1:
                with pytest.raises(InputError):
                    load_scene(scene, {where.count: where.least - 1})
        else:
            assert _held(scene, where) is not None, (role, where)


def test_every_role_belongs_to_a_kind() -> None:
    assert {role for name in RIGS for role in rig_kind(name).roles} == set(ROLES)


@pytest.mark.parametrize(
    "roles", [{"colour": "rig.x"}, {"sampling": "rig.delays.step_s"}, {"gain": Steps("a", "b", 1)}]
)
def test_a_wrong_role_is_refused(roles: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="role"):
        check_roles(roles, "toy")


def test_an_unknown_kind_is_refused_with_those_that_exist() -> None:
    with pytest.raises(InputError, match="gated, waveform, amcw"):
        rig_kind("sonar")
    with pytest.raises(InputError) as caught:
        load_scene("flat-wall", {"rig.kind": "sonar"})
    assert "rig.kind should be one of gated, waveform, amcw" in str(caught.value)


def test_a_rig_without_a_kind_is_of_the_first() -> None:
    data = load_scene("flat-wall").model_dump(mode="json")
    data["rig"].pop("kind")
    assert load_scene(data) == load_scene("flat-wall") and load_scene(data).modality == next(iter(RIGS))


@pytest.mark.parametrize(
    ("changes", "where"),
    [({"rig.gates.0.wide": 1.0}, "flat-wall: rig.gates.0.wide"), ({"target": []}, "flat-wall: target"),
     ({"medium.index.temperature_c": 99.0}, "flat-wall: medium.index.temperature_c"),
     ({"rig.gates.0": {"kind": "rectangular", "width_s": 1e-9}}, "flat-wall: rig.gates.0.transmission"),
     ({"rig.laser.pulse": {"kind": "gaussian"}}, "flat-wall: rig.laser.pulse.fwhm_s"),
     ({"target.0.shape.kind": "box"}, "flat-wall: target.0.shape.size_m"),
     ({"rig.ambient": 3}, "flat-wall: rig.ambient")],
)  # fmt: skip
def test_errors_name_paths_as_a_user_writes_them(changes: dict[str, Any], where: str) -> None:
    with pytest.raises(InputError) as caught:
        load_scene("flat-wall", changes)
    assert caught.value.where == where


_TOY = '''
from typing import Any, Literal
from beambench.scenes.quantities import MomentTime, Power
from beambench.scenes.rigs.kind import RigKind, RigScene, RigSpec, RigView


class ToyRig(RigSpec):
    """A rig that needs no target."""

    kind: Literal["echo-sounder"] = "echo-sounder"
    power_w: Power
    elements: int
    t0_s: MomentTime

    @property
    def wavelength_m(self) -> float:
        return 532e-9


KIND = RigKind(
    "echo-sounder", ToyRig,
    declare=lambda scene: {"kind": "echo-sounder", "t0_s": scene.rig.t0_s},
    check=lambda scene: None,
    sizes=lambda rig: (1, 1, rig.elements),
    places=lambda rig: {"camera": (0.0, 0.0, 0.0)},
    view=lambda rig: RigView(None, None),
    resize=lambda side: {"rig.elements": side * side},
    roles={"light": "rig.power_w"},
    needs_target=False,
)
'''

_USE = """
from beambench.scenes.rigs import RIGS
RIGS["echo-sounder"] = "toy_rig:KIND"
from beambench.benchmarks.suites.stress import axis_overrides
from beambench.scenes.declared import declared_rig
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.scene import sizes_of
air = load_scene("flat-wall").medium.model_dump(mode="json")
data = {"schema_version": 1, "name": "toy", "title": "Toy", "target": [], "medium": air,
        "rig": {"kind": "echo-sounder", "power_w": 2.0, "elements": 5, "t0_s": 0.0}}
scene = load_scene(data)
assert scene.modality == "echo-sounder" and sizes_of(scene) == (1, 1, 5)
assert load_scene(scene.model_dump(mode="json")) == scene
assert declared_rig(scene) == {"kind": "echo-sounder", "t0_s": 0.0}
assert axis_overrides(scene, "photons", 0.5) == {"rig.power_w": 1.0}
for axis in ("gain", "delay-step", "distance", "screen-gap", "specular", "incidence", "wrong-gate", "motion", "phosphor"):
    try:
        axis_overrides(scene, axis, 0.5)
    except InputError as error:
        assert "does not apply" in error.what and error.allowed, axis
    else:
        raise AssertionError(axis)
print("ok")
"""


def test_a_kind_that_only_the_table_lists_works(tmp_path: Path) -> None:
    (tmp_path / "toy_rig.py").write_text(_TOY, encoding="utf-8")
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    ran = subprocess.run(
        [sys.executable, "-c", _USE], capture_output=True, text=True, env=os.environ | {"PYTHONPATH": path}, check=False
    )
    assert ran.returncode == 0 and ran.stdout == "ok\n", ran.stderr
