"""What a scene declares of its rig and medium, as specs."""

from __future__ import annotations

from typing import TypeVar

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
    where = f"{scene.name}: declared"
    medium = validate_spec(Medium, data.pop("medium"), where)
    return validate_spec(kind, data, where), medium
