"""Lengths of a capture's dimensions, as an estimator sees them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["sizes_of"]


def sizes_of(capture: xr.Dataset) -> dict[str, int]:
    """Length of every dimension that the data and coordinates of a capture have; those that truth alone has are not known: an
    estimator, which never sees the truth, chooses their lengths."""
    return {
        str(dim): int(size)
        for name, held in capture.variables.items()
        if not str(name).startswith("truth_")
        for dim, size in zip(held.dims, held.shape, strict=True)
    }
