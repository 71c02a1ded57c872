"""Stress axes: change a scene, given the name of an axis and a level.

An axis is a named one (`stress_axes`), or any path of the scene to a number (`rig.detector.read_noise_e`). Every named axis
changes the scene by plain overrides, so that a scene that breaks an estimator can be written down and repeated with `--set`.
A level of 1 on an axis that multiplies, and of 0 on one that adds, leaves the scene unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ...scenes.errors import InputError
from ...scenes.load import load_scene
from ...scenes.nearest import did_you_mean
from ...scenes.overrides import apply_overrides
from ...scenes.scene import Scene
from .changes import Overrides
from .stress_axes import AXES, Axis

__all__ = ["AXES", "Axis", "axis_overrides", "axis_unit", "list_axes", "stressed", "takes_whole_numbers"]

#: Units by the ending of a path's last name; the longest matching ending counts.
_UNITS = {
    "_e_per_s": "e/s", "_per_m": "1/m", "_dn_per_e": "DN/e", "_s": "s", "_m": "m", "_deg": "deg", "_rad": "rad",
    "_j": "J", "_w": "W", "_hz": "Hz", "_e": "e", "_dn": "DN", "_px": "px", "_c": "degC", "_psu": "psu", "_pa": "Pa",
    "_bits": "bit",
}  # fmt: skip


def list_axes() -> list[Axis]:
    """The named axes, by name."""
    return [AXES[name] for name in sorted(AXES)]


def axis_unit(axis: str) -> str:
    """The unit of the levels of an axis; "1" for ratios and counts."""
    if axis in AXES:
        return AXES[axis].unit
    last = axis.rpartition(".")[2]
    fits = [end for end in _UNITS if last.endswith(end)]
    return _UNITS[max(fits, key=len)] if fits else "1"


def axis_overrides(scene: Scene, axis: str, level: float) -> Overrides:
    """The changes of the scene at a level of an axis: {path: value}.

    Raises:
        InputError: the axis is neither a named one nor a path to a number, or it does not apply to the scene.
    """
    if axis in AXES:
        return AXES[axis].overrides(scene, level)
    if "." not in axis:
        raise InputError(
            "There is no such stress.",
            where="axis",
            value=axis,
            allowed="a path such as rig.detector.read_noise_e, or one of: " + ", ".join(sorted(AXES)),
            next_step=did_you_mean(axis, sorted(AXES)),
        )
    held = _held(scene, axis)
    if isinstance(held, bool) or not isinstance(held, int | float | type(None)):
        raise InputError("The path of a stress must lead to a number.", where=axis, value=held)
    # Whole numbers remain integers: a path such as `pulses_per_slice` accepts no fractions.
    return {axis: int(level) if isinstance(held, int) and float(level).is_integer() else level}


def takes_whole_numbers(scene: Scene, axis: str) -> bool:
    """Whether an axis is the path of a whole number of the scene, which is not halved to a fraction."""
    held = None if axis in AXES else _held(scene, axis)
    return isinstance(held, int) and not isinstance(held, bool)


def _held(scene: Scene, path: str) -> Any:
    """The value at a path; None if its last key is new (validation then decides whether it is allowed)."""
    data = scene.model_dump(mode="json")
    head, _, last = path.rpartition(".")
    apply_overrides(data, {path: None})  # raises InputError with similar paths if this one does not exist
    node: Any = data
    for part in filter(None, head.split(".")):
        node = _item(node, part) if isinstance(node, list) else node[part]
    return _item(node, last) if isinstance(node, list) else node.get(last)


def _item(items: list[Any], key: str) -> Any:
    """An item of a list by its index or its name, as in overrides."""
    if key.lstrip("-").isdigit():
        return items[int(key)]
    return next(item for item in items if isinstance(item, dict) and item.get("name") == key)


def stressed(scene: Scene, levels: Sequence[tuple[str, float]]) -> tuple[Scene, Overrides]:
    """The scene under several axes, applied in order, and all changes as one set of overrides.

    Raises:
        InputError: an axis is unknown or does not apply, or the scene does not allow a level.
    """
    total: Overrides = {}
    for axis, level in levels:
        changes = axis_overrides(scene, axis, level)
        try:
            scene = load_scene(scene, changes)
        except InputError as error:
            raise InputError(
                f"The stress {axis!r} at {level:g} does not fit the scene {scene.name!r}: {error.what}",
                where=error.where,
                value=error.value,
                allowed=error.allowed,
                next_step=error.next_step,
            ) from error
        total.update(changes)
    return scene, total
