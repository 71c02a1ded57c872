"""One size for all captures of a data set, where what a capture shows decides the size of a dimension.

A row of a laser line may show several returns: one, or two where a step hides part of the sheet. The truth is as long as the most
of one capture, and arrays of many captures need one length. What is missing is filled up as in rows with fewer returns: by NaN.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..scenes.errors import InputError
from .layouts import layout_of

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["padded", "padded_as"]


def padded(capture: xr.Dataset, where: str) -> xr.Dataset:
    """The capture with the sizes of its modality's `Layout.padded`: NaN, 0 or False behind what it has.

    Raises InputError, with `where` for its place, if it shows more than fits.
    """
    layout = layout_of(str(capture.attrs["modality"]))
    for dim, size in layout.padded.items():
        have = capture.sizes.get(dim, size)
        if have > size:
            raise InputError(
                f"The capture shows more along {dim!r} than a data set of its modality holds.", where=where, value=have,
                allowed=f"{size} or fewer",
                next_step="draw scenes that hide less from the camera, or generate such scenes one by one",
            )  # fmt: skip
        if have == size:
            continue
        longer = {}
        for name, variable in capture.variables.items():
            if dim in variable.dims:
                fill = np.nan if variable.dtype.kind == "f" else variable.dtype.type(0)
                widths = [(0, size - have if own == dim else 0) for own in variable.dims]
                values = np.pad(variable.values, widths, constant_values=fill)
                longer[name] = (variable.dims, values, variable.attrs, variable.encoding)
        capture = capture.drop_vars([*longer]).assign(longer)[list(capture.variables)].assign_attrs(capture.attrs)
    return capture


def padded_as(like: xr.Dataset, capture: xr.Dataset, where: str) -> xr.Dataset:
    """The capture with the sizes of one of a data set, where `like`, which it is compared with, has these. Raises as `padded`."""
    sizes = layout_of(str(capture.attrs["modality"])).padded
    same = {str(like.attrs.get("modality")), str(capture.attrs["modality"])}
    longer = any(like.sizes.get(dim) == size > capture.sizes.get(dim, size) for dim, size in sizes.items())
    return padded(capture, where) if longer and len(same) == 1 else capture
