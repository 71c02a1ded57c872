"""Captures of a sealed suite: given away without truth, and made again from the key when answers to them are scored."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...scenes.errors import InputError
from ...scenes.json_keys import read_json
from ..suites.sealed import Key

if TYPE_CHECKING:
    import xarray as xr

    from ...captures import CaptureSet
    from ..suites.spec import Draw
    from ..suites.suite import Cell

__all__ = ["Seal", "making_again", "seal_of"]

#: Makes a sealed capture again, with its truth: (its place in the store, what the store holds) -> (cell, capture, draws).
Again = Callable[[int, "xr.Dataset"], "tuple[Cell, xr.Dataset, tuple[Draw, ...]]"]


@dataclass(frozen=True)
class Seal:
    """What a sealed capture says of its making: the name of the key, suite and scene, and the number of its seed."""

    key: str
    suite: str
    scene: str
    number: int

    def provenance(self) -> dict[str, Any]:
        """The attribute `provenance` of the capture."""
        return {"sealed": asdict(self)}


def seal_of(attrs: Mapping[str, Any]) -> Seal | None:
    """The seal that a capture's attributes hold; None where there is none."""
    try:
        held = read_json(str(attrs.get("provenance", "{}")))["sealed"]
        return Seal(str(held["key"]), str(held["suite"]), str(held["scene"]), int(held["number"]))
    except (KeyError, TypeError, ValueError):
        return None


def making_again(captures: CaptureSet, key: Key, suite: str | Path | None) -> Again:
    """A function that makes the captures of a sealed store again, with truth, and refuses one that differs from the store's.

    Main arguments:
        captures: the store. key: the organiser's. suite: the suite, where the store's name of it is no built-in one.

    Raises:
        InputError: the store is not sealed, or with another key; the suite is unknown or another one; the captures differ.
    """
    from ...generator.generate import generate
    from ..suites.suite import CELL_NONE, cells_of, load_suite

    where = str(captures.path)
    first = seal_of(captures.attributes(0))
    if first is None:
        raise InputError("The captures are not sealed.", where=where, next_step="score them without --sealed")
    if first.key != key.name:
        raise InputError("The captures were sealed with another key.", where=where, value=key.name, allowed=first.key)
    loaded = load_suite(suite if suite is not None else first.suite)
    if loaded.suite.suite != first.suite:
        raise InputError("This is another suite.", where="--suite", value=loaded.suite.suite, allowed=first.suite)
    cells = {(cell.scene_name, cell.seed): cell for cell in cells_of(loaded, key=key) if cell.stress == CELL_NONE}

    def again(index: int, held: xr.Dataset) -> tuple[Cell, xr.Dataset, tuple[Draw, ...]]:
        seal = seal_of(held.attrs)
        cell = cells.get((seal.scene, seal.number)) if seal is not None and seal.key == key.name else None
        if cell is None:
            raise InputError("The suite has no such sealed capture.", where=f"{where}, capture {index}", value=seal)
        rung: Any = cell.fidelity
        capture = generate(
            cell.scene, seed=cell.random_seed, capture_key=cell.key, fidelity=rung, rtol=loaded.suite.rtol
        )
        _check_equal(capture, held, f"{where}, capture {index}")
        return cell, capture, loaded.draws(cell.scene_name)

    return again


def _check_equal(made: xr.Dataset, held: xr.Dataset, where: str) -> None:
    """Refuse a capture of the store that is not, bit by bit, the one that the key gives."""
    from ...captures.hide import hide_truth

    one, other = hide_truth(made), hide_truth(held)
    if not one.identical(other):
        names = [str(name) for name in one.variables if name not in other or not one[name].equals(other[name])]
        raise InputError(
            "A capture is not the one that the key gives.", where=where, value=", ".join(names) or "rig",
            allowed="equal data, made by equal versions on equal processors",
            next_step="make the captures again with this version: beambench generate SUITE --sealed KEYFILE",
        )  # fmt: skip
