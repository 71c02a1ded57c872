"""The jobs of a data set: which captures go into which shard. They depend on the data set alone, never on workers."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...scenes.errors import InputError

if TYPE_CHECKING:
    from ...scenes.datasets.draws import Draws

__all__ = ["Job", "Jobs", "identity_of", "shard_length"]

#: Decoded bytes of a shard that are aimed at, and most captures of one.
_SHARD_BYTES, _MOST = 2**26, 256


@dataclass(frozen=True)
class Job:
    """One shard: its group, its number, and the numbers of its captures in the data set."""

    group: str
    shard: int
    rows: tuple[int, ...]
    length: int
    last: bool

    def key(self, identity: str) -> str:
        """What identifies the request: a shard of another one is never taken over."""
        text = json.dumps([identity, self.group, self.shard, list(self.rows), self.length])
        return hashlib.sha256(text.encode()).hexdigest()


class Jobs:
    """All shards of a data set, in their order.

    Main arguments:
        draws: what is drawn. lengths: captures of a whole shard, by group.

    The group of a capture is the modality of its base scene. For one modality nothing is held in memory; for several, one byte a
    capture.
    """

    def __init__(self, draws: Draws, lengths: Mapping[str, int]) -> None:
        self.draws, self.lengths = draws, dict(lengths)
        self.names = groups_of(draws)
        self._of: NDArray[np.uint8] | None = None
        if len(self.names) > 1:
            repeats = draws.data.repeats
            draw = [self.names.index(str(draws.scenes[draws.base(k)]["rig"]["kind"]))
                    for k in range(math.ceil(draws.data.captures / repeats))]  # fmt: skip
            self._of = np.repeat(np.array(draw, np.uint8), repeats)[: draws.data.captures]

    def count(self, group: str) -> int:
        """Number of captures of a group."""
        if self._of is None:
            return self.draws.data.captures
        return int(np.count_nonzero(self._of == self.names.index(group)))

    def first(self, group: str) -> int | None:
        """The first capture of a group; None for one that no draw has."""
        if self._of is None:
            return 0
        own = np.flatnonzero(self._of == self.names.index(group))
        return int(own[0]) if own.size else None

    def __len__(self) -> int:
        return sum(math.ceil(self.count(group) / self.lengths[group]) for group in self.names if self.count(group))

    def __iter__(self) -> Iterator[Job]:
        for group in self.names:
            own = None if self._of is None else np.flatnonzero(self._of == self.names.index(group))
            count = self.count(group)
            if not count:
                continue
            length = self.lengths[group]
            for shard, begin in enumerate(range(0, count, length)):
                end = min(begin + length, count)
                rows = range(begin, end) if own is None else (int(n) for n in own[begin:end])
                yield Job(group, shard, tuple(rows), length, end == count)


def groups_of(draws: Draws) -> list[str]:
    """Names of the groups: the modalities of the base scenes, in the order of the file."""
    return list(dict.fromkeys(str(draws.scenes[one.label]["rig"]["kind"]) for one in draws.data.scenes))


def shard_length(decoded_bytes: int, arrays: int, captures: int) -> int:
    """Captures of a shard.

    About 64 MiB, at most 256, at most an eighth of a small data set, so that two workers have work; but so many that a capture
    has at most two files (one for each array and two receipts a shard).
    """
    wanted = min(_SHARD_BYTES // max(decoded_bytes, 1), _MOST, math.ceil(captures / 8))
    return max(wanted, math.ceil((arrays + 2) / 2), 1)


def identity_of(draws: Draws) -> str:
    """sha256 of all that the captures depend on but their number: a data set may grow.

    Raises InputError for a file of a scene that cannot be read.
    """
    from ...captures.sources import bare_scene, source_files

    data = draws.data.model_dump(mode="json", exclude={"captures", "title", "licence", "description", "citation"})
    scenes: dict[str, Any] = {name: [bare_scene(one), source_files(one)] for name, one in draws.scenes.items()}
    for entry in data["scenes"]:
        entry.pop("scene")
    try:
        return hashlib.sha256(json.dumps([data, scenes], sort_keys=True).encode()).hexdigest()
    except (TypeError, ValueError) as error:
        raise InputError("The data set cannot be written as JSON.", where="data set", value=str(error)) from error
