"""Readers for training: batches of NumPy arrays or PyTorch tensors from a store, shuffled by shard, shared out, resumable.

    loader = torch.utils.data.DataLoader(Captures("gated-1k", part="train"), batch_size=8, num_workers=2)
    stream = torch.utils.data.DataLoader(CaptureStream("gated-1k", part="train", seed=1), batch_size=8, num_workers=2)

PyTorch is not needed to import or to use them: `Captures` has `__len__` and `__getitem__`, which is all that its `DataLoader` asks
for, and a `CaptureStream` made after PyTorch was imported counts as an `IterableDataset`. For xarray there is `lazy.dataset`.
"""

from __future__ import annotations

import copy
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from ..scenes.errors import InputError
from .store.faces import open_captures
from .store.reader import CaptureSet
from .store.shard_set import ShardedSet

__all__ = ["CaptureStream", "Captures", "numpy_batches"]

Sample = dict[str, NDArray[Any]]


def _identity(sample: Sample) -> Any:
    return sample


class Captures:
    """The captures of a store by their place: a map-style data set.

    Main arguments:
        path: a store, or DIR/GROUP of a data set of several modalities.
        names: variables to read; all if None.
    Other arguments:
        part: "train", "validation" or "test" of a data set's split; all if None.
        transform: {name: array} of a capture -> what is returned.

    A store is opened in each process that reads it, and in each again after a fork or a spawn. Raises InputError: no such store,
    variable or part.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        names: Sequence[str] | None = None,
        *,
        part: str | None = None,
        transform: Callable[[Sample], Any] = _identity,
    ) -> None:
        names = (names,) if isinstance(names, str) else names
        self.path, self.names, self.part, self.transform = Path(path), names, part, transform
        self._opened: tuple[int, CaptureSet] | None = None
        captures = self.captures
        if unknown := [name for name in names or () if name not in captures.variables]:
            raise InputError(
                "The store has no such variable.",
                where=str(path),
                value=unknown[0],
                allowed=", ".join(captures.variables),
            )
        #: Places in the store of the captures that are read.
        self.places: NDArray[np.int64] = _places(captures, part)

    @property
    def captures(self) -> CaptureSet:
        """The store, opened in this process."""
        if self._opened is None or self._opened[0] != os.getpid():
            self._opened = (os.getpid(), open_captures(self.path))
        return self._opened[1]

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_opened": None}

    def __len__(self) -> int:
        return len(self.places)

    @overload
    def __getitem__(self, index: int) -> Any: ...

    @overload
    def __getitem__(self, index: slice) -> Captures: ...

    def __getitem__(self, index: int | slice) -> Any:
        """A capture by its place, or a part of the captures: `captures[:100]`."""
        if isinstance(index, slice):
            part = copy.copy(self)
            part.places = self.places[index]
            return part
        if not -len(self) <= index < len(self):
            raise IndexError(index)
        return self.transform(self.read(int(self.places[index])))

    def read(self, place: int, names: Sequence[str] | None = None) -> Sample:
        """The arrays of the capture at a place of the store; `names` instead of those of this object."""
        captures, names = self.captures, names or self.names
        if isinstance(captures, ShardedSet):
            return captures.values(place, names)
        return {str(name): np.asarray(one.values) for name, one in captures.load(place, names).variables.items()}


class CaptureStream:
    """The captures of a store in a random order: shards are shuffled, and their captures through a buffer.

    Main arguments:
        path, names, part, transform: as of `Captures`.
        seed: of the order; with the number of the epoch it names the order on every machine.
    Other arguments:
        buffer: captures that are held to be shuffled; 1: in the order of the store.
        rank, world: which of how many processes of a training this is. Workers of a `DataLoader` are told apart beside that.

    Each process and each of its workers reads shards of its own. `state()` is the position, and `load_state(…)` goes on from it:
    with the same `rank`, `world` and `num_workers` what follows is what would have followed. A `DataLoader` with workers reads
    copies, so that state is each worker's own, and `set_epoch` must be called before each epoch. `state_dict` and `load_state_dict`
    are the same by the names that torchdata's `StatefulDataLoader` calls, which keeps the positions of all workers.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        names: Sequence[str] | None = None,
        *,
        part: str | None = None,
        transform: Callable[[Sample], Any] = _identity,
        seed: int = 0,
        buffer: int = 256,
        rank: int = 0,
        world: int = 1,
    ) -> None:
        if buffer < 1 or not 0 <= rank < world:
            raise InputError(
                "The buffer holds at least one capture, and rank is one of 0 … world − 1.", where="CaptureStream",
                value={"buffer": buffer, "rank": rank, "world": world},
            )  # fmt: skip
        self._inner = Captures(path, names, part=part, transform=transform)
        self.seed, self.buffer, self.rank, self.world = seed, buffer, rank, world
        self.epoch, self._given = 0, 0
        if (torch := sys.modules.get("torch.utils.data")) is not None:
            torch.IterableDataset.register(CaptureStream)  # a `DataLoader` asks by isinstance how it is read

    def __len__(self) -> int:
        return len(self._order())

    def __getitem__(self, index: int) -> Any:
        raise TypeError(
            "A CaptureStream has an order, not places: iterate over it, or take Captures. For a DataLoader, import torch before "
            "the stream is made."
        )

    def set_epoch(self, epoch: int) -> None:
        """Begin an epoch: its number names the order."""
        self.epoch, self._given = epoch, 0

    def state(self) -> dict[str, int]:
        """The position: the epoch, how many captures of it this process was given, and what names their order."""
        return {"epoch": self.epoch, "given": self._given} | self._named()

    def _named(self) -> dict[str, int]:
        return {"seed": self.seed, "buffer": self.buffer, "rank": self.rank, "world": self.world}

    def load_state(self, state: Mapping[str, int]) -> None:
        """Go on from a position. No capture before it is read again.

        Raises InputError: it is no position, or one in another order, where some captures would come twice and others never.
        """
        named = self._named()
        if not isinstance(state, Mapping) or not {"epoch", "given", *named} <= set(state):
            raise InputError(
                "This is no position of a stream.", where="load_state", value=state, allowed="what `state()` gave"
            )
        if any(state[key] != value for key, value in named.items()):
            raise InputError(
                "The position is of another order.", where="load_state", value={key: state[key] for key in named},
                allowed=str(named), next_step="make the stream with the values of the position",
            )  # fmt: skip
        self.epoch, self._given = int(state["epoch"]), int(state["given"])

    state_dict, load_state_dict = state, load_state

    def __iter__(self) -> Iterator[Any]:
        order = self._order()
        for place in order[self._given :]:
            self._given += 1
            yield self._inner.transform(self._inner.read(int(place)))
        self.epoch, self._given = self.epoch + 1, 0

    def _order(self) -> NDArray[np.int64]:
        """Places of the captures of this process and worker, in the order of the epoch."""
        rng = np.random.default_rng([self.seed, self.epoch])
        starts = np.array(_starts(self._inner.captures))
        shards = np.split(self._inner.places, np.searchsorted(self._inner.places, starts[1:-1]))
        shards = [one for one in shards if one.size]
        if self.buffer > 1:
            shards = [shards[n] for n in rng.permutation(len(shards))]
        worker, workers = _worker()
        own = shards[self.rank * workers + worker :: self.world * workers]
        places = np.concatenate(own) if own else np.zeros(0, np.int64)
        return _buffered(places, self.buffer, np.random.default_rng([self.seed, self.epoch, self.rank, worker]))


def numpy_batches(
    path: str | os.PathLike[str], size: int, names: Sequence[str] | None = None, *, part: str | None = None,
    seed: int | None = None,
) -> Iterator[Sample]:  # fmt: skip
    """Batches of stacked arrays (batch, …), the last one shorter; in the order of the store, or shuffled by `seed`."""
    if size < 1:
        raise InputError("A batch holds at least one capture.", where="size", value=size)
    stream = CaptureStream(path, names, part=part, seed=seed or 0, buffer=1 if seed is None else 256)
    held: list[Sample] = []
    for sample in stream:
        held.append(sample)
        if len(held) == size:
            yield _stacked(held)
            held = []
    if held:
        yield _stacked(held)


def _stacked(samples: list[Sample]) -> Sample:
    return {name: np.stack([one[name] for one in samples]) for name in samples[0]}


def _buffered(places: NDArray[np.int64], size: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """The order in which a buffer of `size` gives what runs through it: each time one of those that it holds, by chance.

    Only places run through it here: the captures themselves are read when their turn comes, and none is held.
    """
    if size == 1:
        return places
    held = list(places[:size])
    given: list[Any] = []
    for place in places[size:]:
        number = int(rng.integers(len(held)))
        given.append(held[number])
        held[number] = place
    given += [held[number] for number in rng.permutation(len(held))]
    return np.array(given, np.int64)


def _starts(captures: CaptureSet) -> list[int]:
    """The first capture of each shard, and the number of captures; a store without shards has one a capture."""
    return captures.shard_starts if isinstance(captures, ShardedSet) else list(range(len(captures) + 1))


def _places(captures: CaptureSet, part: str | None) -> NDArray[np.int64]:
    if part is None:
        return np.arange(len(captures), dtype=np.int64)
    if not isinstance(captures, ShardedSet):
        raise InputError("Only a data set has parts.", where=str(captures.path), value=part)
    import pyarrow.compute as pc

    table = captures.table(["group", "part"])
    own = table.filter(pc.equal(table["group"], captures.group))["part"]
    places = np.flatnonzero(pc.fill_null(pc.equal(own, part), False).to_numpy()).astype(np.int64)
    if not places.size:
        raise InputError(
            "The data set has no captures of this part.", where=str(captures.path), value=part,
            allowed=", ".join(sorted({str(name) for name in pc.unique(own).to_pylist() if name})),
        )  # fmt: skip
    return places


def _worker() -> tuple[int, int]:
    """(number, count) of the workers of PyTorch's `DataLoader`, where it has started this one."""
    torch = sys.modules.get("torch.utils.data")
    info = torch.get_worker_info() if torch is not None else None
    return (0, 1) if info is None else (int(info.id), int(info.num_workers))
