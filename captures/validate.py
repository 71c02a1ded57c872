"""Check a capture against the layout of its modality; each error names the variable, its value and what is allowed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..scenes.errors import InputError, other_version
from ..scenes.json_keys import read_json
from .layouts import layout_of
from .layouts.layout import Layout
from .layouts.schema import FIXED_SIZES, JSON_ATTRIBUTES, SCHEMA_VERSION, TRUTH_KINDS, Variable

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["check_schema_version", "validate"]


def validate(capture: xr.Dataset, level: Literal["layout", "values"] = "values", *, where: str = "capture") -> None:
    """Raise InputError unless `capture` (a single one, without the dimension `capture`) follows its layout.

    Main arguments:
        capture: the dataset to check.
        level: "layout" checks attributes, names, dimensions, dtypes and units; "values" also checks coordinates (finite
            delays, gate index within the rig's gates, pulses ≥ 0) and truth (ranges positive or NaN).
    Other arguments:
        where: the capture's place in messages, e.g. a file.
    """
    if level not in ("layout", "values"):
        raise InputError("There is no such level of validation.", where="level", value=level, allowed="layout, values")
    check_schema_version(capture.attrs.get("schema_version"), where)
    layout = layout_of(capture.attrs.get("modality"))
    schema = layout.by_name
    rig = _check_attributes(capture, where)
    variables = {str(name): array for name, array in capture.variables.items()}
    for name in variables:
        if name not in schema:
            raise InputError(
                f"A {capture.attrs['modality']} capture has no variable of this name.",
                where=f"{where}: {name}", value=name, allowed=", ".join(schema),
            )  # fmt: skip
    for name, variable in schema.items():
        if name in variables:
            _check_variable(variable, variables[name], name in capture.coords, where)
        elif variable.required:
            raise InputError(
                f"The capture lacks {name}.",
                where=where, allowed=f"{name}({','.join(variable.dims)}) in {variable.units[0]}",
            )  # fmt: skip
    for dim, size in FIXED_SIZES.items():
        if capture.sizes.get(dim, size) != size:
            raise InputError(
                f"The dimension {dim} has a fixed size.", where=where, value=capture.sizes[dim], allowed=f"{size}"
            )
    counts = variables.get("counts")
    averaged = capture.attrs.get("averaged", False)
    if counts is not None and (counts.dtype == np.float32) != bool(averaged):
        raise InputError(
            "Counts must be uint16, or float32 with the attribute averaged = True.",
            where=f"{where}: counts", value=f"{counts.dtype}, averaged={averaged}",
            allowed="uint16, or float32 averaged",
        )  # fmt: skip
    if level == "values":
        _check_values(capture, layout, where)
        layout.check(capture, rig, where)


def check_schema_version(version: object, where: str) -> None:
    """Raise InputError unless this code reads `version` of the schema."""
    if not isinstance(version, int | np.integer) or isinstance(version, bool) or int(version) != SCHEMA_VERSION:
        raise other_version(
            "The capture was written under another version of the schema." if version is not None
            else "The data set is not a capture: it has no schema_version.",
            where=f"{where}: attribute schema_version", found=int(version) if isinstance(version, np.integer) else version,
            known=SCHEMA_VERSION, older="read it with the version of Beambench that wrote it, or generate or import it anew",
        )  # fmt: skip


def _check_attributes(capture: xr.Dataset, where: str) -> dict[str, Any]:
    attrs = capture.attrs
    if attrs.get("truth_kind") not in TRUTH_KINDS:
        raise InputError(
            "The capture does not state where its truth comes from.",
            where=f"{where}: attribute truth_kind", value=attrs.get("truth_kind"), allowed=", ".join(TRUTH_KINDS),
        )  # fmt: skip
    parsed: dict[str, Any] = {}
    for name in JSON_ATTRIBUTES:
        if name not in attrs:
            continue
        try:
            if not isinstance(attrs[name], str):
                raise TypeError(f"{type(attrs[name]).__name__}, not text")
            parsed[name] = read_json(attrs[name])
        except (TypeError, ValueError, RecursionError) as error:
            raise InputError(
                f"The attribute {name} is not JSON text: {error}.",
                where=f"{where}: attribute {name}", value=attrs[name], allowed="JSON text",
            ) from error  # fmt: skip
    if not isinstance(parsed.get("rig"), dict):
        raise InputError(
            "The capture does not declare its rig.",
            where=f"{where}: attribute rig", value=attrs.get("rig"), allowed="JSON text of an object",
        )  # fmt: skip
    rig: dict[str, Any] = parsed["rig"]
    return rig


def _check_variable(variable: Variable, array: xr.Variable, is_coord: bool, where: str) -> None:
    place = f"{where}: {variable.name}"
    if tuple(array.dims) not in variable.allowed_dims:
        allowed = " or ".join(f"({','.join(dims)})" for dims in variable.allowed_dims)
        raise InputError(
            f"{variable.name} has the wrong dimensions.", where=place, value=tuple(array.dims), allowed=allowed
        )
    if str(array.dtype) not in variable.dtypes:
        raise InputError(
            f"{variable.name} has the wrong dtype.",
            where=place, value=str(array.dtype), allowed=", ".join(variable.dtypes),
        )  # fmt: skip
    if 0 in array.shape:
        raise InputError(f"{variable.name} is empty.", where=place, value=array.shape, allowed="each size ≥ 1")
    if array.attrs.get("units") not in variable.units:
        raise InputError(
            f"{variable.name} has the wrong units.",
            where=place, value=array.attrs.get("units"), allowed=", ".join(variable.units),
        )  # fmt: skip
    if not array.attrs.get("long_name"):
        raise InputError(f"{variable.name} has no long_name.", where=place, allowed=variable.long_name)
    if is_coord != (variable.role == "coord"):
        kind = "a coordinate" if variable.role == "coord" else "a data variable"
        raise InputError(f"{variable.name} must be {kind}.", where=place, allowed=kind)


def _check_values(capture: xr.Dataset, layout: Layout, where: str) -> None:
    for name in layout.finite:
        if name in capture.coords and not np.isfinite(capture[name].values).all():
            raise InputError(
                f"{name} must be finite.", where=f"{where}: {name}", value=_first_bad(capture[name].values)
            )
    for name in ("gate", "pulses"):
        if name in capture.coords and (values := capture[name].values).min() < 0:
            raise InputError(
                f"{name} must not be negative.", where=f"{where}: {name}", value=int(values.min()), allowed="≥ 0"
            )
    for name in (f"truth_{quantity.name}" for quantity in layout.quantities if quantity.positive):
        if name in capture:
            truth = capture[name].values
            bad = truth[np.isinf(truth) | (truth <= 0)]
            if bad.size:
                raise InputError(
                    f"{name} must be positive, or NaN where there is no surface.",
                    where=f"{where}: {name}", value=float(bad[0]), allowed="> 0 or NaN",
                )  # fmt: skip


def _first_bad(values: np.ndarray[Any, Any]) -> str:
    index = np.argwhere(~np.isfinite(values))[0]
    return f"{values[tuple(index)]} at {tuple(int(i) for i in index)}"
