"""What a scene declares of its rig and medium, as specs."""

from __future__ import annotations

from typing import Any, TypeVar

from ..base import Spec
from ..errors import InputError
from ..medium import Medium
from ..overrides import apply_overrides
from ..validate import validate_spec
from .kind import RigScene

__all__ = ["as_declared"]

SpecT = TypeVar("SpecT", bound=Spec)


def as_declared(scene: RigScene, kind: type[SpecT]) -> tuple[SpecT, Medium]:
    """Rig (a spec of class `kind`) and medium with `scene.declared` applied. Raises InputError as `declared_rig`."""
    data = scene.rig.model_dump(mode="json") | {"medium": scene.medium.model_dump(mode="json")}
    where = f"{scene.name}: declared"
    for path, value in scene.declared.items():
        data = _applied(data, path, value, where)
    medium = validate_spec(Medium, data.pop("medium"), where)
    return validate_spec(kind, data, where), medium


def _applied(data: dict[str, Any], path: str, value: Any, where: str) -> dict[str, Any]:
    """The data with one declared value. Raises InputError that names the table and how its paths begin."""
    try:
        changed = apply_overrides(data, {path: value})
        table: Any = changed
        *folders, last = path.split(".")
        for key in folders:
            table = table[key] if isinstance(table, dict) else None
        if isinstance(table, dict) and last != "preset":
            table.pop("preset", None)  # its values stand in the table, and one of them is another now
        return changed
    except InputError as error:
        near = error.next_step if error.next_step.startswith("did you mean") else ""
        start = f'write "{path.removeprefix("rig.")}"' if path.startswith("rig.") else near
        raise InputError(
            "A declared path leads nowhere.", where=f"{where}: {path}", value=value,
            allowed=f"a path that begins within the rig, or with medium: {', '.join(sorted(data))}",
            next_step=start or 'for example: "t0_s" = 1e-9, "laser.pulse.fwhm_s" = 1.1e-9',
        ) from error  # fmt: skip
