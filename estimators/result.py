"""What a range estimator returns, made and checked in one place."""

from __future__ import annotations

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


def masked_result(range_m: Array, sigma_m: Array, valid: Array) -> xr.Dataset:
    """As `range_result` for arrays that are masked already (NaN where not valid): nothing is copied."""
    dims = ("row", "col")
    return xr.Dataset(
        {
            "range": (dims, range_m, {"units": "m", "long_name": "radial range"}),
            "sigma": (dims, sigma_m, {"units": "m", "long_name": "standard error of range"}),
            "valid": (dims, valid, {"units": "1", "long_name": "estimate is given"}),
        }
    )


def check_result(result: object, capture: xr.Dataset, name: str) -> xr.Dataset:
    """The result as a new Dataset if it keeps the contract, else InputError that says what is wrong."""
    if not isinstance(result, xr.Dataset):
        raise InputError(
            f"estimator {name} returned no Dataset", where=name, value=type(result).__name__, allowed="xarray.Dataset"
        )
    data = capture["counts"]
    shape = (data.sizes["row"], data.sizes["col"])
    for key in ("range", "sigma", "valid"):
        if key not in result:
            raise InputError(f"estimator {name} returned no {key}", where=name, value=sorted(map(str, result)))
        if result[key].dims != ("row", "col") or result[key].shape != shape:
            raise InputError(
                f"estimator {name} returned {key} of a wrong shape",
                where=name,
                value=dict(zip(map(str, result[key].dims), result[key].shape, strict=True)),
                allowed=f"row: {shape[0]}, col: {shape[1]}",
            )
    if result["valid"].dtype != np.bool_:
        raise InputError(f"estimator {name}: valid is not bool", where=name, value=str(result["valid"].dtype))
    for key in ("range", "sigma"):
        if result[key].dtype not in (np.dtype("float32"), np.dtype("float64")):
            raise InputError(
                f"estimator {name}: {key} is not a float",
                where=name,
                value=str(result[key].dtype),
                allowed="float32/64",
            )
    valid = result["valid"].values
    finite = np.isfinite(result["range"].values) & np.isfinite(result["sigma"].values)
    wrong = valid & ~(finite & (result["sigma"].values > 0))
    if wrong.any():
        raise InputError(
            f"estimator {name} calls {int(wrong.sum())} elements valid whose range or sigma is not finite and positive",
            where=name,
            allowed="valid=False where there is no estimate",
        )
    return result.copy(deep=False)
