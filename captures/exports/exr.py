"""OpenEXR: one file a capture, a part for each size of image, channels of 32 bits named `counts.0003`, `truth_range.Z`.

Counts of 16 bits are exact in float32 (24 bits of significand), whole numbers up to 2²⁴ too; float64 is rounded to float32, 6·10⁻⁸
of its value, and the attribute `beambench:rounded` names what was. Coordinates and the declared rig are attributes, as JSON.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...scenes.errors import InputError
from .form import Format
from .pictures import Image, write_images
from .planes import Planes, coordinates_of, described, planes_of
from .selection import Piece, Selection
from .webdataset import plain_attributes

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["EXR"]

Array = np.ndarray[Any, Any]
#: Whole numbers up to this are exact in float32.
_EXACT = 2**24


def _write(piece: Piece, paths: list[Path]) -> None:
    capture = piece.source.load(piece.places[0])
    told = piece.source.facts(piece.places[0])
    write_images(
        paths[0], images_of(capture, told, f"{piece.source.captures.path}: capture {told['capture']}"), together=True
    )


def images_of(capture: xr.Dataset, facts: dict[str, Any], where: str) -> list[Image]:
    """The parts of a capture's file. Raises InputError for a whole number that float32 cannot hold."""
    groups: dict[tuple[str, ...], list[tuple[str, Array]]] = {}
    rounded: list[str] = []
    for name, variable in capture.data_vars.items():
        values = np.asarray(variable.values)
        if values.dtype in (np.float64, np.complex128):
            rounded.append(str(name))
        whole = variable.attrs.get("units", ""), str(name)
        for label, part in _real(str(name), values):
            planes = planes_of(label, list(map(str, variable.dims)), _single(part, f"{where}: {whole[1]}"))
            groups.setdefault(planes.dims, []).extend(_channels(planes))
    data = {str(name): one for name, one in capture.data_vars.items()}
    about = {
        "beambench:facts": json.dumps(facts), "beambench:attributes": json.dumps(plain_attributes(capture.attrs)),
        "beambench:coordinates": json.dumps(coordinates_of(capture)),
        "beambench:variables": json.dumps(described(data)), "beambench:rounded": " ".join(rounded),
    }  # fmt: skip
    images: list[Any] = []
    for dims, channels in groups.items():
        channels = sorted(channels)  # OpenEXR sorts them
        values = np.stack([one for _, one in channels], axis=-1)
        images.append(Image(values, [name for name, _ in channels], "-".join(dims), {} if images else about))
    return images


def _real(name: str, values: Array) -> list[tuple[str, Array]]:
    return (
        [(f"{name}_real", values.real), (f"{name}_imag", values.imag)] if values.dtype.kind == "c" else [(name, values)]
    )


def _single(values: Array, where: str) -> Array:
    if values.dtype.kind in "iu" and values.size and max(abs(int(values.min())), abs(int(values.max()))) > _EXACT:
        raise InputError(
            "OpenEXR has numbers of 32 bits, in which this whole number is not exact.", where=where,
            value=int(values.max()), allowed=f"up to {_EXACT}", next_step="export to netcdf or webdataset",
        )  # fmt: skip
    return values.astype(np.float32)


def _channels(planes: Planes) -> list[tuple[str, Array]]:
    """A single plane is a depth, as other programs call it: NAME.Z."""
    labels = planes.labels() if planes.over else [f"{planes.name}.Z"]
    return list(zip(labels, planes.values, strict=True))


def _pieces(selection: Selection, per_file: int | None, key: str) -> list[Piece]:
    return selection.single({one.name: (".exr",) for one in selection.sources})


EXR = Format(_pieces, _write, packed=False)
