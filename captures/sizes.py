"""Lengths of a capture's dimensions."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["sizes_of"]


def sizes_of(capture: xr.Dataset) -> dict[str, int]:
    """Length of every dimension of a capture, by name."""
    return {str(dim): int(length) for dim, length in capture.sizes.items()}
