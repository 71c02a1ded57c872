"""Turn the shards of an unfinished store of many captures into a store: metadata, index and manifest, then one rename."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError
from ...scenes.json_keys import read_json
from .journal import JOURNAL, fsync_path, write_file
from .manifest import FORMAT, MANIFEST, MANIFEST_SUM, regular_size, sum_text
from .ownership import REPAIR_MARK, TOKEN
from .publish import exchange
from .shard_index import IndexFile
from .shard_manifest import DATASET, INDEX, ShardedManifest, sharded_groups, sharded_manifest
from .shard_receipts import COPY, RECEIPTS, SHARDED_VERSION, Receipt, list_receipts, read_either

__all__ = ["drop_temporary", "publish_sharded", "read_request", "request_bytes", "store_files", "write_request"]


def request_bytes(request: dict[str, Any]) -> bytes:
    """What was asked for, as it is stored: the sha256 of its text, then the text."""
    text = json.dumps({"format": FORMAT, "store_version": SHARDED_VERSION, **request}, sort_keys=True, indent=1)
    return f'{{"sha256": "{hashlib.sha256(text.encode()).hexdigest()}",\n"request": {text}}}\n'.encode()


def write_request(root: Path, request: dict[str, Any]) -> None:
    """Begin a store: what was asked for, twice. Raises OSError."""
    (root / RECEIPTS).mkdir(exist_ok=True)
    for name in (DATASET + COPY, DATASET):
        write_file(root / name, request_bytes(request))
    fsync_path(root)


def read_request(root: Path) -> dict[str, Any]:
    """What was asked for, by the file or its copy. Raises InputError where both are damaged."""
    problem: object = "missing"
    for name in (DATASET, DATASET + COPY):
        try:
            if regular_size(root / name) is not None:
                body = read_json((root / name).read_bytes())
                request: dict[str, Any] = body["request"]
                kept = {key: value for key, value in request.items() if key not in ("format", "store_version")}
                if request_bytes(kept) == (root / name).read_bytes() and request["format"] == FORMAT:
                    return kept
                problem = "its checksum does not match"
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            problem = error
    raise InputError(
        f"The record of the data set's request is damaged, and so is its copy: {problem}.", where=str(root / DATASET),
        next_step="generate it anew",
    )  # fmt: skip


def store_files(root: Path, receipts: Iterable[Receipt]) -> tuple[ShardedManifest, dict[str, bytes]]:
    """The manifest, and every metadata file by its path, as they follow from the receipts and the request.

    Main arguments:
        receipts: of all shards; one is in memory at a time.
    """
    request = read_request(root)
    index = IndexFile(request.get("numbers", []), request.get("texts", []))
    facts = {
        "dataset": request.get("name", ""),
        "identity": request.get("identity", ""),
        "asked": request.get("count", 0),
    }
    groups, shards = sharded_groups(index.passing(receipts))
    others = {INDEX: index.content(), DATASET: request_bytes(request)}
    manifest, files = sharded_manifest(groups, shards, others, facts)
    if not manifest.shards:
        raise InputError("There is no complete shard to store.", where=str(root))
    text = manifest.text().encode()
    copies = {DATASET + COPY: others[DATASET]}
    return manifest, {**files, **others, **copies, MANIFEST: text, MANIFEST_SUM: sum_text(text)}


def publish_sharded(partial: Path, path: Path, *, overwrite: bool) -> ShardedManifest:
    """Give the shards of `partial` the final name `path`. Raises OSError, InputError."""
    places = list_receipts(partial)
    manifest, files = store_files(partial, (read_either(partial, *place) for place in places))
    _drop_unlisted(partial, manifest)
    for name, content in files.items():
        write_file(partial / name, content)
    for group in manifest.groups.values():
        for name in group.structure:
            fsync_path(partial / group.name / name)
        fsync_path(partial / group.name)
    fsync_path(partial)
    exchange(partial, path, overwrite, None)
    for name in (JOURNAL, REPAIR_MARK, TOKEN):
        (path / name).unlink(missing_ok=True)
    fsync_path(path)
    return manifest


def _drop_unlisted(partial: Path, manifest: ShardedManifest) -> None:
    """Remove files of shards that have no receipt, and temporary files: a stop left them."""
    from .ownership import may_drop
    from .shard_chunks import shard_key

    for group in manifest.groups.values():
        kept = {number for name, number in manifest.shards if name == group.name}
        for name, entry in group.structure.items():
            known = {shard_key(number, entry) for number in kept}
            for file in (partial / group.name / name).iterdir():
                if file.name not in known and may_drop(file.name):
                    file.unlink()
    drop_temporary(partial)


def drop_temporary(partial: Path) -> None:
    """Remove the temporary files that stopped workers left in an unfinished store. Raises OSError."""
    for pattern in (f"{RECEIPTS}/*.new", "*/*/c.*.partial", "*/*/c.*.new"):
        for file in partial.glob(pattern):
            file.unlink(missing_ok=True)
