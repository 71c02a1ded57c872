"""Read every byte of a store of many captures and list what is damaged."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

from ...scenes.errors import InputError
from .manifest import DamagedManifest, check_metadata_files, in_a_link, read_problem, regular_size
from .ownership import sharded_foreign
from .shard_chunks import shard_key
from .shard_finish import read_request, request_bytes
from .shard_manifest import DATASET, ShardedManifest, load_sharded
from .shard_receipts import (
    COPY,
    RECEIPTS,
    Receipt,
    chunk_count,
    file_size,
    list_receipts,
    read_either,
    read_receipt,
    receipt_name,
    shard_table,
)
from .verification import FOREIGN, Damage

__all__ = ["shard_damage", "sharded_partial_damage", "verify_sharded"]


def verify_sharded(root: Path) -> list[Damage]:
    """Every damaged file of the store at `root`; a file is listed once for each capture that it damages.

    Raises InputError where there is neither an intact manifest nor an intact receipt.
    """
    damage: list[Damage] = []
    manifest: ShardedManifest | None = None
    try:
        manifest = load_sharded(root)
        damage += [Damage(name, problem, None) for name, problem in check_metadata_files(root, manifest.metadata)]
        places = list(manifest.shards)
    except DamagedManifest as error:
        damage.append(Damage(_which(root), error.what.partition(": ")[2], None))
        places = list_receipts(root)
    damage += _copy_damage(root)
    damage += [Damage(name, FOREIGN, None) for name in sharded_foreign(root)]
    position = 0
    for place in places:
        found, receipt = _receipt_damage(root, place, manifest)
        damage += found
        if receipt is not None:
            damage += shard_damage(root, receipt, position)
            position += len(receipt.captures)
    known = {*places}
    for place in list_receipts(root):
        if place in known:
            continue
        found, receipt = _receipt_damage(root, place, None)
        if receipt is not None and not receipt.captures:
            damage += found  # all of its captures were dropped by a repair: it tells how they are made again
        else:
            damage.append(Damage(f"{RECEIPTS}/{receipt_name(*place)}", "not in the manifest", None))
    return damage


def _which(root: Path) -> str:
    """The damaged one of the manifest and its sum: that whose text is not what the receipts give."""
    from .manifest import MANIFEST, MANIFEST_SUM
    from .shard_finish import store_files

    places = list_receipts(root)
    _, files = store_files(root, (read_either(root, *place) for place in places))
    path = root / MANIFEST
    same = regular_size(path) is not None and path.read_bytes() == files[MANIFEST]
    return MANIFEST_SUM if same else MANIFEST


def _copy_damage(root: Path) -> list[Damage]:
    """Damage of the copy of the request, which the manifest does not list."""
    path = root / (DATASET + COPY)
    try:
        whole = regular_size(path) is not None and path.read_bytes() == request_bytes(read_request(root))
    except OSError as error:
        return [Damage(path.name, read_problem(error), None)]
    return [] if whole else [Damage(path.name, "not what was written", None)]


def _receipt_damage(
    root: Path, place: tuple[str, int], manifest: ShardedManifest | None
) -> tuple[list[Damage], Receipt | None]:
    """Damage of a receipt and its copy, and the one that is sound."""
    digest = manifest.shards[place].digest if manifest is not None else ""
    found: list[Damage] = []
    receipt: Receipt | None = None
    for copy in (False, True):
        try:
            receipt = read_receipt(root, *place, copy=copy, digest=digest)
        except InputError as error:
            name = receipt_name(*place) + (COPY if copy else "")
            found.append(Damage(f"{RECEIPTS}/{name}", error.what.partition(": ")[2].rstrip("."), None))
    return found, receipt


def shard_damage(root: Path, receipt: Receipt, first: int = 0) -> list[Damage]:
    """The damage of the files of one shard; its captures are numbered from `first`."""
    return [one for name in receipt.structure for one in _file_damage(root, receipt, name, first)]


def _file_damage(root: Path, receipt: Receipt, name: str, first: int) -> Iterator[Damage]:
    entry = receipt.structure[name]
    path = root / receipt.group / name / shard_key(receipt.shard, entry)
    where = str(path.relative_to(root))
    numbers = range(first, first + len(receipt.captures))
    if in_a_link(path):
        yield from (Damage(where, "its folder is a link", number) for number in numbers)
        return
    size = file_size(receipt, name)
    try:
        found = regular_size(path)
        if found is None:
            yield from (Damage(where, "missing", number) for number in numbers)
            return
        with open(path, "rb") as file:
            for number, held in zip(numbers, receipt.captures, strict=True):
                for offset, length, digest in held.chunks[name]:
                    file.seek(offset)
                    if hashlib.sha256(file.read(length)).hexdigest() != digest:
                        yield Damage(where, "sha256 does not match", number)
                        break
            file.seek(size - (16 * chunk_count(entry, receipt.length) + 4))
            if found != size:
                yield Damage(where, f"{found} bytes, not {size}", None)
            elif file.read() != shard_table(receipt, name):
                yield Damage(where, "the table of its chunks does not match", None)
    except OSError as error:
        yield from (Damage(where, read_problem(error), number) for number in numbers)


def sharded_partial_damage(partial: Path) -> list[tuple[Receipt, list[Damage]]]:
    """The shards of an unfinished store that are damaged, with their damage. Raises InputError for a receipt that is lost."""
    found = []
    for place in list_receipts(partial):
        receipt = read_either(partial, *place)
        if damage := shard_damage(partial, receipt):
            found.append((receipt, damage))
    return found
