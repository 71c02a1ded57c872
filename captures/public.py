"""A capture as others may have it: what an estimator is given, and nothing that tells how it was made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from .build import make_capture
from .hide import hide_truth
from .layouts import layout_of

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["without_truth"]


def without_truth(capture: xr.Dataset, provenance: Mapping[str, Any]) -> xr.Dataset:
    """A capture of the same layout that holds no truth: `truth_kind` is "none", and truth is NaN.

    Main arguments:
        capture: any capture. provenance: what the result says of its making.

    Raises:
        InputError: the capture breaks its layout.
    """
    hidden = hide_truth(capture)
    modality = str(capture.attrs["modality"])
    schema = layout_of(modality).by_name
    groups: dict[str, dict[str, Any]] = {"data": {}, "coord": {}}
    for name, variable in hidden.variables.items():
        groups[schema[str(name)].role][str(name)] = hidden[str(name)] if variable.dims else variable.values[()]
    attrs = {"rig": capture.attrs["rig"], "truth_kind": "none", "provenance": dict(provenance)}
    if "averaged" in capture.attrs:
        attrs["averaged"] = capture.attrs["averaged"]
    return make_capture(modality, groups["data"], groups["coord"], {}, attrs)
