"""Summary of a store: sizes, and how each capture was made."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..scenes.json_keys import read_json
from .store.faces import open_captures, sharded_place
from .store.shard_status import sharded_contents

__all__ = ["contents"]


def contents(path: Path) -> dict[str, Any]:
    """Modality, number of captures, sizes and bytes of a store, and scene, seed, kind of truth and rung of each capture; of a data
    set, finished or not, its groups and shards instead of single captures (`store.shard_status`).

    Raises:
        InputError: the path is not a store with intact metadata.
    """
    unfinished = path.with_name(path.name + ".partial")
    place = sharded_place(unfinished if not path.exists() else path)
    if place is not None:
        return sharded_contents(place[0])
    captures = open_captures(path)
    rows = [_row(index, captures.attributes(index)) for index in range(len(captures))]
    return {
        "path": str(path),
        "modality": captures.modality,
        "count": len(rows),
        "sizes": {str(name): int(size) for name, size in captures.load(0).sizes.items()} if rows else {},
        "bytes": sum(file.stat().st_size for file in path.rglob("*") if file.is_file()),
        "captures": rows,
    }


def _row(index: int, attrs: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "capture": index,
        "scene": _record(attrs, "truth_scene").get("name", ""),
        "seed": attrs.get("seed"),
        "truth": attrs.get("truth_kind", ""),
        "fidelity": _record(attrs, "fidelity").get("rung", ""),
    }


def _record(attrs: Mapping[str, Any], name: str) -> dict[str, Any]:
    """The object in an attribute of JSON text; {} if it is absent, null, or no such text."""
    text = attrs.get(name)
    try:
        found = read_json(text) if isinstance(text, str) else {}
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}
