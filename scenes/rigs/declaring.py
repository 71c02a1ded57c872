"""What a scene declares of its rig and medium, as specs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from ..base import Spec
from ..medium import Medium
from ..overrides import apply_overrides
from ..validate import validate_spec
from .kind import RigScene

__all__ = ["as_declared"]

SpecT = TypeVar("SpecT", bound=Spec)


def as_declared(scene: RigScene, kind: type[SpecT]) -> tuple[SpecT, Medium]:
    """Rig (a spec of class `kind`) and medium with `scene.declared` applied. Raises InputError as `declared_rig`."""
    data = scene.rig.model_dump(mode="json") | {"medium": scene.medium.model_dump(mode="json")}
    if scene.declared:
        data = apply_overrides(data, scene.declared)
        _leave_presets(data, scene.declared)
    where = f"{scene.name}: declared"
    medium = validate_spec(Medium, data.pop("medium"), where)
    return validate_spec(kind, data, where), medium


def _leave_presets(data: dict[str, Any], declared: Mapping[str, Any]) -> None:
    """A table of a preset holds the preset's values; where one of them is declared otherwise, it is no longer that preset."""
    for path in declared:
        node: Any = data
        *folders, last = path.split(".")
        for key in folders:
            node = node.get(key) if isinstance(node, dict) else None
        if isinstance(node, dict) and node.get("preset") is not None and last != "preset":
            node["preset"] = None
