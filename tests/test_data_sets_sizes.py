"""The size that a plan tells, by a pilot's shard, against that on disk; and its time where captures differ in noise alone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import xarray as xr

from beambench.benchmarks.datasets.outline import _in_one, _pilot_of
from beambench.benchmarks.datasets.sizes import sizes_of_shard, stored_bytes
from beambench.captures import finalize
from beambench.captures.store.shard_finish import request_bytes
from beambench.captures.store.shard_receipts import Receipt
from beambench.captures.store.shard_writer import ShardWriter

from .test_captures_shards import begun, captures_of

LENGTH = 8


def draws_of(count: int, repeats: int) -> list[xr.Dataset]:
    """Captures whose long attributes are those of their draw, as scenes are."""
    return [
        one.assign_attrs(truth_scene=json.dumps({"draw": [number // repeats] * 2000}), seed=number)
        for number, one in enumerate(captures_of("amcw", count))
    ]


def write_shard(root: Path, shard: int, captures: list[xr.Dataset], repeats: int, length: int, last: bool) -> Receipt:
    first = shard * length
    with ShardWriter(root, "amcw", shard, range(first, first + len(captures)), length, last=last) as writer:
        for number, capture in enumerate(captures, first):
            facts = {
                "part": "train",
                "base": "w",
                "draw": number // repeats,
                "seed": 1,
                "scene_sha256": f"{number:064x}",
            }
            writer.append(capture, facts | {"values": {"a": number / 7, "b": "x"}})
        return writer.close()


@pytest.mark.parametrize(("count", "repeats"), [(3, 1), (14, 1), (80, 1), (80, 4), (80, 40)])
def test_the_size_is_that_on_disk(tmp_path: Path, count: int, repeats: int) -> None:
    """Also of data sets that are so small that receipts and metadata are most of them."""
    captures = draws_of(count, repeats)
    # The pilot makes the first two captures of each draw.
    chosen = [number for number in range(min(count, 10 * repeats)) if number % repeats < 2]
    begun(tmp_path / "pilot.partial", count)
    with ShardWriter(tmp_path / "pilot.partial", "amcw", 0, chosen, len(chosen), last=True) as writer:
        for number in chosen:
            facts = {
                "part": "train",
                "base": "w",
                "draw": number // repeats,
                "seed": 1,
                "scene_sha256": f"{number:064x}",
            }
            writer.append(captures[number], facts | {"values": {"a": number / 7, "b": "x"}})
        sizes = sizes_of_shard(writer.close(), repeats)
    begun(tmp_path / "s.partial", count)
    for shard, first in enumerate(range(0, count, LENGTH)):
        own = captures[first : first + LENGTH]
        write_shard(tmp_path / "s.partial", shard, own, repeats, LENGTH, first + LENGTH >= count)
    finalize(tmp_path / "s")
    real = sum(path.stat().st_size for path in (tmp_path / "s").rglob("*") if path.is_file())
    request = {"name": "x", "count": count, "identity": "i", "numbers": ["a"], "texts": ["b"]}
    told = stored_bytes(sizes, count, LENGTH) + 2 * len(request_bytes(request))
    assert told == pytest.approx(real, rel=0.1)


def test_captures_that_differ_in_noise_alone_cost_less_in_the_plan() -> None:
    """Draws of 5: the first takes 1 s, the others .1 s; the first two draws, where kernels are loaded, do not count."""
    rows = [draw * 5 + n for draw in range(6) for n in (0, 1)]
    cpu_s = [9.0, 9.0, 9.0, 9.0] + [1.0, 0.1] * 4
    told = {"structure": {}, "decoded": 1, "sizes": {"capture": 1.0, "table": 0.0}, "cpu_s": cpu_s, "warnings": []}
    assert _pilot_of("g", told, rows, 5).cpu_s == pytest.approx((1.0 + 4 * 0.1) / 5)
    assert _pilot_of("g", told | {"cpu_s": [2.0, 1.0, 1.0]}, [0, 1, 2], 1).cpu_s == pytest.approx(1.0)


def test_warnings_that_differ_in_a_percentage_are_one() -> None:
    """The plan of wavefront-10k told eight lines of one scene's scintillation, from 37% to 111%."""
    told = {"a: left out, by 37%.", "a: left out, by 111%.", "a: left out, by 56%.", "b: by 5%.", "50% of c"}
    assert _in_one(told) == ["50% of c", "a: left out, by 37% to 111%.", "b: by 5%."]
