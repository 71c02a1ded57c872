"""Load a scene from the library, a file or plain data. Files are data (TOML or JSON): no code is ever run from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from .errors import InputError, reason
from .measured import with_measured
from .overrides import apply_overrides
from .possible import check_possible
from .rigs import RIGS
from .scene import Scene
from .spec_files import LIBRARY, find_spec_file, read_spec_file
from .validate import validate_spec

__all__ = ["anchored_overrides", "list_scenes", "load_scene"]


def list_scenes() -> list[str]:
    """Names of the scenes in the library, sorted."""
    return sorted(path.stem for path in LIBRARY.glob("*.toml"))


def load_scene(source: str | Path | Mapping[str, Any] | Scene, overrides: Mapping[str, Any] | None = None) -> Scene:
    """Load and validate a scene.

    Main arguments:
        source: a name in the library, a path to a .toml or .json file, plain data, or a Scene.
        overrides: {path: value}, applied before validation.

    Meshes, grids, textures and measured curves that a scene file names lie in its folder or below, links followed, or are
    "library:NAME": a scene from elsewhere reads nothing else of this machine. Paths in `overrides` and in plain data are the
    user's own.

    Raises:
        InputError: unknown name, unreadable file, unknown key, missing or impossible value, impossible scene.
    Warns:
        MeasuredNote: what was done to a measured pulse or gate.
    """
    if isinstance(source, Scene):
        if not overrides:
            return source
        data, where = source.model_dump(mode="json"), source.name
    elif isinstance(source, Mapping):
        data, where = dict(source), "scene data"
    else:
        path = find_spec_file(str(source), LIBRARY, kind="scene", next_step="beambench scenes list")
        data, where = _anchor(read_spec_file(path), path.parent, overrides or {}), str(source)
    if overrides:
        data = apply_overrides(data, overrides)
    data = with_measured(data, where)
    scene = validate_spec(Scene, data, where, example=partial(_example, data))
    check_possible(scene)
    return scene


def _example(data: Mapping[str, Any]) -> str:
    """Next step of a wrong scene: where to see a complete one with the same kind of rig."""
    kind = _kind_of(data)
    same = (name for name in list_scenes() if _kind_of(read_spec_file(LIBRARY / f"{name}.toml")) == kind)
    first = next(same, "") if isinstance(kind, str) and kind in RIGS and kind != next(iter(RIGS)) else ""
    return f"beambench scenes show {first}   (a complete example)" if first else Scene.example


def _kind_of(data: Mapping[str, Any]) -> Any:
    """The kind of a scene's rig; a rig that gives none is of the first."""
    rig = data.get("rig")
    return rig.get("kind", next(iter(RIGS))) if isinstance(rig, Mapping) else None


def _anchor(data: dict[str, Any], folder: Path, overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Make the file names of shapes, textures and measured curves point beside the scene file (or into the library).

    Names that `overrides` replaces stay as they are.
    """

    def replaced(*places: str) -> bool:
        return any(f"{place}.".startswith(f"{path}.") for path in overrides for place in places)

    for part in ("rig", "declared"):
        if isinstance(data.get(part), dict):
            data[part] = _anchored(data[part], part, folder, replaced)
    objects = data.get("target")
    if isinstance(objects, list):
        for index, item in enumerate(objects):
            if not isinstance(item, dict):
                continue  # the validation tells
            for part in ("shape", "texture"):
                spec: Any = item.get(part)
                name = spec.get("file") if isinstance(spec, dict) else None
                where = f"target.{index}.{part}.file"
                named = f"target.{item.get('name')}.{part}.file"
                if isinstance(name, str) and not name.startswith("library:") and not replaced(where, named):
                    spec["file"] = _beside(name, folder, where)
    return data


def anchored_overrides(overrides: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Overrides that a file holds: every file that they name must lie in that file's folder, or is "library:NAME".

    Main arguments:
        overrides: {path: value}; a value may hold whole tables and lists. folder: of the file.

    Raises:
        InputError: a named file lies elsewhere.
    """
    return {path: _anchored(value, path, folder) for path, value in overrides.items()}


def _anchored(value: Any, where: str, folder: Path, replaced: Callable[[str], bool] = lambda _: False) -> Any:
    """The value, in which every "file" is a path in the folder, or "library:NAME"; those that are replaced stay."""
    if isinstance(value, dict):
        return {key: _anchored(item, f"{where}.{key}", folder, replaced) for key, item in value.items()}
    if isinstance(value, list):
        return [_anchored(item, f"{where}.{index}", folder, replaced) for index, item in enumerate(value)]
    named = isinstance(value, str) and where.split(".")[-1] == "file" and not replaced(where)
    return _beside(value, folder, where) if named and not value.startswith("library:") else value


def _beside(name: str, folder: Path, where: str) -> str:
    """The path of a file that must lie in the scene file's folder, links followed. Raises InputError where it does not."""
    try:
        path = (folder / Path(name).expanduser()).resolve()
    except (OSError, RuntimeError, ValueError) as error:  # links in a circle, no such home, a null byte
        raise InputError(
            "This cannot be the name of a file.", where=where, value=name, allowed=reason(error)
        ) from error
    if not path.is_relative_to(folder.resolve()):
        raise InputError(
            "A mesh, grid, texture or measured curve of a scene file should lie in its folder.", where=where, value=name,
            allowed="a name inside the scene file's folder, or library:NAME",
            next_step=f"copy the file there, or name it on the command line: --set {where}=PATH",
        )  # fmt: skip
    return str(path)
