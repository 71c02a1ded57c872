"""What a range estimator returns, made and checked in one place."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..scenes.errors import InputError

__all__ = ["check_result", "masked_result", "range_result"]

Array = npt.NDArray[Any]


def range_result(range_m: Array, sigma_m: Array, valid: Array) -> xr.Dataset:
    """Dataset of range (row, col) [m], its standard error sigma (row, col) [m] and valid (row, col).

    Values that are not finite, and ranges that are not positive, are made invalid; invalid elements hold NaN.
    """
    with np.errstate(invalid="ignore"):
        good = np.asarray(valid, dtype=bool) & np.isfinite(range_m) & np.isfinite(sigma_m)
        good &= (range_m > 0) & (sigma_m > 0)
    return masked_result(np.where(good, range_m, np.nan), np.where(good, sigma_m, np.nan), good)


@lru_cache(maxsize=16)
def _template(shape: tuple[int, ...]) -> xr.Dataset:
    """A result of this shape that holds one number: to fill a copy takes half as long as to build a Dataset."""
    dims, zero = ("row", "col"), np.broadcast_to(np.float64(0), shape)
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


def check_result(result: object, capture: xr.Dataset, name: str) -> xr.Dataset:
    """The result as a new Dataset if it keeps the contract, else InputError that says what is wrong."""
    if not isinstance(result, xr.Dataset):
        raise InputError(
            f"estimator {name} returned no Dataset", where=name, value=type(result).__name__, allowed="xarray.Dataset"
        )
    dims = ("row", "col") if capture.attrs.get("modality", "gated") == "gated" else ("shot",)
    shape = tuple(int(capture.sizes[dim]) for dim in dims)
    for key in ("range", "sigma", "valid"):
        if key not in result.variables:
            raise InputError(f"estimator {name} returned no {key}", where=name, value=sorted(map(str, result)))
        found = result.variables[key]
        if found.dims != dims or found.shape != shape:
            raise InputError(
                f"estimator {name} returned {key} of a wrong shape",
                where=name,
                value=dict(zip(map(str, found.dims), found.shape, strict=True)),
                allowed=", ".join(f"{dim}: {size}" for dim, size in zip(dims, shape, strict=True)),
            )
    value, sigma, valid = (result.variables[key].values for key in ("range", "sigma", "valid"))
    if valid.dtype != np.bool_:
        raise InputError(f"estimator {name}: valid is not bool", where=name, value=str(valid.dtype))
    for key, array in (("range", value), ("sigma", sigma)):
        if array.dtype not in (np.dtype("float32"), np.dtype("float64")):
            raise InputError(
                f"estimator {name}: {key} is not a float", where=name, value=str(array.dtype), allowed="float32/64"
            )
    # Sums tell that nothing is NaN or infinite anywhere; only otherwise must each element be looked at.
    if np.isfinite(value.sum() + sigma.sum()) and sigma.min(initial=1.0) > 0:
        return result.copy(deep=False)
    wrong = valid & ~(np.isfinite(value) & np.isfinite(sigma) & (sigma > 0))
    if wrong.any():
        raise InputError(
            f"estimator {name} calls {int(wrong.sum())} elements valid whose range or sigma is not finite and positive",
            where=name,
            allowed="valid=False where there is no estimate",
        )
    return result.copy(deep=False)
