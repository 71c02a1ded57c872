"""The part of a capture that an estimator may read: an allow-list, rebuilt from plain arrays, with no path to the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .layouts import layout_of

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["VISIBLE_ATTRIBUTES", "hide_truth", "hide_truth_but_ranges", "sealed"]

VISIBLE_ATTRIBUTES = ("schema_version", "modality", "rig", "averaged")
"""The attributes that an estimator may read: the declared instrument. The seed is hidden, as the noise follows from it."""


def hide_truth(capture: xr.Dataset) -> xr.Dataset:
    """A new dataset in memory with the layout's data and coordinates, without truth, and with `VISIBLE_ATTRIBUTES`.

    Nothing else is copied: no encodings (an encoding's `source` reopens the store), and no attributes of variables except
    `units` and the layout's `long_name`. An array is a read-only view if its memory holds nothing else, otherwise a copy.
    Raises InputError for an unknown modality.
    """
    import xarray as xr

    schema = layout_of(capture.attrs.get("modality")).by_name
    data: dict[str, xr.Variable] = {}
    coords: dict[str, xr.Variable] = {}
    for name, variable in schema.items():
        if variable.role == "truth" or name.startswith("truth_") or name not in capture.variables:
            continue
        original = capture.variables[name]
        units = original.attrs.get("units")
        attrs = {
            "units": units if units in variable.units else variable.units[0],
            "long_name": variable.long_name,
        }
        group = coords if variable.role == "coord" else data
        group[name] = xr.Variable(tuple(str(d) for d in original.dims), sealed(np.asarray(original.values)), attrs)
    attributes = {name: capture.attrs[name] for name in VISIBLE_ATTRIBUTES if name in capture.attrs}
    return xr.Dataset(data, coords, attributes)


def hide_truth_but_ranges(capture: xr.Dataset) -> xr.Dataset:
    """As `hide_truth`, with the ranges of the target where the capture states whence they are (`truth_kind`): a laboratory
    calibrates on a target that it has surveyed. No estimator is given this."""
    hidden = hide_truth(capture)
    kind = capture.attrs.get("truth_kind", "none")
    if kind == "none" or "truth_range" not in capture:
        return hidden
    return hidden.assign(truth_range=capture["truth_range"].load()).assign_attrs(truth_kind=kind)


def sealed(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """A read-only array of equal values whose chain of bases holds no memory beyond its own."""
    root: Any = array
    while isinstance(root, np.ndarray) and root.base is not None:
        root = root.base
    # A view of a mapped file or of a larger buffer would lead to the hidden values through `base`.
    private = type(root) is np.ndarray and root.nbytes == array.nbytes and root.base is None
    result = array.view(np.ndarray) if private else np.array(array, order="C", copy=True)
    result.flags.writeable = False
    return result
