"""TIFF: for each variable of a capture that is an image a file of pages, `gated-000012.counts.tif`, exact; the rest is JSON.

A page is an image (row, col), or what else a variable has; dimensions before it count the pages. Counts are uint16, flags uint8; a
complex variable has pages of its real and then of its imaginary parts. `ImageDescription` of the first page tells dimensions,
shape, dtype and units; `gated-000012.json` holds the coordinates, the attributes, and variables of a single row or dimension.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...scenes.errors import InputError
from .form import Format
from .pictures import Image, write_images
from .planes import described, image_dims, listed, planes_of
from .selection import Piece, Selection, Source
from .webdataset import plain_attributes

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["TIFF"]

Array = np.ndarray[Any, Any]


def _write(piece: Piece, paths: list[Path]) -> None:
    place = piece.places[0]
    capture = piece.source.load(place)
    facts = piece.source.facts(place)
    paged = _paged(capture)
    for name, path in zip(paged, paths, strict=False):
        where = f"{piece.source.captures.path}: capture {facts['capture']}: {name}"
        write_images(path, _pages(capture, name, where), together=False)
    others = {str(name): capture[name] for name in capture.variables if name not in paged}
    told = {
        "facts": facts, "attributes": plain_attributes(capture.attrs), "pages": described({n: capture[n] for n in paged}),
        "values": {name: described({name: one})[name] | {"values": listed(one.values)} for name, one in others.items()},
    }  # fmt: skip
    paths[-1].write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


def _pages(capture: xr.Dataset, name: str, where: str) -> list[Image]:
    variable = capture[name]
    values = np.asarray(variable.values)
    dims = list(map(str, variable.dims))
    parts = [values.real, values.imag] if values.dtype.kind == "c" else [values]
    cut = [planes_of(name, dims, _storable(part, where)) for part in parts]
    about = described({name: variable})[name]
    told = {
        # Another name than "shape": tifffile would take the text for its own.
        "variable": name, "sizes": about.pop("shape"), **about, "page_dims": list(cut[0].dims),
        "pages_over": [*(["part: real, imaginary"] if len(cut) > 1 else []), *cut[0].over],
    }  # fmt: skip
    text = json.dumps({"beambench": told})
    return [
        Image(page[:, :, None], ["Y"], attributes={} if number else {"ImageDescription": text})
        for number, page in enumerate(page for planes in cut for page in planes.values)
    ]


def _paged(capture: xr.Dataset) -> list[str]:
    """Variables of more than one row: OpenImageIO 3.2 does not read a single row of float64 as it is."""
    planes = {str(name): [capture.sizes[dim] for dim in image_dims(list(map(str, one.dims)))]
              for name, one in capture.data_vars.items()}  # fmt: skip
    return [name for name, sizes in planes.items() if len(sizes) == 2 and sizes[0] > 1]


def _storable(values: Array, where: str) -> Array:
    """Values of a type that TIFF has, exact. Raises InputError for whole numbers of more than 32 bits."""
    if values.dtype == bool:
        return values.astype(np.uint8)
    if values.dtype.kind in "iu" and values.dtype.itemsize == 8:
        if values.size and (int(values.min()) < -(2**31) or int(values.max()) >= 2**31):
            raise InputError(
                "TIFF has whole numbers of 32 bits.", where=where, value=int(values.max()), allowed="-2³¹ … 2³¹ − 1",
                next_step="export to netcdf or webdataset",
            )  # fmt: skip
        return values.astype(np.int32)
    return values.astype(np.float32) if values.dtype == np.float16 else values


def _pieces(selection: Selection, per_file: int | None, key: str) -> list[Piece]:
    return selection.single({one.name: _suffixes(one) for one in selection.sources})


def _suffixes(source: Source) -> list[str]:
    first = next(place for places in source.parts.values() for place in places)
    return [*(f".{name}.tif" for name in _paged(source.load(first))), ".json"]


TIFF = Format(_pieces, _write, packed=False)
