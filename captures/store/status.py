"""Status of a folder: a store, an unfinished store, or neither; number of captures and size."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from .journal import has_header, read_journal
from .manifest import load_manifest
from .publish import is_store, partial_of
from .shard_manifest import is_sharded
from .shard_status import sharded_contents

__all__ = ["StoreStatus", "status"]


@dataclass(frozen=True)
class StoreStatus:
    """Status of one folder. `n_bytes` is its size on disk, `unfinished` the partial store beside a complete one."""

    path: Path
    state: Literal["complete", "unfinished", "absent", "other"]
    modality: str = ""
    count: int = 0
    n_bytes: int = 0
    unfinished: Path | None = None


def status(path: str | os.PathLike[str]) -> StoreStatus:
    """Look at `path` without reading captures. Raises InputError where a manifest or journal is damaged."""
    given = Path(path)
    partial = given if given.name.endswith(".partial") else partial_of(given)
    sharded = next((place for place in dict.fromkeys((given, partial)) if is_sharded(place)), None)
    if sharded is not None:
        return _sharded_status(sharded, partial)
    if given != partial and is_store(given):
        manifest = load_manifest(given)
        beside = partial if is_store(partial) else None
        return StoreStatus(given, "complete", manifest.modality, manifest.count, _size(given), beside)
    if is_store(partial):
        if not has_header(partial):
            return StoreStatus(partial, "unfinished", n_bytes=_size(partial))
        journal = read_journal(partial)
        return StoreStatus(partial, "unfinished", journal.modality, len(journal.records), _size(partial))
    return StoreStatus(given, "other" if os.path.lexists(given) else "absent")


def _size(folder: Path) -> int:
    return sum(os.lstat(Path(root) / name).st_size for root, _, names in os.walk(folder) for name in names)


def _sharded_status(place: Path, partial: Path) -> StoreStatus:
    told = sharded_contents(place)
    modality = ", ".join(one["group"] for one in told["groups"])
    beside = partial if place != partial and is_store(partial) else None
    state: Literal["complete", "unfinished"] = "complete" if told["finished"] else "unfinished"
    return StoreStatus(place, state, modality, told["count"], told["bytes"], beside)
