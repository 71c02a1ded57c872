"""A format of exports: how captures are shared out to files, and how a file is written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .place import Place
from .selection import Piece, Selection

__all__ = ["Format"]


@dataclass(frozen=True)
class Format:
    """How captures become files.

    Main arguments:
        pieces: (selection, captures of a file or None, id of the export) -> the pieces in their order.
        write: (piece, temporary paths of its files) -> what is told of each capture, or None.
    Other arguments:
        packed: several captures share a file, so that their number can be chosen.
        more: (selection, place, id) -> {name: content} of files about all.
        ready: raises InputError where a package is missing.
    """

    pieces: Callable[[Selection, int | None, str], list[Piece]]
    write: Callable[[Piece, list[Path]], list[dict[str, Any]] | None]
    packed: bool = True
    more: Callable[[Selection, Place, str], Mapping[str, bytes]] | None = None
    ready: Callable[[], None] | None = None
