"""Changes of which stress axes are made: a scene and a level give overrides, {path: value}.

A change on a role asks the scene's kind of rig what the role is (`scenes.rigs.roles`); none names a kind of rig. A change
raises `DoesNotApply` where the scene has nothing to change; the axis turns it into an error that names itself.
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
    """What the scene's kind of rig says of a role."""
    roles = rig_kind(scene.modality).roles
    if role not in roles:
        fitting = [name for name in RIGS if role in rig_kind(name).roles]
        raise DoesNotApply(f"scenes with a rig of kind {', '.join(fitting)}")
    return roles[role]


def path_of(scene: Scene, role: str) -> str:
    """The path of a role that is one value of the scene. Raises DoesNotApply where the kind of rig has no such role."""
    path = _role(scene, role)
    assert isinstance(path, str), role
    return path


def steps_of(scene: Scene, role: str) -> Steps:
    """The paths of a role that is even samples in time. Raises DoesNotApply where the kind of rig has no such role."""
    steps = _role(scene, role)
    assert isinstance(steps, Steps), role
    return steps


def held(scene: Scene, path: str) -> Any:
    """The scene's value at a path, None where it has none."""
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
    """The objects of the target. Raises DoesNotApply where there are none."""
    if not scene.target:
        raise DoesNotApply("scenes with an object in the target")
    return scene.target


def multiply(role: str) -> Change:
    """The role's value times the level."""

    def change(scene: Scene, level: float) -> Overrides:
        path, value = _number(scene, role)
        return {path: value * level}

    return change


def add(role: str) -> Change:
    """The role's value plus the level."""

    def change(scene: Scene, level: float) -> Overrides:
        path, value = _number(scene, role)
        return {path: value + level}

    return change


def set_to(role: str) -> Change:
    """The level in the place of the role's value."""
    return lambda scene, level: {path_of(scene, role): level}


def set_present(role: str) -> Change:
    """The level in the place of a value that belongs to an option of the rig, which the scene must have."""

    def change(scene: Scene, level: float) -> Overrides:
        path = path_of(scene, role)
        if held(scene, path) is None:
            raise DoesNotApply(f"scenes that give {path.rpartition('.')[0]}")
        return {path: level}

    return change


def declare(scene: Scene, path: str, value: Any) -> Overrides:
    """The value declared at a path of the rig or of "medium"; a leading "rig." is left out.

    `declared` is one table whose keys are paths: it is replaced as a whole, with what it held before.
    """
    path = path.removeprefix("rig.")
    kept = {key: old for key, old in scene.declared.items() if not (key == path or key.startswith(path + "."))}
    return {"declared": {**kept, path: value}}
