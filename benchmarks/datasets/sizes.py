"""The size of a data set on disk, from one small shard of it: what a capture, a shard and the store take."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ...captures.store.shard_chunks import blocks_of
from ...captures.store.shard_index import index_content
from ...captures.store.shard_manifest import listed, sharded_groups, sharded_manifest
from ...captures.store.shard_receipts import Held, Receipt

__all__ = ["sizes_of_shard", "stored_bytes"]


def sizes_of_shard(receipt: Receipt, repeats: int) -> dict[str, float]:
    """Bytes: of a `capture` (values, its lines in two receipts and in the index), of a `table` entry of it, which an empty place
    has, too, of a `shard` beside its captures, and of the `store` beside its shards.

    Main arguments:
        receipt: of a shard of a few captures. repeats: captures of one draw in the data set, of which the later ones add less text.
    """
    first, later = _by_draw(receipt.captures)
    one, firsts = _part(receipt, first[:1]), _part(receipt, first)
    chunks = sum(size for held in receipt.captures for marks in held.chunks.values() for _, size, _ in marks)
    each = _slope(_bytes(firsts) - _bytes(one), len(first) - 1, _bytes(one))
    again = _slope(_bytes(receipt) - _bytes(firsts), len(later), each)
    of_texts = (each + (repeats - 1) * again) / repeats
    index = [_index([part]) for part in (one, receipt)]
    groups = [_index([part, part]) - size for part, size in zip((one, receipt), index, strict=True)]
    of_index = _slope(groups[1] - groups[0], len(receipt.captures) - 1, 0.0)
    manifest, files = sharded_manifest(*sharded_groups([receipt]), {}, {})
    line = len(str(list(vars(listed(receipt, b"")).values()))) + 40
    table = 16 * sum(len(blocks_of(entry)) for entry in receipt.structure.values())
    return {
        "capture": chunks / len(receipt.captures) + 2 * of_texts + of_index,
        "table": table,
        "shard": 2 * max(_bytes(one) - each, 0.0) + groups[0] - of_index + line + 4 * len(receipt.structure),
        "store": len(manifest.text()) - line + sum(map(len, files.values())) + max(index[0] - groups[0], 0),
    }


def stored_bytes(sizes: dict[str, float], captures: int, length: int) -> float:
    """Bytes of a group of so many captures, `length` in each shard."""
    shards = math.ceil(captures / length)
    return captures * sizes["capture"] + shards * (sizes["shard"] + length * sizes["table"]) + sizes["store"]


def _by_draw(captures: Sequence[Held]) -> tuple[list[Held], list[Held]]:
    """(the first capture of each draw, the others)."""
    first: dict[Any, Held] = {}
    for held in captures:
        first.setdefault(held.facts.get("draw"), held)
    return [*first.values()], [held for held in captures if first[held.facts.get("draw")] is not held]


def _part(receipt: Receipt, captures: Sequence[Held]) -> Receipt:
    """The receipt of these captures alone, with their texts."""
    names = {value for held in captures for kind, value in map(tuple, held.attrs.values()) if kind == "text"}
    texts = {name: text for name, text in receipt.texts.items() if name in names}
    return replace(receipt, captures=list(captures), texts=texts, raw=b"")


def _bytes(receipt: Receipt) -> int:
    return len(receipt.content_bytes())


def _index(receipts: list[Receipt]) -> int:
    values = receipts[0].captures[0].facts.get("values", {})
    numbers = [name for name, value in values.items() if isinstance(value, int | float)]
    return len(index_content(receipts, numbers, [name for name in values if name not in numbers]))


def _slope(rise: float, run: int, otherwise: float) -> float:
    return rise / run if run > 0 else otherwise
