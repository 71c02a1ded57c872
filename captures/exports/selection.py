"""What is exported: the captures of a store or of a part of a data set, some of their variables, with or without truth."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...scenes.errors import InputError
from ..hide import VISIBLE_ATTRIBUTES
from ..layouts import layout_of
from ..store.faces import open_captures, sharded_place
from ..store.reader import CaptureSet
from ..store.shard_finish import read_request
from ..store.shard_manifest import load_sharded
from ..store.shard_set import ShardedSet, open_sharded

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Piece", "Selection", "Source", "select"]

#: A name that becomes a part of a file's name or a folder: it comes from a file, and must lead nowhere else.
_WORD = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.\-]{0,200}")
#: What is told of a capture where its truth is left out.
_OPEN_FACTS = ("capture", "part")


@dataclass(frozen=True)
class Source:
    """The captures of one modality that are exported.

    Main arguments:
        name: of the group, the beginning of its files' names. captures: the store. names: the variables, in their order.
        parts: {part of the split, "" without one: places in the store, ascending}.
    Other arguments:
        truth: whether the truth is exported.
    """

    name: str
    captures: CaptureSet
    names: tuple[str, ...]
    parts: dict[str, list[int]]
    truth: bool = True

    @property
    def count(self) -> int:
        """Number of captures."""
        return sum(map(len, self.parts.values()))

    @property
    def bytes_each(self) -> int:
        """Bytes of one capture in memory; all captures of a store have one layout."""
        first = next(place for places in self.parts.values() for place in places)
        return int(sum(one.nbytes for one in self.captures.load(first, self.names).variables.values()))

    def load(self, place: int) -> xr.Dataset:
        """One capture: the chosen variables, and all attributes, or those that an estimator may read. Raises InputError."""
        capture = self.captures.load(place, self.names)
        if not self.truth:
            capture.attrs = {name: capture.attrs[name] for name in VISIBLE_ATTRIBUTES if name in capture.attrs}
        return capture

    def facts(self, place: int) -> dict[str, Any]:
        """What is known of one capture beside its variables: its number, and of a data set its part and what was drawn."""
        if not isinstance(self.captures, ShardedSet):
            return {"capture": place, "part": ""}
        found = dict(self.captures.index(place))
        found["drawn"] = found.pop("values", {})
        return found if self.truth else {name: found[name] for name in _OPEN_FACTS if name in found}

    def number(self, place: int) -> int:
        """The number of a capture in its data set, or its place in a store."""
        return int(self.captures.index(place)["capture"]) if isinstance(self.captures, ShardedSet) else place


@dataclass(frozen=True)
class Piece:
    """What is written at once: files, whose names are relative to the export, and the captures that they hold."""

    files: tuple[str, ...]
    source: Source
    part: str
    places: tuple[int, ...]


@dataclass(frozen=True)
class Selection:
    """All that is exported. `sha256` identifies the store; `about` is what its data set says of itself, as texts."""

    path: Path
    sha256: str
    sources: tuple[Source, ...]
    about: Mapping[str, Any] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of captures."""
        return sum(one.count for one in self.sources)

    def packed(self, suffix: str, per_file: int | None, bytes_per_file: int, stem: str = "") -> list[Piece]:
        """Pieces of one file each: the captures of a part in their order, so many a file, about `bytes_per_file` by default."""
        pieces = []
        for source in self.sources:
            length = per_file or max(1, min(10_000, bytes_per_file // max(1, source.bytes_each)))
            for part, places in source.parts.items():
                for number in range(math.ceil(len(places) / length)):
                    own = tuple(places[number * length : (number + 1) * length])
                    name = f"{source.name}{stem}-{number:06d}{suffix}"
                    pieces.append(Piece((f"{part}/{name}" if part else name,), source, part, own))
        return pieces

    def single(self, suffixes: Mapping[str, Sequence[str]]) -> list[Piece]:
        """Pieces of one capture each, with a file for each suffix of its source."""
        return [
            Piece(
                tuple(
                    f"{part}/{source.name}-{source.number(place):06d}{suffix}"
                    if part
                    else f"{source.name}-{source.number(place):06d}{suffix}"
                    for suffix in suffixes[source.name]
                ),
                source,
                part,
                (place,),
            )
            for source in self.sources
            for part, places in source.parts.items()
            for place in places
        ]


def select(
    path: Path, *, part: str | None = None, variables: Sequence[str] | None = None, truth: bool = True
) -> Selection:
    """What is to be exported from a store, a data set, or DIR/GROUP of one.

    Main arguments:
        path: the store.
    Other arguments:
        part: of the data set's split; all if None. variables: names; all if None. truth: whether variables, attributes and what
            was drawn that tell the truth are exported.

    Raises:
        InputError: no such store, part or variable; damaged metadata; a name that cannot be that of a file.
    """
    root = path.expanduser()
    place = sharded_place(root)
    sets: list[CaptureSet]
    about: dict[str, Any] = {}
    if place is None or place[0].name.endswith(".partial"):
        sets = [open_captures(root)]
    else:
        names = [place[1]] if place[1] else list(load_sharded(place[0]).groups)
        sets = [open_sharded(place[0], name) for name in names]
        about = _about(place[0])
    chosen = _chosen(sets, variables, truth, root)
    sources = []
    for one, wanted in zip(sets, chosen, strict=True):
        name = one.group if isinstance(one, ShardedSet) else one.modality
        parts = _parts(one, part)
        if parts:
            sources.append(Source(_word(name, root), one, tuple(_word(w, root) for w in wanted), parts, truth))
    if not sources:
        raise InputError(
            "The data set has no captures of this part.", where=str(root), value=part,
            allowed=", ".join(sorted({name for one in sets for name in _parts(one, None)})) or "no parts: leave it out",
        )  # fmt: skip
    return Selection(root, sets[0].sha256, tuple(sources), about)


def _about(root: Path) -> dict[str, Any]:
    """What the data set's file says of it, and its name and version. Raises InputError."""
    request = read_request(root)
    data = request.get("dataset")
    data = data if isinstance(data, dict) else {}
    names = ("title", "licence", "description", "citation")
    about = {name: str(data.get(name, "")) for name in names}
    return about | {"name": str(request.get("name", "")), "version": int(request.get("version", 1))}


def _chosen(
    sets: Sequence[CaptureSet], variables: Sequence[str] | None, truth: bool, where: Path
) -> list[tuple[str, ...]]:
    """The variables of each set that are exported."""
    known = [tuple(name for name in one.variables if truth or _visible(one.modality, name)) for one in sets]
    for name in variables or ():
        if not any(name in names for names in known):
            hidden = any(name in one.variables for one in sets)
            raise InputError(
                "This variable is of the truth, which is left out." if hidden else "The store has no such variable.",
                where=str(where), value=name, allowed=", ".join(dict.fromkeys(n for names in known for n in names)),
            )  # fmt: skip
    if variables is None:
        return known
    wanted = [tuple(name for name in names if name in set(variables)) for names in known]
    for one, names in zip(sets, wanted, strict=True):
        if not names:
            raise InputError(
                "A group of the data set has none of these variables.", where=str(where), value=list(variables),
                allowed=", ".join(one.variables), next_step="give the folder of one group, or variables of each",
            )  # fmt: skip
    return wanted


def _visible(modality: str, name: str) -> bool:
    known = layout_of(modality).by_name
    return name in known and known[name].role != "truth" and not name.startswith("truth_")


def _parts(captures: CaptureSet, part: str | None) -> dict[str, list[int]]:
    """Places by part. Raises InputError for a part of a store that has none, and for a name that leads elsewhere."""
    if not isinstance(captures, ShardedSet):
        if part is not None:
            raise InputError("Only a data set has parts.", where=str(captures.path), value=part)
        return {"": list(range(len(captures)))} if len(captures) else {}
    table = captures.table(["group", "part"])
    groups, names = (table.column(name).to_pylist() for name in ("group", "part"))
    own = np.array([name or "" for name, group in zip(names, groups, strict=True) if group == captures.group], object)
    found = {str(name): np.flatnonzero(own == name).tolist() for name in dict.fromkeys(own.tolist())}
    if len(own) != len(captures):
        raise InputError(
            "The index of the data set does not list its captures.", where=str(captures.path),
            value=len(own), allowed=str(len(captures)), next_step=f"beambench data verify {captures.path}",
        )  # fmt: skip
    kept = found if part is None else {name: places for name, places in found.items() if name == part}
    return {_word(name, captures.path) if name else "": places for name, places in kept.items()}


def _word(name: str, where: Path) -> str:
    if not _WORD.fullmatch(name) or name.startswith(".") or name in (".", ".."):
        raise InputError(
            "A name in the store cannot be that of a file.", where=str(where), value=name,
            allowed="letters, digits, _, - and dots", next_step=f"beambench data verify {where}",
        )  # fmt: skip
    return name
