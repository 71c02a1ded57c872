"""Readers for training: every capture once an epoch, parts kept apart, shards shared out, and a position that is gone on from."""

from __future__ import annotations

import copy
import sys
import types
from abc import ABC
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.captures import open_captures, write
from beambench.captures.layouts import LAYOUTS
from beambench.captures.readers import Captures, CaptureStream, numpy_batches
from beambench.captures.store.faces import finalize
from beambench.captures.store.shard_writer import ShardWriter
from beambench.scenes.errors import InputError

from .test_captures_shards import LENGTH, begun, captures_of

COUNT = 20
PARTS = ["train"] * 5 + ["test"]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = tmp_path_factory.mktemp("readers")
    begun(base / "s.partial", COUNT)
    captures = captures_of("amcw", COUNT)
    for shard, first in enumerate(range(0, COUNT, LENGTH)):
        rows = range(first, min(first + LENGTH, COUNT))
        with ShardWriter(base / "s.partial", "amcw", shard, rows, LENGTH, last=first + LENGTH >= COUNT) as writer:
            for row in rows:
                capture = captures[row]
                capture["truth_range"].values[:] = row + 1.0
                writer.append(capture, {"part": PARTS[row % 6]})
            writer.close()
    finalize(base / "s")
    return base / "s"


class Iterable(ABC):  # noqa: B024
    """Stands in for PyTorch's class of that kind, by which its `DataLoader` tells streams from lists."""


def number(sample: dict[str, Any]) -> int:
    return int(sample["truth_range"].ravel()[0]) - 1


def test_places_are_those_of_the_part(store: Path) -> None:
    parts = {part: [number(one) for one in Captures(store, part=part)] for part in ("train", "test")}  # type: ignore[attr-defined]
    assert parts["test"] == [5, 11, 17]
    assert sorted(parts["train"] + parts["test"]) == list(range(COUNT))
    whole = Captures(store, ["samples"])
    assert len(whole) == COUNT
    assert list(whole[3]) == ["samples"]
    np.testing.assert_array_equal(whole[-1]["samples"], open_captures(store)[19]["samples"].values)
    with pytest.raises(IndexError):
        whole[COUNT]


def test_a_slice_is_a_part_of_the_captures(store: Path) -> None:
    train = Captures(store, part="train")
    few = train[2:-1:3]
    assert isinstance(few, Captures) and len(few) == 5
    assert [number(few[n]) for n in range(5)] == [number(train[n]) for n in range(len(train))][2:-1:3]
    assert number(few[1:][-1]) == number(few[4])
    assert len(train) == COUNT - 3
    with pytest.raises(IndexError):
        few[5]


def test_a_stream_gives_each_capture_once_in_another_order_each_epoch(store: Path) -> None:
    stream = CaptureStream(store, seed=1, buffer=8)
    first, second = [number(one) for one in stream], [number(one) for one in stream]
    assert sorted(first) == sorted(second) == list(range(COUNT))
    assert first != second != list(range(COUNT))
    assert first == [number(one) for one in CaptureStream(store, seed=1, buffer=8)]
    assert [number(one) for one in CaptureStream(store, seed=1, buffer=1)] == list(range(COUNT))


def test_processes_and_workers_share_the_shards(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two processes of two workers: each capture once, by the same stand-in for torch that `DataLoader` is asked through."""
    seen = []
    for rank in range(2):
        for worker in range(2):
            info = types.SimpleNamespace(id=worker, num_workers=2)
            fake = types.SimpleNamespace(get_worker_info=lambda info=info: info, IterableDataset=Iterable)
            monkeypatch.setitem(sys.modules, "torch.utils.data", fake)  # type: ignore[arg-type]
            seen += [number(one) for one in CaptureStream(store, seed=2, rank=rank, world=2)]
    assert sorted(seen) == list(range(COUNT))


def test_a_position_is_gone_on_from(store: Path) -> None:
    whole = [number(one) for one in CaptureStream(store, seed=3, buffer=5)]
    stream = CaptureStream(store, seed=3, buffer=5)
    reading = iter(stream)
    begin = [number(next(reading)) for _ in range(7)]
    state = stream.state()
    later = CaptureStream(store, seed=3, buffer=5)
    later.load_state(copy.deepcopy(state))
    assert begin + [number(one) for one in later] == whole
    with pytest.raises(InputError, match="another order"):
        CaptureStream(store, seed=4, buffer=5).load_state(state)
    for wrong in ({}, 3, {"epoch": 0, "given": 1}):
        with pytest.raises(InputError, match="no position"):
            later.load_state(wrong)  # type: ignore[arg-type]


def test_one_name_alone_is_a_variable(store: Path) -> None:
    assert list(Captures(store, "truth_range")[0]) == ["truth_range"]


def test_batches_are_stacked(store: Path) -> None:
    batches = list(numpy_batches(store, 8, ["samples", "truth_range"]))
    assert [len(one["samples"]) for one in batches] == [8, 8, 4]
    assert np.concatenate([one["truth_range"] for one in batches]).ravel()[0] == 1.0
    shuffled = [number({"truth_range": row}) for one in numpy_batches(store, 8, seed=4) for row in one["truth_range"]]
    assert sorted(shuffled) == list(range(COUNT))


def test_a_stream_is_of_the_kind_that_a_loader_iterates_over(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It counted as a list of captures, of which a `DataLoader` asked the first and got a TypeError."""
    fake = types.SimpleNamespace(get_worker_info=lambda: None, IterableDataset=Iterable)
    monkeypatch.setitem(sys.modules, "torch.utils.data", fake)  # type: ignore[arg-type]
    assert isinstance(CaptureStream(store), Iterable) and not isinstance(Captures(store), Iterable)
    with pytest.raises(TypeError, match="import torch before"):
        CaptureStream(store)[0]


@pytest.mark.parametrize("workers", [0, 2])
def test_torch_reads_them(store: Path, workers: int) -> None:
    """Captures by their places and by a stream, whose position after some batches is gone on from."""
    torch = pytest.importorskip(
        "torch", reason="PyTorch is not installed; the tests above ask what its DataLoader asks"
    )

    def load(data: Any) -> list[list[int]]:
        loader = torch.utils.data.DataLoader(data, batch_size=2, num_workers=workers)
        return [[int(one.ravel()[0]) - 1 for one in batch["truth_range"]] for batch in loader]

    assert load(Captures(store, ["truth_range"])) == [[n, n + 1] for n in range(0, COUNT, 2)]
    whole = load(CaptureStream(store, ["truth_range"], seed=3, buffer=4))
    assert sorted(n for batch in whole for n in batch) == list(range(COUNT))
    each = max(workers, 1)
    stream = CaptureStream(store, ["truth_range"], seed=3, buffer=4)
    stream.load_state(stream.state() | {"given": 4})  # two batches of each worker
    assert load(stream) == whole[2 * each :]


def test_stateful_loaders_keep_the_positions_of_workers(store: Path) -> None:
    stateful = pytest.importorskip("torchdata.stateful_dataloader", reason="torchdata is not installed")

    def loader() -> Any:
        return stateful.StatefulDataLoader(CaptureStream(store, seed=3, buffer=4), batch_size=2, num_workers=2)

    whole = [number(batch) for batch in loader()]
    first = loader()
    reading = iter(first)
    begin = [number(next(reading)) for _ in range(3)]
    later = loader()
    later.load_state_dict(first.state_dict())
    assert begin + [number(batch) for batch in later] == whole


def test_other_stores_are_read_too(tmp_path: Path) -> None:
    write(tmp_path / "s.zarr", captures_of("amcw", 3))
    assert len(list(CaptureStream(tmp_path / "s.zarr", ["samples"]))) == 3
    with pytest.raises(InputError, match="Only a data set"):
        Captures(tmp_path / "s.zarr", part="train")


def test_what_does_not_exist_is_refused(store: Path) -> None:
    for given in ({"part": "tset"}, {"names": ["nothing"]}):
        with pytest.raises(InputError):
            Captures(store, **given)  # type: ignore[arg-type]
    for wrong in ({"buffer": 0}, {"rank": 2, "world": 2}):
        with pytest.raises(InputError):
            CaptureStream(store, **wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError):
        next(numpy_batches(store, 0))


def test_xarray_reads_only_what_is_asked_for(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from beambench.captures.lazy import dataset
    from beambench.captures.store.shard_set import ShardedSet

    read: list[int] = []
    values = ShardedSet.values
    monkeypatch.setattr(ShardedSet, "values", lambda self, n, names=None: read.append(int(n)) or values(self, n, names))
    whole = dataset(store)
    assert read.count(0) == len(read)  # the first one tells the layout
    captures = open_captures(store)
    first = captures[0]
    read.clear()
    assert whole.sizes["capture"] == COUNT
    assert [str(name) for name in whole.data_vars] == [str(name) for name in first.data_vars]
    assert set(first.coords) | {"capture", "part"} == set(whole.coords)
    assert not read
    np.testing.assert_array_equal(whole["samples"][3].values, captures[3]["samples"].values)
    assert set(read) == {3}
    read.clear()
    some = whole["samples"].isel(capture=[17, 2], shot=slice(1, None), phase=[0, 2])
    expected = np.stack([captures[n]["samples"].values[1:, :, [0, 2]] for n in (17, 2)])
    read.clear()
    np.testing.assert_array_equal(some.values, expected)
    assert sorted(read) == [2, 17]
    assert whole["samples"][5:5].shape == (0, *first["samples"].shape)
    assert whole["samples"][5:5].values.shape == (0, *first["samples"].shape)
    test = dataset(store, ["truth_range"], part="test")
    assert list(test["capture"].values) == [5, 11, 17]
    assert list(test["part"].values) == ["test"] * 3
    assert [int(x) - 1 for x in test["truth_range"].isel(shot=0).values] == [5, 11, 17]
    assert list(test.data_vars) == ["truth_range"]


@pytest.mark.parametrize("modality", list(LAYOUTS))
def test_xarray_reads_every_modality_and_other_stores(tmp_path: Path, modality: str) -> None:
    from beambench.captures.lazy import dataset

    captures = captures_of(modality, 2)
    write(tmp_path / "s.zarr", captures)
    stacked = dataset(tmp_path / "s.zarr")
    for name, variable in captures[1].variables.items():
        np.testing.assert_array_equal(stacked[name][1].values, variable.values)
        assert stacked[name].attrs == variable.attrs
