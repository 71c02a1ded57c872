"""What estimators of one-detector rangers return: range, sigma and valid per shot."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

__all__ = ["shot_result"]

Array = npt.NDArray[Any]


def shot_result(range_m: Array, sigma_m: Array, valid: Array) -> xr.Dataset:
    """Dataset of range (shot) [m], its standard error sigma (shot) [m] and valid (shot).

    Values that are not finite, and ranges that are not positive, are made invalid; invalid elements hold NaN.
    """
    with np.errstate(invalid="ignore"):
        good = np.asarray(valid, dtype=bool) & np.isfinite(range_m) & np.isfinite(sigma_m)
        good &= (range_m > 0) & (sigma_m > 0)
    return xr.Dataset(
        {
            "range": (("shot",), np.where(good, range_m, np.nan), {"units": "m", "long_name": "radial range"}),
            "sigma": (
                ("shot",),
                np.where(good, sigma_m, np.nan),
                {"units": "m", "long_name": "standard error of range"},
            ),
            "valid": (("shot",), good, {"units": "1", "long_name": "estimate is given"}),
        }
    )
