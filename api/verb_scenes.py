"""`beambench scenes list` and `beambench scenes show`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .scenes.scene import Scene

__all__ = ["scenes_list", "scenes_show"]


def scenes_list() -> list[dict[str, Any]]:
    """The scenes of the library: name, title, modality, image size and number of slices."""
    from .scenes.load import list_scenes, load_scene
    from .scenes.scene import sizes_of

    listed = []
    for name in list_scenes():
        scene = load_scene(name)
        slices, rows, cols = sizes_of(scene)
        listed.append(
            {
                "name": name,
                "title": scene.title,
                "modality": scene.modality,
                "rows": rows,
                "cols": cols,
                "slices": slices,
                "objects": len(scene.target),
                "medium": scene.medium.name,
            }
        )
    return listed


def scenes_show(scene: str | Path | Mapping[str, Any] | Scene, *, overrides: Mapping[str, Any] | None = None) -> Scene:
    """The scene as validated, with every value that `overrides` can set.

    Main arguments:
        scene: a name in the library, a path to a .toml or .json file, plain data, or a Scene.
        overrides: {path: value}, applied before validation.

    Raises:
        InputError: no such scene, an unknown key, a missing or impossible value.
    """
    from .scenes.load import load_scene

    return load_scene(scene, overrides)
