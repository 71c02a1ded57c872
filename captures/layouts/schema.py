"""The part of the layout that all modalities share: version, attributes, and the description of a variable.

A capture in memory is an `xarray.Dataset` without the dimension `capture`, which is always the first one in a store. A
change to a table in this file, or to a layout, needs a new `SCHEMA_VERSION`; files of another version are refused.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "ATTRIBUTES",
    "FIXED_SIZES",
    "JSON_ATTRIBUTES",
    "SCHEMA_VERSION",
    "TRUTH_KINDS",
    "Variable",
]

SCHEMA_VERSION = 1

TRUTH_KINDS = ("none", "rendered", "surveyed", "reference-instrument", "reference-algorithm")

JSON_ATTRIBUTES = ("rig", "truth_scene", "provenance", "fidelity", "truth_materials")
"""Attributes that hold a JSON text. `truth_materials` lists the names of the codes in `truth_material`."""

ATTRIBUTES = {
    "schema_version": "version of this contract",
    "modality": "what kind of instrument the capture is of: a name in `captures.layouts.LAYOUTS`",
    "truth_kind": "where the truth comes from",
    "rig": "JSON: the instrument as declared, all that a laboratory would know",
    "truth_scene": "JSON: the scene that was really used",
    "truth_materials": "JSON: names of the codes in truth_material",
    "capture_key": "the capture's key in the tree of random streams",
    "seed": "the seed of the random streams",
    "provenance": "JSON: versions, CPU features and arguments to regenerate",
    "fidelity": "JSON: rung, effects modelled and neglected with their predicted size",
    "averaged": "True where counts are float32 means of several exposures",
}

FIXED_SIZES = {"xyz": 3, "axis": 2, "pose_element": 6}
"""Sizes that do not depend on the instrument. `pose_element`: x, y, z in m, then a rotation vector in rad."""


@dataclass(frozen=True)
class Variable:
    """One variable of a capture.

    Main arguments:
        name, dims: name and dimensions, without `capture`.
        dtypes: allowed dtypes; arrays of other dtypes are converted to the first.
        units: allowed units; the first is the default. "1" is dimensionless.
        long_name: description in a few words.
    Other arguments:
        role: "data", "coord" or "truth".
        required: whether every capture has the variable (missing truth of a recorded capture is filled with NaN).
        channel: whether a last dimension `channel` is allowed.
        also: further allowed tuples of dimensions.
    """

    name: str
    dims: tuple[str, ...]
    dtypes: tuple[str, ...]
    units: tuple[str, ...]
    long_name: str
    role: str = "data"
    required: bool = True
    channel: bool = False
    also: tuple[tuple[str, ...], ...] = ()

    @property
    def allowed_dims(self) -> tuple[tuple[str, ...], ...]:
        """Every allowed tuple of dimensions."""
        plain = (self.dims, *self.also)
        return (*plain, *((*dims, "channel") for dims in plain)) if self.channel else plain
