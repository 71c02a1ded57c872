"""Stores of example captures for tests of exports: one file a chunk, or a data set of shards with parts and drawn values."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from beambench.captures import finalize
from beambench.captures.example import example_capture
from beambench.captures.store.journal import JOURNAL, mark_journal
from beambench.captures.store.shard_finish import write_request
from beambench.captures.store.shard_writer import ShardWriter

__all__ = ["PARTS", "capture_of", "data_set"]

#: The part of each capture of a modality.
PARTS = ("train", "test", "train", "validation", "train")
LENGTH = 2


def capture_of(modality: str, number: int) -> xr.Dataset:
    """Capture `number`: all variables, also the optional ones."""
    return example_capture(modality, seed=number).assign_attrs(seed=number)


def data_set(path: Path, modalities: tuple[str, ...], count: int = len(PARTS)) -> Path:
    """A data set of `count` captures of each modality, numbered through, in shards of two."""
    partial = path.with_name(path.name + ".partial")
    partial.mkdir(parents=True)
    with open(partial / JOURNAL, "xb") as file:
        mark_journal(file)
    told = {"dataset": "small", "title": "Small & odd", "licence": "CC0-1.0", "citation": "Nobody, 2026"}
    write_request(
        partial,
        {"name": "small", "version": 2, "count": count * len(modalities), "identity": "i", "numbers": ["albedo"],
         "texts": ["kind"], "dataset": told},
    )  # fmt: skip
    for order, modality in enumerate(modalities):
        for shard, begin in enumerate(range(0, count, LENGTH)):
            own = range(begin, min(begin + LENGTH, count))
            rows = range(order * count + own.start, order * count + own.stop)
            with ShardWriter(partial, modality, shard, rows, LENGTH, last=own.stop == count) as writer:
                for number in own:
                    drawn: dict[str, object] = {"albedo": number / 8} if number else {"albedo": 0.0, "kind": "sand"}
                    facts = {"part": PARTS[number % len(PARTS)], "values": drawn, "base": "wall", "draw": number}
                    writer.append(capture_of(modality, number), facts)
                writer.close()
    finalize(path)
    return path
