"""How far a data set is: its groups, shards and parts, from its receipts, without reading a capture."""

from __future__ import annotations

import math
import os
from collections import Counter
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError
from .shard_finish import read_request
from .shard_manifest import load_sharded
from .shard_receipts import list_receipts, read_either

__all__ = ["sharded_contents"]


def sharded_contents(root: Path) -> dict[str, Any]:
    """State, numbers of captures, groups and parts of a store of many captures, finished or not.

    Raises:
        InputError: its manifest, its request or a receipt is damaged.
    """
    finished = not root.name.endswith(".partial")
    manifest = load_sharded(root) if finished else None
    request = read_request(root)
    parts: Counter[str] = Counter()
    captures: Counter[str] = Counter()
    shards: Counter[str] = Counter()
    known: dict[str, dict[str, Any]] = {}
    try:
        places = list_receipts(root)
    except OSError as error:
        raise InputError(f"The receipts cannot be read: {error.strerror}.", where=str(root)) from error
    for place in places:
        receipt = read_either(root, *place)
        captures[receipt.group] += len(receipt.captures)
        shards[receipt.group] += 1
        known.setdefault(receipt.group, {"structure": receipt.structure, "length": receipt.length})
        parts.update(str(held.facts.get("part", "")) for held in receipt.captures)
    asked = int(request.get("count", 0))
    groups = [
        {
            "group": name, "captures": captures[name], "shards": shards[name],
            "shards_asked": math.ceil(asked / one["length"]) if len(request.get("groups", known)) == 1 else 0,
            "captures_per_shard": one["length"], "sizes": _sizes(one["structure"]),
        }
        for name, one in known.items()
    ]  # fmt: skip
    return {
        "path": str(root), "dataset": request.get("name", ""), "finished": finished, "count": sum(captures.values()),
        "asked": asked, "groups": groups, "parts": dict(sorted(parts.items())),
        "content": manifest.content if manifest is not None else "",
        "bytes": sum(os.lstat(Path(place) / name).st_size for place, _, names in os.walk(root) for name in names),
    }  # fmt: skip


def _sizes(structure: dict[str, dict[str, Any]]) -> dict[str, int]:
    return {dim: n for entry in structure.values() for dim, n in zip(entry["dims"], entry["shape"], strict=True)}
