"""Small stores of many captures, for tests of their files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import xarray as xr

from beambench.captures.example import example_capture
from beambench.captures.store.journal import JOURNAL, mark_journal
from beambench.captures.store.shard_finish import write_request
from beambench.captures.store.shard_writer import ShardWriter

__all__ = ["LENGTH", "MODALITY", "begun", "captures_of", "filled"]

LENGTH = 3
#: The modality of most tests: that with the fewest arrays.
MODALITY = "amcw"


def captures_of(modality: str, count: int) -> list[xr.Dataset]:
    return [example_capture(modality, seed=number).assign_attrs(seed=number) for number in range(count)]


def begun(partial: Path, count: int) -> None:
    partial.mkdir()
    with open(partial / JOURNAL, "xb") as file:
        mark_journal(file)
    write_request(partial, {"name": "x", "count": count, "identity": "i", "numbers": ["a"], "texts": ["b"]})


def filled(
    partial: Path, group: str, captures: Sequence[xr.Dataset], first: int = 0, leave_out: Sequence[int] = ()
) -> None:
    for shard, begin in enumerate(range(0, len(captures), LENGTH)):
        if shard in leave_out:
            continue
        own = captures[begin : begin + LENGTH]
        rows = range(first + begin, first + begin + len(own))
        with ShardWriter(partial, group, shard, rows, LENGTH, last=begin + LENGTH >= len(captures)) as writer:
            for number, capture in enumerate(own):
                writer.append(
                    capture, {"part": "train", "values": {"a": number / 2, "b": "x"}, "base": "w", "draw": number}
                )
            writer.close()
