"""The files that a scene needs: meshes, grids and textures. A capture records their names and sha256, not their folders.

Therefore a capture reveals nothing about the machine, is the same wherever it is made, and shows when a file has changed.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..scenes.errors import InputError
from .store.manifest import sha256_file

__all__ = ["bare_scene", "find_sources", "source_files"]

_LIBRARY = "library:"


def source_files(scene: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Of each file that a scene names: `path` of its key in the scene, bare `name`, `bytes` and `sha256` in hex. Files that hold
    the numbers of a mesh file follow it, with their own name after that of the key.

    Main arguments:
        scene: the scene as plain data, with names that lead to the files.

    Raises InputError if a file is missing or cannot be read.
    """
    found = []
    for key, _, spec in _named(scene):
        size, digest = _fingerprint(spec["file"], key)
        found.append({"path": key, "name": _bare(spec["file"]), "bytes": size, "sha256": digest})
        for name, path in _beside(spec["file"], key):
            size, digest = _fingerprint(str(path), key)
            found.append({"path": f"{key}/{name}", "name": name, "bytes": size, "sha256": digest})
    return found


def bare_scene(scene: Mapping[str, Any]) -> dict[str, Any]:
    """`scene` with the bare names of its files; equal to `scene` if it names no files, or only files of the library."""
    bare = copy.deepcopy(dict(scene))
    for _, _, spec in _named(bare):
        spec["file"] = _bare(spec["file"])
    return bare


def find_sources(
    scene: Mapping[str, Any],
    files: Sequence[Mapping[str, Any]],
    places: Sequence[Path],
    given: Mapping[str, Any],
    where: str,
) -> dict[str, Any]:
    """The scene of a capture, with names that lead to its files again.

    Main arguments:
        scene: the scene as the capture records it.
        files: the result of `source_files` when the capture was made; empty in older captures, whose files are not checked.
        places: folders to search.
    Other arguments:
        given: {key: path} of files in other places, e.g. {"target.0.shape.file": "/data/a.ply"}.
        where: the capture, for messages.

    Raises:
        InputError: a file is missing or has another sha256, or `given` names a key that is no file of the scene.
    """
    kept = {str(entry["path"]): entry for entry in files}
    found = copy.deepcopy(dict(scene))
    asked = dict(given)
    for key, alias, spec in _named(found):
        own = asked.pop(alias, None)
        own = asked.pop(key, own)
        name = str(spec["file"])
        if own is not None:
            candidates = [str(own)]
        elif name.startswith(_LIBRARY):
            candidates = [name]
        else:
            candidates = [name] * Path(name).is_absolute() + [str(place / Path(name).name) for place in places]
        there = [item for item in candidates if item.startswith(_LIBRARY) or Path(item).expanduser().is_file()]
        if not there:
            raise InputError(
                "A file of the capture's scene is missing.", where=f"{where}: {key}", value=candidates[0],
                allowed=_described(kept.get(key)),
                next_step=f"put it beside the store, or state its path: --set {key}=PATH",
            )  # fmt: skip
        spec["file"] = _matching(there, kept.get(key), f"{where}: {key}")
        for beside, path in _beside(spec["file"], key):
            if (then := kept.get(f"{key}/{beside}")) is not None:
                _matching([str(path)], then, f"{where}: {key}")
    if asked:
        raise InputError(
            "The option --like repeats a store from its own records, which cannot be changed.", where="--set",
            value=", ".join(asked), allowed="the path of a file of its scene, e.g. target.0.shape.file=PATH",
        )  # fmt: skip
    return found


def _matching(there: Sequence[str], then: Mapping[str, Any] | None, where: str) -> str:
    for item in there:
        if then is None or _fingerprint(item, where)[1] == then["sha256"]:
            return item
    size, digest = _fingerprint(there[0], where)
    raise InputError(
        "A file of the scene differs from the one that the capture was made from.",
        where=f"{where}: {_bare(there[0])}",
        value=f"sha256 {digest[:16]}…, {size} bytes",
        allowed=_described(then),
        next_step="restore the file, or generate anew from the scene as it is now",
    )


def _described(entry: Mapping[str, Any] | None) -> str:
    return "" if entry is None else f"sha256 {entry['sha256'][:16]}…, {entry['bytes']} bytes"


def _fingerprint(file: str, where: str) -> tuple[int, str]:
    from ..scenes.meshes import resolve_file

    path = resolve_file(file, where)
    try:
        return path.stat().st_size, sha256_file(path)
    except OSError as error:
        raise InputError(f"A file of the scene cannot be read: {error.strerror}.", where=where, value=file) from error


def _named(scene: Mapping[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """(key, key by the target's name, spec) of every spec that names a file."""
    targets = scene.get("target")
    for index, item in enumerate(targets if isinstance(targets, list) else []):
        for part in ("shape", "texture"):
            spec = item.get(part) if isinstance(item, dict) else None
            if isinstance(spec, dict) and isinstance(spec.get("file"), str):
                yield f"target.{index}.{part}.file", f"target.{item.get('name')}.{part}.file", spec


def _beside(file: str, where: str) -> list[tuple[str, Path]]:
    """(name, path) of the files that hold the numbers of a mesh file, such as the .bin of a .gltf."""
    from ..scenes.meshes import resolve_file
    from ..scenes.readers.mesh_file import side_files

    path = resolve_file(file, where)
    folder = path.resolve().parent
    return [(side.relative_to(folder).as_posix(), side) for side in side_files(path)]


def _bare(file: str) -> str:
    return file if file.startswith(_LIBRARY) else Path(file).name
