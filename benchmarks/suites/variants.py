"""Variants: a suite defines a scene once, under a name, and varies it in its list of scenes.

    [variants.wall]                         # a scene of the library, a file or another variant, with changes
    scene = "harbour-wall"
    overrides = { "rig.camera.rows" = 24, "rig.camera.cols" = 24 }

    [variants.clear]                        # changes only, for any scene
    overrides = { "medium.water_type.type" = "clear" }

    [[scenes]]
    scene = "wall"
    with = ["clear"]
    name = "wall-in-clear-water"

Overrides apply in this order: those of the scene, those under `with` in their order, those of the entry. An entry without a
`name` has the name of its variant. Variants are only a notation: the suite that is run, recorded and hashed names scenes of
the library or files, with all their overrides.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from ...scenes.base import Spec
from ...scenes.errors import InputError
from ...scenes.validate import validate_spec

__all__ = ["Variant", "without_variants"]

Word = Annotated[str, Field(min_length=1)]


class Variant(Spec):
    """A named variant: a scene if it has `scene`; otherwise changes that other entries list under `with`."""

    scene: Word | None = None
    changes: Annotated[tuple[Word, ...], Field(alias="with")] = ()
    overrides: dict[str, Any] = Field(default_factory=dict)


class _Variants(Spec):
    variants: dict[Word, Variant]


def without_variants(data: Mapping[str, Any], where: str) -> dict[str, Any]:
    """A suite's data in which every scene is written out: no `variants`, no `with`.

    Main arguments:
        data: data of the suite; `scenes` may hold plain strings. where: the suite, for messages.

    Entries of another form are returned unchanged, and validation refuses them.

    Raises:
        InputError: a variant has another form or builds on itself, or a name under `with` is unknown.
    """
    result = dict(data)
    variants = validate_spec(_Variants, {"variants": result.pop("variants", {})}, where).variants
    for name in variants:
        _resolved(variants[name], variants, f"{where}: variants.{name}", (name,))
    scenes = result.get("scenes")
    if isinstance(scenes, list):
        result["scenes"] = [_entry(item, variants, f"{where}: scenes.{number}") for number, item in enumerate(scenes)]
    return result


def _entry(item: Any, variants: Mapping[str, Variant], where: str) -> Any:
    """An entry of the suite's scenes, written out."""
    entry = {"scene": item} if isinstance(item, str) else item
    if not isinstance(entry, dict) or not isinstance(entry.get("scene"), str):
        return entry
    parts = {key: entry[key] for key in ("scene", "with", "overrides") if key in entry}
    if "with" not in parts and parts["scene"] not in variants:
        return entry
    scene, overrides = _resolved(validate_spec(Variant, parts, where), variants, where, ())
    named = {"name": parts["scene"]} if parts["scene"] in variants else {}
    rest = named | {key: value for key, value in entry.items() if key not in parts}
    return {"scene": scene, **rest, **({"overrides": overrides} if overrides else {})}


def _resolved(
    variant: Variant, variants: Mapping[str, Variant], where: str, within: tuple[str, ...]
) -> tuple[str | None, dict[str, Any]]:
    """(scene that is not a variant, all overrides in their order)."""
    scene: str | None = variant.scene
    overrides: dict[str, Any] = {}
    if scene is not None and scene in variants:
        scene, overrides = _named(scene, variants, where, within)
        if scene is None:
            raise InputError(
                "A variant without a scene is used as a scene.", where=f"{where}.scene", value=variant.scene,
                allowed="a scene of the library, a file, or a variant that has a scene",
                next_step=f'{{ scene = "flat-wall", with = ["{variant.scene}"] }}, for example',
            )  # fmt: skip
    for name in variant.changes:
        if name not in variants or variants[name].scene is not None:
            raise InputError(
                "A name under `with` must be that of a variant without a scene.",
                where=f"{where}.with",
                value=name,
                allowed=", ".join(name for name, one in variants.items() if one.scene is None)
                or "no such variant exists",
                next_step=f"[variants.{name}] with overrides and no scene",
            )
        overrides = _over(overrides, _named(name, variants, where, within)[1])
    return scene, _over(overrides, variant.overrides)


def _named(
    name: str, variants: Mapping[str, Variant], where: str, within: tuple[str, ...]
) -> tuple[str | None, dict[str, Any]]:
    if name in within:
        raise InputError(
            "A variant builds on itself.", where=where, value=" -> ".join([*within, name]),
            next_step="build it on a scene of the library; a variant should not bear the name of one",
        )  # fmt: skip
    return _resolved(variants[name], variants, where, (*within, name))


def _over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Overrides followed by others; a path that occurs again moves to the end."""
    return {path: value for path, value in below.items() if path not in above} | dict(above)
