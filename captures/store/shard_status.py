"""How far a data set is: its groups, shards and parts, from its receipts, without reading a capture."""

from __future__ import annotations

import math
import os
from collections import Counter
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError
from .manifest import check_metadata_files, in_a_link, regular_size
from .shard_chunks import shard_key
from .shard_finish import read_request
from .shard_manifest import ShardedManifest, load_sharded
from .shard_receipts import list_receipts, read_either, receipt_name

__all__ = ["sharded_contents"]


def sharded_contents(root: Path) -> dict[str, Any]:
    """State, numbers of captures, groups and parts of a store of many captures, finished or not.

    `state` is "unfinished", "complete", "incomplete" (sound, but some captures that were asked for are not there) or "damaged";
    `damaged` lists shards without a sound receipt or whole files, and files of metadata with another content, `dropped` captures
    that a repair had to drop, by their number in the data set, and `missing` is the number of all captures that are not there.

    Raises:
        InputError: its manifest, or its request and the copy of it, is damaged.
    """
    finished = not root.name.endswith(".partial")
    manifest = load_sharded(root) if finished else None
    request = read_request(root)
    known = _Known()
    places = {*_listed(root), *(manifest.shards if manifest is not None else ())}
    for place in sorted(places):
        known.add(root, place, manifest)
    if manifest is not None:
        known.damaged += [name for name, _ in check_metadata_files(root, manifest.metadata)]
    asked = int(request.get("count", 0))
    count = sum(known.captures.values())
    state = "complete" if asked <= count and not known.damaged else "damaged" if known.damaged else "incomplete"
    one_group = len(request.get("groups", known.layouts)) == 1
    groups = [
        {
            "group": name, "captures": known.captures[name], "shards": known.shards[name],
            "shards_asked": math.ceil(asked / one["length"]) if one_group else 0,
            "captures_per_shard": one["length"], "sizes": _sizes(one["structure"]),
        }
        for name, one in known.layouts.items()
    ]  # fmt: skip
    return {
        "path": str(root), "dataset": request.get("name", ""), "finished": finished,
        "state": state if finished or known.damaged else "unfinished", "count": count, "asked": asked,
        "missing": max(0, asked - count), "damaged": known.damaged, "dropped": sorted(known.dropped), "groups": groups,
        "parts": dict(sorted(known.parts.items())), "content": manifest.content if manifest is not None else "",
        "bytes": sum(os.lstat(Path(place) / name).st_size for place, _, names in os.walk(root) for name in names),
    }  # fmt: skip


def _listed(root: Path) -> list[tuple[str, int]]:
    try:
        return list_receipts(root)
    except OSError as error:
        raise InputError(f"The receipts cannot be read: {error.strerror}.", where=str(root)) from error


class _Known:
    """What the receipts tell, counted."""

    def __init__(self) -> None:
        self.parts: Counter[str] = Counter()
        self.captures: Counter[str] = Counter()
        self.shards: Counter[str] = Counter()
        self.layouts: dict[str, dict[str, Any]] = {}
        self.damaged: list[str] = []
        self.dropped: list[int] = []

    def add(self, root: Path, place: tuple[str, int], manifest: ShardedManifest | None) -> None:
        """Count a shard; one whose receipt is lost, or whose files have not their sizes, is damaged."""
        try:
            receipt = read_either(root, *place)
        except InputError:
            self.damaged.append(receipt_name(*place))
            return
        self.dropped += [held.index for held in receipt.lost]
        listed = None if manifest is None else manifest.shards.get(place)
        files = {
            root / receipt.group / name / shard_key(receipt.shard, receipt.structure[name]): size
            for name, size in (listed.sizes.items() if listed is not None else ())
            if name in receipt.structure
        }
        whole = all(not in_a_link(file) and regular_size(file) == size for file, size in files.items())
        if not whole:
            self.damaged.append(receipt_name(*place))
            return
        self.captures[receipt.group] += len(receipt.captures)
        self.shards[receipt.group] += bool(receipt.captures)
        self.layouts.setdefault(receipt.group, {"structure": receipt.structure, "length": receipt.length})
        self.parts.update(str(held.facts.get("part", "")) for held in receipt.captures)


def _sizes(structure: dict[str, dict[str, Any]]) -> dict[str, int]:
    return {dim: n for entry in structure.values() for dim, n in zip(entry["dims"], entry["shape"], strict=True)}
