"""NetCDF-4: files with the capture as first dimension, which xarray, MATLAB, R, Julia and Panoply read.

A file holds many captures of one part and one modality; `xarray.open_mfdataset` joins them. Variables have their units and names;
flags are int8 with `dtype = "bool"`, as xarray writes and reads them; a complex variable is two, `_real` and `_imag`. Attributes of
the captures that are no numbers (the rig as JSON) are texts along `capture`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...scenes.errors import InputError
from ..hdf5 import hdf5_output
from .form import Format
from .selection import Piece, Selection, Source

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["NETCDF"]

_BYTES_PER_FILE = 2**28
#: Attributes that all captures of a store have in common.
_COMMON = ("schema_version", "modality")
Array = np.ndarray[Any, Any]


def _ready() -> None:
    try:
        import h5netcdf  # noqa: F401
    except ImportError as error:
        raise InputError(
            "Writing NetCDF needs the package h5netcdf.", where="--to", value="netcdf",
            next_step="pip install 'beambench[netcdf]'",
        ) from error  # fmt: skip


def _parts(name: str, values: Array) -> Iterator[tuple[str, Array]]:
    """A variable as NetCDF has it."""
    if values.dtype.kind == "c":
        yield f"{name}_real", values.real
        yield f"{name}_imag", values.imag
    else:
        yield name, values.astype(np.int8) if values.dtype == bool else values


def _write(piece: Piece, paths: list[Path]) -> None:
    import h5netcdf

    source = piece.source
    with hdf5_output(paths[0], track_order=True) as output:
        file = h5netcdf.File(output.h5, "r+")
        for row, place in enumerate(piece.places):
            capture = source.load(place)
            if row == 0:
                _create(file, capture, _kinds(source, piece.places, capture.attrs), len(piece.places))
            for name, variable in capture.variables.items():
                for part, values in _parts(str(name), np.asarray(variable.values)):
                    file.variables[part][row] = values
            for name, value in _told(source.facts(place), capture.attrs).items():
                file.variables[name][row] = value
            output.check()
        file.close()


def _told(facts: Mapping[str, Any], attrs: Mapping[Any, Any]) -> dict[str, Any]:
    """What varies with the capture: numbers and texts by their names in the file."""
    found = {name: _plain(value) for name, value in facts.items() if name != "drawn"}
    found |= {f"drawn_{name}": _plain(value) for name, value in facts.get("drawn", {}).items()}
    return found | {str(name): _plain(value) for name, value in attrs.items() if name not in {*_COMMON, *found}}


def _plain(value: Any) -> Any:
    """A number that a file holds, else a text: that of JSON where it is none."""
    plain = value.item() if isinstance(value, np.generic) else value
    if isinstance(plain, bool):
        return int(plain)
    if isinstance(plain, float | str) or (isinstance(plain, int) and abs(plain) < 2**63):
        return plain
    return json.dumps(plain)


def _kinds(source: Source, places: tuple[int, ...], attrs: Mapping[Any, Any]) -> dict[str, type]:
    """Text, float or int for all that `_told` gives of any of these captures. What one lacks is "" or NaN, so never an int."""
    rank: tuple[type, ...] = (int, float, str)
    found: dict[str, type] = {}
    seen: dict[str, int] = {}
    for place in places:
        own = source.captures.attributes(place)
        for name, value in _told(source.facts(place), {key: own[key] for key in own if key in attrs}).items():
            found[name] = max(found.get(name, int), type(value), key=rank.index)
            seen[name] = seen.get(name, 0) + 1
    return {name: float if kind is int and seen[name] < len(places) else kind for name, kind in found.items()}


def _create(file: Any, capture: xr.Dataset, told: Mapping[str, type], count: int) -> None:
    import h5py

    file.dimensions = {"capture": count, **{str(name): size for name, size in capture.sizes.items()}}
    for name in _COMMON:
        file.attrs[name] = capture.attrs[name]
    file.attrs["Conventions"] = "CF-1.11"
    for label, variable in capture.variables.items():
        values = np.asarray(variable.values)
        for part, own in _parts(str(label), values):
            packed = {"chunks": (1, *own.shape), "compression": "gzip", "compression_opts": 1, "shuffle": True}
            made = file.create_variable(
                part, ("capture", *map(str, variable.dims)), own.dtype, **(packed if own.size else {})
            )
            for key, text in variable.attrs.items():
                made.attrs[str(key)] = _plain(text)
            if values.dtype == bool:
                made.attrs["dtype"] = "bool"
    for name, kind in told.items():
        dtype = h5py.string_dtype() if kind is str else np.dtype("f8" if kind is float else "i8")
        empty = {} if kind is not float else {"fillvalue": np.nan}
        file.create_variable(name, ("capture",), dtype, **empty)
    file.attrs["coordinates"] = " ".join(str(name) for name in capture.coords)


def _pieces(selection: Selection, per_file: int | None, key: str) -> list[Piece]:
    return selection.packed(".nc", per_file, _BYTES_PER_FILE)


NETCDF = Format(_pieces, _write, ready=_ready)
