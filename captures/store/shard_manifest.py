"""The manifest of a store of many captures: its groups, the sha256 of its metadata and receipts, and the id of its content.

All of it follows from the receipts, so that either is written again from the other.
"""

from __future__ import annotations

import hashlib
import json
import re
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ...scenes.errors import InputError, other_version
from ...scenes.json_keys import read_json
from ..layouts.schema import SCHEMA_VERSION
from .arrays import Structure
from .manifest import FORMAT, MANIFEST, MANIFEST_SUM, DamagedManifest, regular_size, sum_text
from .shard_chunks import inner_shape
from .shard_receipts import COPY, RECEIPTS, SHARDED_VERSION, Receipt, file_size, receipt_name

__all__ = [
    "DATASET", "INDEX", "Group", "Listed", "ShardedManifest", "is_sharded", "listed", "load_sharded", "sharded_groups",
    "sharded_manifest", "sharded_metadata",
]  # fmt: skip

#: What was asked for, and the table of all captures.
DATASET, INDEX = "dataset.json", "index.parquet"
_RECEIPT = re.compile(r"([a-z0-9][a-z0-9_]{0,60})\.([0-9]{1,9})\.z")


@dataclass(frozen=True)
class Group:
    """The captures of one modality: arrays in the folder `name`, `length` captures a shard, `rows` places in all."""

    name: str
    modality: str
    structure: Structure
    length: int
    rows: int


@dataclass(frozen=True)
class Listed:
    """What the manifest says of a shard: sha256 of its receipt, number and id of its captures, size of each array's file."""

    digest: str
    count: int
    content: str
    sizes: dict[str, int]


@dataclass(frozen=True)
class ShardedManifest:
    """Required content of a store. `content` is the id of all captures: equal for equal captures in equal order."""

    groups: dict[str, Group]
    shards: dict[tuple[str, int], Listed]
    metadata: dict[str, str]
    sha256: str = ""
    facts: dict[str, Any] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of captures."""
        return sum(one.count for one in self.shards.values())

    @property
    def content(self) -> str:
        """sha256 of the ids of all shards."""
        lines = [f"{group} {shard} {one.content}" for (group, shard), one in sorted(self.shards.items())]
        return hashlib.sha256("\n".join(lines).encode()).hexdigest()

    def text(self) -> str:
        """The manifest as JSON."""
        body = {
            "format": FORMAT, "store_version": SHARDED_VERSION, "schema_version": SCHEMA_VERSION, "count": self.count,
            "content": self.content, "metadata": self.metadata, "facts": self.facts,
            "groups": {g.name: {k: v for k, v in vars(g).items() if k != "name"} for g in self.groups.values()},
            "shards": {receipt_name(*place): list(vars(one).values()) for place, one in self.shards.items()},
        }  # fmt: skip
        return json.dumps(body, indent=0, sort_keys=True) + "\n"


def is_sharded(root: Path) -> bool:
    """Whether the folder is a store of many captures, finished or not, whatever its state."""
    if root.is_symlink() or not root.is_dir():
        return False
    return (
        any(regular_size(root / name) is not None for name in (DATASET, DATASET + COPY)) or (root / RECEIPTS).is_dir()
    )


def listed(receipt: Receipt, content: bytes) -> Listed:
    """What the manifest says of a receipt with these bytes."""
    sizes = {name: file_size(receipt, name) for name in receipt.structure}
    return Listed(hashlib.sha256(content).hexdigest(), len(receipt.captures), receipt.content, sizes)


def sharded_groups(receipts: Iterable[Receipt]) -> tuple[dict[str, Group], dict[tuple[str, int], Listed]]:
    """The groups of a store, and what its manifest says of each shard, by the receipts of all shards that hold a capture.

    Raises InputError: the receipts of a group disagree.
    """
    groups: dict[str, Group] = {}
    shards: dict[tuple[str, int], Listed] = {}
    for one in receipts:
        if not one.captures:
            continue
        rows = one.shard * one.length + max(held.row for held in one.captures) + 1
        known = groups.get(one.group)
        if known and (known.modality, known.structure, known.length) != (one.modality, one.structure, one.length):
            raise InputError("The receipts of a group disagree.", where=receipt_name(one.group, one.shard))
        groups[one.group] = Group(
            one.group, one.modality, one.structure, one.length, max(rows, known.rows if known else 0)
        )
        shards[one.group, one.shard] = listed(one, one.content_bytes())
    return groups, dict(sorted(shards.items()))


def sharded_manifest(
    groups: dict[str, Group],
    shards: dict[tuple[str, int], Listed],
    others: Mapping[str, bytes],
    facts: Mapping[str, Any],
) -> tuple[ShardedManifest, dict[str, bytes]]:
    """The manifest of a store, and the content of every `zarr.json` by path.

    Main arguments:
        groups, shards: as of `sharded_groups`. others: further files that the manifest lists. facts: kept as they are.
    """
    files = sharded_metadata(groups)
    sums = {name: hashlib.sha256(content).hexdigest() for name, content in {**files, **others}.items()}
    return ShardedManifest(groups, shards, sums, facts=dict(facts)), files


def sharded_metadata(groups: Mapping[str, Group]) -> dict[str, bytes]:
    """Content of every `zarr.json` by path."""
    return dict(_metadata(json.dumps([vars(group) for group in groups.values()])))


@lru_cache(maxsize=8)
def _metadata(told: str) -> dict[str, bytes]:
    """As `sharded_metadata`, of the groups as JSON: zarr takes .2 s for some tens of arrays."""
    import zarr
    from zarr.codecs import BloscCodec, Crc32cCodec
    from zarr.storage import MemoryStore

    store = MemoryStore()
    root = zarr.create_group(store, zarr_format=3, attributes={"schema_version": SCHEMA_VERSION})
    groups = [Group(**one) for one in json.loads(told)]
    for group in groups:
        coords = " ".join(name for name, entry in group.structure.items() if entry["coord"])
        place = root.create_group(
            group.name,
            attributes={
                "coordinates": coords, "modality": group.modality, "variables": list(group.structure),
                "schema_version": SCHEMA_VERSION,
            },
        )  # fmt: skip
        for name, entry in group.structure.items():
            dtype = np.dtype(entry["dtype"])
            fill = dtype.type(np.nan) if dtype.kind in "fc" else dtype.type(0)
            place.create_array(
                name,
                shape=(group.rows, *entry["shape"]),
                chunks=(1, *inner_shape(entry)),
                shards=(group.length, *entry["shape"]),
                dtype=dtype,
                compressors=(
                    BloscCodec(typesize=dtype.itemsize, cname="zstd", clevel=1, shuffle="shuffle"),
                    Crc32cCodec(),
                ),
                fill_value=fill,
                dimension_names=("capture", *entry["dims"]),
                chunk_key_encoding={"name": "default", "separator": "."},
                attributes=entry["attrs"],
            )
    with warnings.catch_warnings():
        # zarr warns that consolidated metadata are an extension; with them other readers need not list the folder.
        warnings.simplefilter("ignore")
        for name in (*(group.name for group in groups), ""):
            zarr.consolidate_metadata(store, path=name, zarr_format=3)
    return {key: value.to_bytes() for key, value in store._store_dict.items() if key.endswith("zarr.json")}


def load_sharded(root: Path) -> ShardedManifest:
    """Read and check the manifest of the store at `root`.

    Raises DamagedManifest where it is not as it was written, InputError where it is unknown or cannot be read.
    """
    try:
        if any(regular_size(root / name) is None for name in (MANIFEST, MANIFEST_SUM)):
            raise _damaged(root, "it is missing")
        text, expected = (root / MANIFEST).read_bytes(), (root / MANIFEST_SUM).read_bytes()
    except OSError as error:
        raise InputError(f"The manifest cannot be read: {error.strerror}.", where=str(root)) from error
    if expected != sum_text(text):
        raise _damaged(root, "its sha256 does not match")
    try:
        return _parsed(root, text)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"The manifest is not that of a store of captures: {error!r}.", where=str(root / MANIFEST),
            allowed="written by beambench",
        ) from error  # fmt: skip


def _damaged(root: Path, told: str) -> DamagedManifest:
    return DamagedManifest(
        f"The manifest is damaged: {told}.", where=str(root / MANIFEST),
        next_step=f"`beambench data repair {root}` writes it again from the receipts",
    )  # fmt: skip


def _parsed(root: Path, text: bytes) -> ShardedManifest:
    from .layout import structure_problem

    body = read_json(text)
    versions = (body["format"], body["store_version"], body["schema_version"])
    if versions != (FORMAT, SHARDED_VERSION, SCHEMA_VERSION):
        raise other_version(
            "The store was written in another version of the format.", where=str(root),
            found=max(versions[1:], key=lambda one: one if type(one) is int else -1), known=SHARDED_VERSION,
            older="read it with the version of Beambench that wrote it, or generate it anew",
        )  # fmt: skip
    groups: dict[str, Group] = {}
    for name, one in body["groups"].items():
        group = Group(name, str(one["modality"]), one["structure"], one["length"], one["rows"])
        if problem := structure_problem(group.structure):
            raise ValueError(f"{problem[0]}: {problem[1]}")
        if not all(type(n) is int and 0 < n < 2**40 for n in (group.length, group.rows)):
            raise ValueError(f"the group {name!r} has no possible length")
        if not re.fullmatch(r"[a-z0-9][a-z0-9_]{0,60}", name) or not all(
            re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.\-]{0,200}", array) for array in group.structure
        ):
            raise ValueError("the name of a group or an array leads out of the store")
        groups[name] = group
    shards: dict[tuple[str, int], Listed] = {}
    for name, (digest, count, content, sizes) in body["shards"].items():
        match = _RECEIPT.fullmatch(name)
        if match is None or type(count) is not int or not 0 < count <= groups[match[1]].length:
            raise ValueError(f"shard {name!r}")
        if set(sizes) != set(groups[match[1]].structure) or not all(type(n) is int for n in sizes.values()):
            raise ValueError(f"shard {name!r}")
        shards[match[1], int(match[2])] = Listed(str(digest), count, str(content), dict(sizes))
    if not shards:
        raise ValueError("it lists no shard")
    metadata = {str(name): str(digest) for name, digest in body["metadata"].items()}
    return ShardedManifest(
        groups, dict(sorted(shards.items())), metadata, hashlib.sha256(text).hexdigest(), dict(body["facts"])
    )
