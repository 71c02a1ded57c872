"""Recordings of other programs as captures: the mapping's arrays, and what the estimators' registrations find in them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ...captures.imports.assemble import assembled
from ...captures.imports.mapping import Mapping, load_mapping
from ...estimators.calibration.registrations import registration_of

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["imported_captures", "mappings_of"]


def mappings_of(source: str | Path) -> dict[str, Mapping]:
    """{name: mapping}: of a collection all, else the one. Raises InputError."""
    found = load_mapping(source)
    if not found.collection:
        return {Path(source).stem: found}
    # Members of a file lie beside it; those of the library are named.
    folder = Path(source).parent if Path(source).suffix == ".toml" else None
    return {name: load_mapping(folder / f"{name}.toml" if folder else name) for name in found.collection}


def imported_captures(mapping: Mapping, files: Sequence[str | Path], name: str = "") -> Iterator[xr.Dataset]:
    """The captures of a mapping (no collection), one by one. Raises InputError."""
    asked = mapping.rig.register_ if mapping.rig is not None else ""
    register = registration_of(asked) if asked else None
    return assembled(mapping, tuple(Path(one).expanduser() for one in files), register, name=name)
