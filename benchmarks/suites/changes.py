"""Changes from which stress axes are built: functions of a scene and a level that return overrides, {path: value}.

A change of a role reads from the kind of rig what the role means (`scenes.rigs.roles`); no change names a kind of rig. It
raises `DoesNotApply` if the scene has nothing to change; the axis converts this into an InputError with its name.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ...scenes.rigs import RIGS, rig_kind
from ...scenes.rigs.roles import Role, Steps
from ...scenes.scene import Scene, TargetObject

__all__ = [
    "Change", "DoesNotApply", "Overrides", "add", "declare", "held", "multiply", "objects", "path_of", "set_present",
    "set_to", "steps_of",
]  # fmt: skip

Overrides = dict[str, Any]
Change = Callable[[Scene, float], Overrides]


class DoesNotApply(ValueError):
    """The scene has nothing that the stress could change. `allowed`: the scenes that have it."""

    def __init__(self, allowed: str) -> None:
        self.allowed = allowed
        super().__init__(allowed)


def _role(scene: Scene, role: str) -> Role:
    """The meaning of a role for the scene's kind of rig."""
    roles = rig_kind(scene.modality).roles
    if role not in roles:
        fitting = [name for name in RIGS if role in rig_kind(name).roles]
        raise DoesNotApply(f"scenes with a rig of kind {', '.join(fitting)}")
    return roles[role]


def path_of(scene: Scene, role: str) -> str:
    """The path of a role that is a single value of the scene. Raises DoesNotApply if the kind of rig has no such role."""
    path = _role(scene, role)
    assert isinstance(path, str), role
    return path


def steps_of(scene: Scene, role: str) -> Steps:
    """The paths of a role that is a uniform series in time. Raises DoesNotApply if the kind of rig has no such role."""
    steps = _role(scene, role)
    assert isinstance(steps, Steps), role
    return steps


def held(scene: Scene, path: str) -> Any:
    """The value of the scene at a path, or None."""
    node: Any = scene.model_dump(mode="json")
    for part in path.split("."):
        node = node[int(part)] if isinstance(node, list) else node.get(part) if isinstance(node, dict) else None
    return node


def _number(scene: Scene, role: str) -> tuple[str, float]:
    """Path and value of a role that is a number."""
    path = path_of(scene, role)
    value = held(scene, path)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise DoesNotApply(f"scenes with a number at {path}")
    return path, value


def objects(scene: Scene) -> tuple[TargetObject, ...]:
    """The objects of the target. Raises DoesNotApply if there are none."""
    if not scene.target:
        raise DoesNotApply("scenes with an object in the target")
    return scene.target


def multiply(role: str) -> Change:
    """Multiply the value of the role by the level."""

    def change(scene: Scene, level: float) -> Overrides:
        path, value = _number(scene, role)
        return {path: value * level}

    return change


def add(role: str) -> Change:
    """Add the level to the value of the role."""

    def change(scene: Scene, level: float) -> Overrides:
        path, value = _number(scene, role)
        return {path: value + level}

    return change


def set_to(role: str) -> Change:
    """Replace the value of the role by the level."""
    return lambda scene, level: {path_of(scene, role): level}


def set_present(role: str) -> Change:
    """Replace a value of an optional part of the rig by the level; the scene must have the part."""

    def change(scene: Scene, level: float) -> Overrides:
        path = path_of(scene, role)
        if held(scene, path) is None:
            raise DoesNotApply(f"scenes that give {path.rpartition('.')[0]}")
        return {path: level}

    return change


def declare(scene: Scene, path: str, value: Any) -> Overrides:
    """Declare a value at a path of the rig or of "medium"; a leading "rig." is left out.

    `declared` is one table whose keys are paths. The override replaces the whole table, including its earlier entries.
    """
    path = path.removeprefix("rig.")
    kept = {key: old for key, old in scene.declared.items() if not (key == path or key.startswith(path + "."))}
    return {"declared": {**kept, path: value}}
