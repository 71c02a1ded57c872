"""A capture as images: each variable is cut into planes of two dimensions, and those of one size belong together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Planes", "coordinates_of", "described", "image_dims", "listed", "planes_of"]

Array = np.ndarray[Any, Any]
#: Pairs of dimensions that are an image.
_IMAGES = (("row", "col"), ("pupil_row", "pupil_col"), ("image_row", "image_col"))


@dataclass(frozen=True)
class Planes:
    """The planes of a variable.

    Main arguments:
        name: of the variable. dims: of a plane: two, or one (the plane is then one column wide).
        over: dimensions that count the planes. indices: of each plane along them. values: (plane, height, width).
    """

    name: str
    dims: tuple[str, ...]
    over: tuple[str, ...]
    indices: tuple[tuple[int, ...], ...]
    values: Array

    def labels(self) -> list[str]:
        """counts.0003, truth_normal.0000, truth_range: the name, and the indices of at least four digits."""
        return [".".join([self.name, *(f"{i:04d}" for i in index)]) for index in self.indices]


def image_dims(dims: Sequence[str]) -> tuple[str, ...]:
    """The dimensions of the planes of a variable: those of an image where it has them, else its first two."""
    for pair in _IMAGES:
        if set(pair) <= set(dims):
            return pair
    return tuple(dims[:2])


def planes_of(name: str, dims: Sequence[str], values: Array) -> Planes:
    """The planes of a variable of at least one dimension."""
    inner = image_dims(dims)
    over = tuple(dim for dim in dims if dim not in inner)
    moved = values.transpose([dims.index(dim) for dim in (*over, *inner)])
    counts = moved.shape[: len(over)]
    height, width = (*moved.shape[len(over) :], 1)[:2]
    indices = tuple(tuple(map(int, index)) for index in np.ndindex(*counts))
    return Planes(name, inner, over, indices, np.ascontiguousarray(moved).reshape(len(indices), height, width))


def coordinates_of(capture: xr.Dataset) -> dict[str, Any]:
    """Coordinates as JSON: dims, units, dtype, and exact values, NaN as null."""
    return {
        str(name): {
            "dims": list(map(str, one.dims)), "dtype": one.dtype.name, "units": str(one.attrs.get("units", "")),
            "values": listed(np.asarray(one.values)),
        }
        for name, one in capture.coords.items()
    }  # fmt: skip


def listed(values: Array) -> Any:
    """Values as JSON, exact: what is not finite is null, a complex number is [real, imaginary]."""
    if values.dtype.kind == "c":
        return listed(np.stack([values.real, values.imag], axis=-1))
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        gaps = values.astype(object)
        gaps[~np.isfinite(values)] = None
        return gaps.tolist()
    return values.tolist()


def described(variables: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Dimensions, shape, dtype, units and name of variables, as JSON."""
    return {
        str(name): {
            "dims": list(map(str, one.dims)), "shape": list(one.shape), "dtype": one.dtype.name,
            "units": str(one.attrs.get("units", "")), "long_name": str(one.attrs.get("long_name", "")),
        }
        for name, one in variables.items()
    }  # fmt: skip
