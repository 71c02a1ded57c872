"""What an estimator returns: the quantities of its stage, made and checked in one place."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..captures.layouts import stage_of
from ..captures.quantities import (
    COMPONENTS,
    GREATEST,
    LEAST,
    Quantity,
    Stage,
    Variables,
    possible_sigma,
    possible_value,
)
from ..captures.sizes import sizes_of
from ..scenes.errors import InputError

__all__ = ["check_result", "masked_result", "range_result", "stage_result"]

Array = npt.NDArray[Any]

#: Dimensions of a range by their number: a record of shots, or an image.
_RANGE_DIMS = {1: ("shot",), 2: ("row", "col")}


def range_result(range_m: Array, sigma_m: Array, valid: Array) -> xr.Dataset:
    """Dataset of range [m], its standard error sigma [m] and valid, over (shot) or (row, col).

    Values that are not finite, and ranges that are not positive, are made invalid; invalid elements hold NaN.
    """
    with np.errstate(invalid="ignore"):
        good = np.asarray(valid, dtype=bool) & possible_value(range_m) & possible_sigma(sigma_m) & (range_m > 0)
    return masked_result(np.where(good, range_m, np.nan), np.where(good, sigma_m, np.nan), good)


@lru_cache(maxsize=16)
def _template(shape: tuple[int, ...]) -> xr.Dataset:
    """A result of this shape that holds one number: to fill a copy takes half as long as to build a Dataset."""
    dims, zero = _RANGE_DIMS[len(shape)], np.broadcast_to(np.float64(0), shape)
    return xr.Dataset(
        {
            "range": (dims, zero, {"units": "m", "long_name": "radial range"}),
            "sigma": (dims, zero, {"units": "m", "long_name": "standard error of range"}),
            "valid": (dims, zero, {"units": "1", "long_name": "estimate is given"}),
        }
    )


def masked_result(range_m: Array, sigma_m: Array, valid: Array) -> xr.Dataset:
    """As `range_result` for arrays that are masked already (NaN where not valid): nothing is copied."""
    return _template(range_m.shape).copy(data={"range": range_m, "sigma": sigma_m, "valid": valid})


def stage_result(word: str, **arrays: Array) -> xr.Dataset:
    """Dataset of the quantities of a stage, each with its standard error and `valid`.

    Main arguments:
        word: of the stage, as under `@estimator`.
        arrays: `<quantity>`, `sigma` and `valid`; for every quantity but the first `sigma_<quantity>`, `valid_<quantity>`.

    Values that are not finite, and those of zero and below where the quantity is positive, are made invalid; invalid
    elements hold NaN. Raises InputError for an unknown stage, a missing array or one that the stage does not give.
    """
    stage = stage_of(word)
    if arrays.keys() != stage.dims().keys():
        raise InputError(
            "A result needs exactly the variables of its stage.", where=f"stage {word}", value=sorted(arrays),
            allowed=", ".join(stage.dims()),
        )  # fmt: skip
    data: dict[str, Array] = {}
    for quantity in stage.gives:
        names = stage.variables(quantity)
        value, sigma = (np.asarray(arrays[name], np.float64) for name in (names.value, names.sigma))
        good = np.asarray(arrays[names.valid], bool) & _sound(quantity, value, sigma)
        mask = good.reshape(good.shape + (1,) * len(quantity.components))
        data |= {
            names.value: np.where(mask, value, np.nan),
            names.sigma: np.where(mask, sigma, np.nan),
            names.valid: good,
        }
    return _stage_template(word, tuple(array.shape for array in data.values())).copy(data=data)


@lru_cache(maxsize=64)
def _stage_template(word: str, shapes: tuple[tuple[int, ...], ...]) -> xr.Dataset:
    """A result of these shapes that holds one number: to fill a copy takes a seventh of what it takes to build a Dataset."""
    held = iter(shapes)
    made: dict[str, Any] = {}
    stage = stage_of(word)
    for quantity in stage.gives:
        names = stage.variables(quantity)
        texts = (
            (names.value, quantity.dims, quantity.unit, quantity.long_name),
            (names.sigma, quantity.dims, quantity.unit, f"standard error of {quantity.name}"),
            (names.valid, quantity.element_dims, "1", "estimate is given"),
        )
        for name, dims, unit, long_name in texts:
            made[name] = (dims, np.broadcast_to(np.float64(0), next(held)), {"units": unit, "long_name": long_name})
    return xr.Dataset(made)


def _sound(quantity: Quantity, value: Array, sigma: Array) -> Array:
    """Elements all of whose components have a possible value and a standard error above 0."""
    with np.errstate(invalid="ignore"):
        good: Array = possible_value(value) & possible_sigma(sigma)
        if quantity.positive:
            good = good & (value > 0)
    for _ in quantity.components:
        good = np.asarray(good.all(axis=-1))
    return good


def check_result(result: object, capture: xr.Dataset, name: str, stage: Stage) -> xr.Dataset:
    """The result as a new Dataset. Raises InputError where it breaks the contract of its stage.

    Sizes are those of the capture where it has the dimension, or the number of components; any other dimension has the length that
    the estimator chose.
    """
    if not isinstance(result, xr.Dataset):
        raise InputError(
            f"Estimator {name} did not return a Dataset.",
            where=name,
            value=type(result).__name__,
            allowed="xarray.Dataset",
        )
    measured = sizes_of(capture)
    for key, dims in stage.dims().items():
        if key not in result.variables:
            raise InputError(
                f"Estimator {name} did not return {key}.", where=name, value=sorted(map(str, result)),
                allowed=", ".join(stage.dims()),
            )  # fmt: skip
        found = result.variables[key]
        sizes = {dim: int(measured.get(dim, COMPONENTS.get(dim, result.sizes.get(dim, 0)))) for dim in dims}
        if found.dims != dims or found.shape != tuple(sizes.values()):
            raise InputError(
                f"Estimator {name} returned {key} with the wrong shape.",
                where=name,
                value=dict(zip(map(str, found.dims), found.shape, strict=True)),
                allowed=", ".join(f"{dim}: {size}" for dim, size in sizes.items()),
            )
    for quantity in stage.gives:
        _check_values(result, quantity, stage.variables(quantity), name)
    return result.copy(deep=False)


def _check_values(result: xr.Dataset, quantity: Quantity, names: Variables, name: str) -> None:
    value, sigma, valid = (result.variables[key].values for key in names.all)
    if valid.dtype != np.bool_:
        raise InputError(
            f"Estimator {name} returned {names.valid} that is not boolean.", where=name, value=str(valid.dtype),
            allowed="bool",
        )  # fmt: skip
    for key, array in ((names.value, value), (names.sigma, sigma)):
        if array.dtype not in (np.dtype("float32"), np.dtype("float64")):
            raise InputError(
                f"Estimator {name} returned {key} that is not floating point.", where=name, value=str(array.dtype),
                allowed="float32 or float64",
            )  # fmt: skip
    # NaN is in no range; only where one is there must each element be looked at.
    if value.size and abs(value).max() <= GREATEST and sigma.min() >= LEAST and sigma.max() <= GREATEST:
        return
    with np.errstate(invalid="ignore"):
        good = possible_value(value) & possible_sigma(sigma)
    for _ in quantity.components:
        good = good.all(axis=-1)
    wrong = valid & ~good
    if wrong.any():
        raise InputError(
            f"Estimator {name} marks {int(wrong.sum())} elements as valid whose {names.value} is not finite, or whose "
            f"{names.sigma} is not finite and positive, or beyond {GREATEST:g}.",
            where=name,
            allowed="valid=False where there is no estimate",
        )
