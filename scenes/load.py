"""Load a scene from the library, a file or plain data. Files are data (TOML or JSON): no code is ever run from them."""

from __future__ import annotations

import difflib
import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from .base import Spec
from .errors import InputError
from .overrides import apply_overrides
from .scene import RIG_KINDS, Scene

__all__ = ["LIBRARY", "find_spec_file", "list_scenes", "load_scene", "read_spec_file", "validate_spec"]

#: Folder of the scenes that ship with the project.
LIBRARY = Path(__file__).parent / "library"

SpecT = TypeVar("SpecT", bound=BaseModel)

_MAX_BYTES = 64 * 2**20


def list_scenes() -> list[str]:
    """Names of the scenes in the library, sorted."""
    return sorted(path.stem for path in LIBRARY.glob("*.toml"))


def load_scene(source: str | Path | Mapping[str, Any] | Scene, overrides: Mapping[str, Any] | None = None) -> Scene:
    """Load and validate a scene.

    Main arguments:
        source: a name in the library, a path to a .toml or .json file, plain data, or a Scene.
        overrides: {path: value}, applied before validation.

    Meshes, grids and textures that a scene file names lie in its folder or below, links followed, or are "library:NAME": a
    scene from elsewhere reads nothing else of this machine. Paths in `overrides` and in plain data are the user's own.

    Raises:
        InputError: unknown name, unreadable file, unknown key, missing or impossible value, impossible scene.
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
    from .possible import check_possible

    scene = validate_spec(Scene, data, where)
    check_possible(scene)
    return scene


def find_spec_file(source: str, folder: Path, *, kind: str, next_step: str) -> Path:
    """The file of a spec: one that ships in `folder`, by its name, or any .toml or .json file, by its path.

    Main arguments:
        source: name or path. folder: where those that ship lie. kind: what it is ("scene"), for the message.
    Other arguments:
        next_step: told where no name is near.

    Raises:
        InputError: neither; names all that ship, and those that are near.
    """
    inside = folder / f"{source}.toml"
    if "/" not in source and inside.is_file():
        return inside
    path = Path(source).expanduser()
    if path.suffix in {".toml", ".json"} and path.is_file():
        return path
    names = sorted(path.stem for path in folder.glob("*.toml"))
    near = difflib.get_close_matches(source, names, n=3, cutoff=0.4)
    raise InputError(
        f"There is no such {kind}.",
        where=kind,
        value=source,
        allowed="a path to a .toml or .json file, or one of: " + ", ".join(names),
        next_step=f"did you mean {' or '.join(near)}?" if near else next_step,
    )


def read_spec_file(path: Path) -> dict[str, Any]:
    """Read a TOML or JSON file into plain data.

    Raises:
        InputError: unreadable, too large, or not well formed.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError("The file is too large for a spec.", where=str(path), value=path.stat().st_size)
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("The file cannot be read.", where=str(path), value=str(error)) from error
    try:
        data = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except (json.JSONDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError("The file is not well formed.", where=str(path), value=str(error)) from error
    if not isinstance(data, dict):
        raise InputError("A spec is a table of keys.", where=str(path), value=type(data).__name__)
    return data


def _anchor(data: dict[str, Any], folder: Path, overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Make the file names of shapes and textures point beside the scene file (or into the library).

    Names that `overrides` replaces are left: the user's own take their place.
    """
    objects = data.get("target")
    if isinstance(objects, list):
        for index, item in enumerate(objects):
            for part in ("shape", "texture"):
                spec: Any = item.get(part) if isinstance(item, dict) else None
                name = spec.get("file") if isinstance(spec, dict) else None
                where = f"target.{index}.{part}.file"
                named = f"target.{item.get('name')}.{part}.file"
                replaced = any(f"{key}.".startswith(f"{path}.") for path in overrides for key in (where, named))
                if isinstance(name, str) and not name.startswith("library:") and not replaced:
                    spec["file"] = _beside(name, folder, where)
    return data


def _beside(name: str, folder: Path, where: str) -> str:
    """The path of a file that must lie in the scene file's folder, links followed. Raises InputError where it does not."""
    try:
        path = (folder / Path(name).expanduser()).resolve()
    except (OSError, RuntimeError, ValueError) as error:  # links in a circle, no such home, a null byte
        raise InputError("This is no name of a file.", where=where, value=name, allowed=str(error)) from error
    if not path.is_relative_to(folder.resolve()):
        raise InputError(
            "A scene's mesh, grid or texture lies beside its scene file.", where=where, value=name,
            allowed="a name inside the scene file's folder, or library:NAME",
            next_step=f"copy the file there, or name it yourself: --set {where}=PATH",
        )  # fmt: skip
    return str(path)


def validate_spec(model: type[SpecT], data: Mapping[str, Any], where: str) -> SpecT:
    """Validate plain data against a spec, turning pydantic's errors into one `InputError` that names every path.

    Validation is strict: "5" is not a number and true is not 1.
    """
    try:
        text = json.dumps(data, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(
            "A spec holds only finite numbers, strings, lists and tables.", where=where, value=str(error)
        ) from error
    try:
        return model.model_validate_json(text, strict=True)
    except ValidationError as error:
        first, *rest = error.errors(include_url=False)
        path = _key_path(first["loc"])
        what = {"missing": "A value is missing, and has no default.", "extra_forbidden": "Unknown key."}
        more = "".join(
            f"\n           also {_key_path(e['loc'])}: {_message(e)}" for e in rest[:8]
        )  # one message for all, so that a user mends a file in one go
        raise InputError(
            what.get(first["type"], "A value is not allowed."),
            where=f"{where}: {path}",
            value=None if first["type"] == "missing" else first.get("input"),
            allowed=_message(first) + more + _near_keys(model, first),
            next_step=model.example if issubclass(model, Spec) else "",
        ) from error


def _message(error: Any) -> str:
    """What pydantic says of a value, its limit in few digits: 1e-15 has too many zeros to be counted."""
    for key in ("ge", "gt", "le", "lt"):
        limit = error.get("ctx", {}).get(key)
        if isinstance(limit, float):
            return f"{str(error['msg']).rpartition(' ')[0]} {limit:g}"
    return str(error["msg"])


def _key_path(loc: tuple[int | str, ...]) -> str:
    """The path of an error as a user would override it: without the kind of rig that pydantic puts in."""
    parts = [str(part) for i, part in enumerate(loc) if not (i == 1 and loc[0] == "rig" and part in RIG_KINDS)]
    return ".".join(parts) or "(whole)"


def _near_keys(model: type[BaseModel], error: Any) -> str:
    """For an unknown key: the keys of the same name-like elsewhere in the spec."""
    if error["type"] != "extra_forbidden":
        return ""
    known: set[str] = set()
    todo: list[Any] = [model.model_json_schema()]
    while todo:
        node = todo.pop()
        if isinstance(node, dict):
            known.update(node.get("properties", {}))
            todo.extend(node.values())
        elif isinstance(node, list):
            todo.extend(node)
    near = difflib.get_close_matches(str(error["loc"][-1]), sorted(known), n=3)
    return f"; did you mean {' or '.join(near)}?" if near else ""
