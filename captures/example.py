"""A small valid capture of arbitrary numbers, for tests of readers, writers and plug-ins. It is not physics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from .build import make_capture
from .layouts import layout_of
from .layouts.schema import FIXED_SIZES, Variable

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["example_capture"]

_SIZES = {
    "slice": 6, "row": 5, "col": 7, "channel": 3, "shot": 4, "sample": 32, "pulse_sample": 16, "frequency": 2, "phase": 4,
    "frame": 3, "return": 2, "survey": 1, "lenslet": 9, "mode": 8, "pupil_row": 6, "pupil_col": 6,
    "image_row": 6, "image_col": 6, "gate": 2, "layer": 1,
}  # fmt: skip


def example_capture(
    modality: str,
    *,
    seed: int = 0,
    sizes: Mapping[str, int] | None = None,
    optional: bool = True,
    channel: bool = False,
) -> xr.Dataset:
    """A valid capture of `modality` with random values and truth of kind "rendered".

    Main arguments:
        modality: a name in `captures.layouts.LAYOUTS`. seed: random seed; equal arguments give equal bits.
    Other arguments:
        sizes: lengths of dimensions that replace the defaults, e.g. {"row": 64}.
        optional: whether the capture has the optional variables.
        channel: whether variables with an optional last dimension `channel` have it.

    Raises InputError for an unknown modality.
    """
    rng = np.random.default_rng(seed)
    schema = layout_of(modality).by_name
    lengths = _SIZES | FIXED_SIZES | dict(sizes or {})
    groups: dict[str, dict[str, Any]] = {"data": {}, "coord": {}, "truth": {}}
    for variable in schema.values():
        if variable.required or optional:
            dims = (*variable.dims, "channel") if channel and variable.channel else variable.dims
            groups[variable.role][variable.name] = _values(variable, tuple(lengths[dim] for dim in dims), rng)
    attrs = {
        "rig": {
            "schema": 1,
            "kind": modality,
            "name": "example",
            "gates": [{"step_s": 1e-10, "value": [0.0, 1.0, 0.0]}],
        },
        "truth_scene": {"name": "example", "note": "random numbers, no scene"},
        "truth_kind": "rendered",
        "truth_materials": ["a", "b"],
        "capture_key": seed,
        "seed": seed,
        "provenance": {"arguments": {"seed": seed}},
        "fidelity": {"rung": "none"},
    }
    return make_capture(modality, groups["data"], groups["coord"], groups["truth"], attrs)


def _values(variable: Variable, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray[Any, Any]:
    dtype = np.dtype(variable.dtypes[0])
    if variable.name in ("delay", "time", "pulse_time", "frequency", "phase"):
        return np.broadcast_to(1e-9 * np.arange(shape[0]), shape).astype(dtype)
    if variable.name == "gate":
        return np.zeros(shape, dtype)
    if dtype.kind == "b":
        return np.asarray(rng.random(shape) < 0.7)
    if dtype.kind == "c":
        return np.asarray(rng.normal(size=shape) + 1j * rng.normal(size=shape), dtype)
    if dtype.kind in "iu":
        return rng.poisson(40.0, shape).astype(dtype)
    return rng.uniform(0.5, 4.0, shape).astype(dtype)
