"""Build a capture from plain arrays. The layout gives dimensions, units and names; missing truth of recordings is NaN."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..scenes.errors import InputError
from .layouts import layout_of
from .layouts.schema import FIXED_SIZES, JSON_ATTRIBUTES, SCHEMA_VERSION, TRUTH_KINDS, Variable

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["as_json", "make_capture"]

#: Dimensions, values and attributes of a variable.
Entry = tuple[tuple[str, ...], "np.ndarray[Any, Any]", dict[str, str]]


def make_capture(
    modality: str,
    data: Mapping[str, Any],
    coords: Mapping[str, Any],
    truth: Mapping[str, Any],
    attrs: Mapping[str, Any],
) -> xr.Dataset:
    """One capture as an `xarray.Dataset` that passes `validate`.

    Main arguments:
        modality: a name in `captures.layouts.LAYOUTS`.
        data: arrays by name, e.g. `counts` (slice, row, col) in DN; optional `dark`, `flat`.
        coords: coordinates by name, e.g. `delay` (slice) in s; a scalar is repeated along the dimension.
        truth: arrays by name, each of which begins with `truth_`. With `truth_kind` "rendered" every variable that the
            layout requires must be given; otherwise missing ones are filled with NaN (codes −1, flags False).
        attrs: at least `rig` and `truth_kind`; mappings and lists become JSON texts. This function sets `schema_version`
            and `modality`. It adds `files` to `provenance`: name and sha256 of each file that `truth_scene` names. In
            `truth_scene`, the names of files lose their folders.

    An array of an allowed dtype is not copied; any other is converted to the layout's first dtype, if no value changes.
    An `xarray.DataArray` may state its `units`, one of those that the layout allows.

    Raises:
        InputError: a variable is unknown or missing, or its shape, dtype or values break the layout.
    """
    import xarray as xr

    from .validate import validate

    schema = layout_of(modality).by_name
    groups = {"data": data, "coord": coords, "truth": truth}
    _refuse_unknown(modality, schema, groups)
    attributes = _attributes(modality, _with_sources(attrs))
    arrays, sizes = _given(schema, groups)
    for variable in schema.values():
        if variable.name not in arrays:
            scalar = groups[variable.role].get(variable.name)
            filled = _filled(modality, variable, scalar, sizes, str(attributes["truth_kind"]))
            if filled is not None:
                arrays[variable.name] = (variable.dims, filled, _variable_attributes(variable, scalar))
    dataset = xr.Dataset(
        {name: entry for name, entry in arrays.items() if schema[name].role != "coord"},
        {name: entry for name, entry in arrays.items() if schema[name].role == "coord"},
        attributes,
    )
    validate(dataset, "values")
    return dataset


def _refuse_unknown(modality: str, schema: Mapping[str, Variable], groups: Mapping[str, Mapping[str, Any]]) -> None:
    for role, group in groups.items():
        allowed = [name for name, variable in schema.items() if variable.role == role]
        for name in group:
            if name not in allowed:
                raise InputError(
                    f"A {modality} capture has no {role} variable of this name.",
                    where=f"{role} {name}", value=name, allowed=", ".join(allowed),
                )  # fmt: skip


def _given(
    schema: Mapping[str, Variable], groups: Mapping[str, Mapping[str, Any]]
) -> tuple[dict[str, Entry], dict[str, int]]:
    """The given arrays, checked against each other, and the sizes of their dimensions."""
    sizes: dict[str, int] = dict(FIXED_SIZES)
    arrays: dict[str, Entry] = {}
    for variable in schema.values():
        value = groups[variable.role].get(variable.name)
        if value is None or (variable.role == "coord" and np.ndim(value) == 0):
            continue
        array = np.asarray(value)
        dims = _dims_of(variable, array)
        for dim, size in zip(dims, array.shape, strict=True):
            if sizes.setdefault(dim, size) != size:
                raise InputError(
                    f"{variable.name} does not fit the other variables along {dim}.",
                    where=variable.name, value=array.shape, allowed=f"{dim} = {sizes[dim]}",
                )  # fmt: skip
        arrays[variable.name] = (dims, _as_allowed_dtype(variable, array), _variable_attributes(variable, value))
    return arrays, sizes


def _filled(
    modality: str, variable: Variable, scalar: Any, sizes: Mapping[str, int], truth_kind: str
) -> np.ndarray[Any, Any] | None:
    """The array of a variable that was given as a number, or of missing truth; None for an optional variable."""
    if scalar is not None:
        shape = tuple(sizes.get(dim, 1) for dim in variable.dims)
        return _as_allowed_dtype(variable, np.full(shape, scalar))
    if not variable.required:
        return None
    if variable.role == "truth" and truth_kind != "rendered":
        return _absent(variable, sizes)
    raise InputError(
        f"A {modality} capture needs {variable.name}.",
        where=variable.role, allowed=f"{variable.name}({','.join(variable.dims)}) in {variable.units[0]}",
        next_step="state another truth_kind than rendered: missing truth is then filled with NaN"
        if variable.role == "truth" else "",
    )  # fmt: skip


def as_json(value: object, where: str) -> str:
    """`value` as JSON text; a text that is JSON is returned unchanged. Raises InputError for a value that JSON cannot hold."""
    try:
        if isinstance(value, str):
            json.loads(value)
            return value
        return json.dumps(value, ensure_ascii=False, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(
            f"The value is not representable as JSON: {error}.",
            where=where,
            value=value,
            allowed="JSON without NaN or infinity",
        ) from error


def _with_sources(attrs: Mapping[str, Any]) -> Mapping[str, Any]:
    """`attrs` with name and sha256 of the scene's files, and without their folders; unchanged for a scene without files."""
    scene, made = attrs.get("truth_scene"), attrs.get("provenance")
    if not isinstance(scene, Mapping) or not isinstance(made, Mapping):
        return attrs
    from .sources import bare_scene, source_files

    files = source_files(scene)
    return {**attrs, "truth_scene": bare_scene(scene), "provenance": {**made, "files": files}} if files else attrs


def _attributes(modality: str, attrs: Mapping[str, Any]) -> dict[str, Any]:
    result: dict[str, Any] = {"schema_version": SCHEMA_VERSION, "modality": modality}
    for name, value in attrs.items():
        if value is None:
            continue
        if name in JSON_ATTRIBUTES:
            result[name] = as_json(value, f"attribute {name}")
        else:
            result[name] = value.item() if isinstance(value, np.generic) else value
    if result["schema_version"] != SCHEMA_VERSION or result["modality"] != modality:
        raise InputError(
            "The attributes schema_version and modality are set by make_capture.",
            where="attrs", value={name: result[name] for name in ("schema_version", "modality")},
            allowed=f"schema_version {SCHEMA_VERSION}, modality {modality}",
        )  # fmt: skip
    if result.get("truth_kind") not in TRUTH_KINDS:
        raise InputError(
            "The capture does not state where its truth comes from.",
            where="attribute truth_kind", value=result.get("truth_kind"), allowed=", ".join(TRUTH_KINDS),
        )  # fmt: skip
    return result


def _dims_of(variable: Variable, array: np.ndarray[Any, Any]) -> tuple[str, ...]:
    for dims in variable.allowed_dims:
        if len(dims) == array.ndim:
            return dims
    allowed = " or ".join(f"({','.join(dims)})" for dims in variable.allowed_dims)
    raise InputError(
        f"{variable.name} has the wrong number of dimensions.", where=variable.name, value=array.shape, allowed=allowed
    )


def _as_allowed_dtype(variable: Variable, array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    if array.dtype.name in variable.dtypes and array.dtype.isnative:
        return array
    target = np.dtype(variable.dtypes[0])
    if array.dtype.kind in "biufc":
        # Counts are never converted: their dtype states what the instrument delivered.
        exact = variable.name != "counts" and (target.kind != "b" or array.dtype.kind == "b")
        with np.errstate(all="ignore"):
            turned = array.astype(target) if exact and np.can_cast(array.dtype, target, "unsafe") else None
        if turned is not None and np.array_equal(turned, array, equal_nan=array.dtype.kind in "fc"):
            return turned
    raise InputError(
        f"{variable.name} has a dtype that a capture cannot hold.",
        where=variable.name, value=str(array.dtype), allowed=", ".join(variable.dtypes),
    )  # fmt: skip


def _variable_attributes(variable: Variable, value: object) -> dict[str, str]:
    units = getattr(value, "attrs", {}).get("units", variable.units[0])
    return {"units": units, "long_name": variable.long_name}


def _absent(variable: Variable, sizes: Mapping[str, int]) -> np.ndarray[Any, Any]:
    # A dimension that only truth has (return, lenslet, mode) has length 1 in a recording without truth.
    dtype = np.dtype(variable.dtypes[0])
    fill = {"f": np.nan, "c": complex(np.nan, np.nan), "i": -1, "b": False}[dtype.kind]
    return np.full(tuple(sizes.get(dim, 1) for dim in variable.dims), fill, dtype)
