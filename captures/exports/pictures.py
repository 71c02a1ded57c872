"""Files of several images by OpenImageIO: every write is checked, and a full disk is an error and never a short file."""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ...scenes.errors import InputError

__all__ = ["Image", "write_images"]

_KINDS = {
    "float32": "float", "float64": "double", "uint8": "uint8", "int8": "int8", "uint16": "uint16", "int16": "int16",
    "uint32": "uint", "int32": "int",
}  # fmt: skip


@dataclass(frozen=True)
class Image:
    """One image of a file: values (row, col, channel), names of the channels, its own name, and attributes."""

    values: np.ndarray[Any, Any]
    channels: Sequence[str]
    name: str = ""
    attributes: Mapping[str, Any] = field(default_factory=dict)


def write_images(path: Path, images: Sequence[Image], *, together: bool) -> None:
    """Write images into one file and read them back.

    Main arguments:
        path: the file; its suffix tells the format. images: in their order.
    Other arguments:
        together: all headers are stated at once, as OpenEXR demands; else each is appended.

    Raises OSError where the file cannot be written whole; InputError where the format cannot hold an image.
    """
    import OpenImageIO as oiio

    specs = [_spec(oiio, one) for one in images]
    for spec in specs if together else ():  # the parts of an OpenEXR file have one display window
        spec.full_width = max(one.width for one in specs)
        spec.full_height = max(one.height for one in specs)
    output = oiio.ImageOutput.create(str(path))
    if output is None:
        raise InputError("OpenImageIO cannot write this format.", where=str(path), value=oiio.geterror())
    opened = output.open(str(path), specs) if together else output.open(str(path), specs[0])
    _check(opened, output, path)
    try:
        for number, (image, spec) in enumerate(zip(images, specs, strict=True)):
            if number:
                _check(output.open(str(path), spec, "AppendSubimage"), output, path)
            _check(output.write_image(_plain(image.values)), output, path)
    finally:
        closed = output.close()
    _check(closed, output, path)
    _read_back(oiio, path, images)


def _spec(oiio: Any, image: Image) -> Any:
    height, width, channels = image.values.shape
    spec = oiio.ImageSpec(width, height, channels, _kind(image))
    spec.channelnames = tuple(image.channels)
    spec.attribute("compression", "zip")
    spec.attribute("DateTime", "1970:01:01 00:00:00")  # else it is the time of writing, and bytes differ
    if image.values.dtype.kind == "f":
        spec.attribute("tiff:Predictor", 1)  # few programs read the one for floats
    if image.name:
        spec.attribute("oiio:subimagename", image.name)
    for name, value in image.attributes.items():
        spec.attribute(name, value)
    return spec


def _kind(image: Image) -> str:
    """The dtype as OpenImageIO calls it: what it does not know it makes half floats, in silence."""
    return _KINDS[image.values.dtype.name]


def _plain(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Values whose strides follow from their shape, and of a type without a stated byte order: OpenImageIO minds both."""
    plain = np.empty(values.shape, values.dtype.name)
    plain[...] = values
    return plain


def _check(done: bool, output: Any, path: Path) -> None:
    if not done:
        _failed(path, str(output.geterror()))


def _failed(path: Path, told: str) -> NoReturn:
    # OpenImageIO gives a text and no errno.
    room = os.statvfs(path.parent)
    full = room.f_bavail * room.f_frsize < 2**16
    raise OSError(
        errno.ENOSPC if full else errno.EIO, os.strerror(errno.ENOSPC) if full else told or "it failed", str(path)
    )


def _read_back(oiio: Any, path: Path, images: Sequence[Image]) -> None:
    """Compare the file with what was to be written: some writers lose the last blocks on a full disk without a word."""
    found = oiio.ImageInput.open(str(path))
    if found is None:
        _failed(path, str(oiio.geterror()))
    try:
        for number, image in enumerate(images):
            values = found.read_image(number, 0, 0, len(image.channels), _kind(image))
            same = values is not None and values.size == image.values.size
            if same and len(image.channels) > 1:  # OpenImageIO gives depth last, whatever its place
                listed = list(found.spec(number, 0).channelnames)
                same = sorted(listed) == sorted(image.channels)
                values = values[..., [listed.index(name) for name in image.channels]] if same else values
            same = same and np.array_equal(
                values.reshape(image.values.shape), image.values, equal_nan=image.values.dtype.kind == "f"
            )
            if not same:
                _failed(path, f"image {number} is not as it was written: {found.geterror()}")
    finally:
        found.close()
