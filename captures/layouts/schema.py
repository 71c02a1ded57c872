"""The contract that the captures of all modalities share: versions, attributes, and how a variable is described.

A capture in memory is one `xarray.Dataset` without a `capture` dimension; a store always has it in front. Changing a
table on this page, or a layout beside it, bumps `SCHEMA_VERSION`, and files of another version are refused.
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
        dtypes: allowed dtypes; the first is what other numbers are turned into.
        units: allowed units; the first is the usual one. "1" is dimensionless.
        long_name: what it is, for people.
    Other arguments:
        role: "data", "coord" or "truth".
        required: whether each capture has it (truth of a recorded capture is then filled with NaN).
        channel: whether a last dimension `channel` may follow.
        also: other allowed dims.
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
        """Each tuple of dims that the variable may have."""
        plain = (self.dims, *self.also)
        return (*plain, *((*dims, "channel") for dims in plain)) if self.channel else plain
