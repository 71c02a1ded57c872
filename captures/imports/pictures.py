"""PNG, TIFF and EXR: (row, col), (row, col, channel), or (page, row, col[, channel]) of a TIFF of several pages.

Values are those of the file: no gamma, no scaling to 0 … 1.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...scenes.readers.png import png_damage
from .recording import MOST_BYTES, Array, Recording, check_bytes

__all__ = ["read_picture", "read_png"]

#: Most pages of a TIFF.
_MOST_PAGES = 65536
_DTYPES = {
    "uint8": np.uint8, "uint16": np.uint16, "uint32": np.uint32, "int8": np.int8, "int16": np.int16, "int32": np.int32,
    "half": np.float16, "float": np.float32, "double": np.float64,
}  # fmt: skip


def read_png(path: Path) -> Recording:
    """A PNG whose check sums are right. Raises ValueError."""
    if path.stat().st_size > MOST_BYTES:
        raise ValueError("the file is too large")
    if damage := png_damage(path.read_bytes()):
        raise ValueError(damage)
    return read_picture(path)


def read_picture(path: Path) -> Recording:
    """All pages of a picture, which must be of one size. Raises ValueError."""
    import OpenImageIO as oiio

    file = oiio.ImageInput.open(str(path))
    if file is None:
        raise ValueError(oiio.geterror() or "it is no picture")
    try:
        pages: list[Array] = []
        first = file.spec()
        header: dict[str, Any] = {
            name: first[name] for name in ("DateTime", "ExposureTime", "Software") if first.getattribute(name)
        }
        while file.seek_subimage(len(pages), 0):
            spec = file.spec()
            dtype = _DTYPES.get(str(spec.format))
            shape = (spec.height, spec.width, spec.nchannels)
            if dtype is None or spec.depth > 1:
                raise ValueError(f"values of the kind {spec.format}")
            if pages and (pages[0].shape != shape or pages[0].dtype != dtype):
                raise ValueError(f"page {len(pages)} is {shape} {spec.format}, not as the first")
            check_bytes((len(pages) + 1, *shape), np.dtype(dtype).itemsize)
            pixels = file.read_image(len(pages), 0, 0, spec.nchannels, spec.format)
            if pixels is None or file.has_error or np.shape(pixels) != shape:
                raise ValueError(file.geterror() or f"page {len(pages)} cannot be read")
            pages.append(np.asarray(pixels, dtype))
            if len(pages) > _MOST_PAGES:
                raise ValueError(f"more than {_MOST_PAGES} pages")
    finally:
        file.close()
    stack = np.stack(pages)
    axes = ("page", "row", "col", "channel")
    drop = tuple(axis for axis in (3, 0) if stack.shape[axis] == 1)
    stack = stack.squeeze(axis=drop)
    return Recording({"image": stack}, tuple(a for i, a in enumerate(axes) if i not in drop), header)
