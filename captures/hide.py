"""What an estimator may see of a capture: an allow-list, rebuilt from plain arrays, without a way back to the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .layouts import layout_of

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["VISIBLE_ATTRIBUTES", "hide_truth", "sealed"]

VISIBLE_ATTRIBUTES = ("schema_version", "modality", "rig", "averaged")
"""All that an estimator reads beside the data: the instrument as declared. The seed would give the noise away."""


def hide_truth(capture: xr.Dataset) -> xr.Dataset:
    """A new dataset in memory with the data and coordinates of the schema that are no truth, and `VISIBLE_ATTRIBUTES`.

    Nothing else is copied: no encodings (an encoding's `source` reopens the store), no attributes of variables but
    `units` and the schema's `long_name`. Arrays are read-only views where the memory holds nothing else, otherwise
    copies. Raises InputError for an unknown modality.
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


def sealed(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """A read-only array of the same values whose chain of bases holds no other memory than its own."""
    root: Any = array
    while isinstance(root, np.ndarray) and root.base is not None:
        root = root.base
    # A mapped file or a larger buffer could be walked back to what is hidden.
    private = type(root) is np.ndarray and root.nbytes == array.nbytes and root.base is None
    result = array.view(np.ndarray) if private else np.array(array, order="C", copy=True)
    result.flags.writeable = False
    return result
