"""What a scene is, as a hash: equal for scenes that differ in names, in the way a number is written, or in where files lie."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from ..errors import InputError
from ..procedural.build import recipe_versions

__all__ = ["at_path", "scene_content"]


def scene_content(scene: Mapping[str, Any], paths: Sequence[str]) -> str:
    """sha256 of the values at `paths` of a scene (plain data), without names; files by their content.

    Raises:
        InputError: a path that leads nowhere, or a file that cannot be read.
    """
    found = {path: _plain(at_path(scene, path)) for path in paths}
    return hashlib.sha256(json.dumps(found, sort_keys=True).encode()).hexdigest()


def at_path(scene: Mapping[str, Any], path: str) -> Any:
    """The value at a path of a scene (plain data). Raises InputError where it leads nowhere."""
    node: Any = scene
    for key in path.split("."):
        if isinstance(node, Mapping) and key in node:
            node = node[key]
        elif isinstance(node, list | tuple) and key.isdigit() and int(key) < len(node):
            node = node[int(key)]
        elif isinstance(node, list | tuple) and (
            named := [n for n in node if isinstance(n, Mapping) and n.get("name") == key]
        ):
            node = named[0]
        else:
            raise InputError("A split is by a value that a scene does not have.", where="split.by", value=path)
    return node


def _plain(node: Any) -> Any:
    if isinstance(node, Mapping):
        kept = {key: _plain(value) for key, value in node.items() if key not in ("name", "title")}
        if (version := recipe_versions().get(str(node.get("kind")))) is not None:
            kept["recipe_version"] = version  # equal parameters gave other triangles before
        if isinstance(node.get("file"), str):
            kept["file"] = _file_sum(node["file"])
        return kept
    if isinstance(node, list | tuple):
        return [_plain(value) for value in node]
    if isinstance(node, int | float) and not isinstance(node, bool):
        return float(node)
    return node


@lru_cache(maxsize=4096)
def _file_sum(name: str) -> str:
    from ..meshes import resolve_file

    path = resolve_file(name, "target")
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"A file of the scene cannot be read: {error.strerror}.", where=str(name)) from error
