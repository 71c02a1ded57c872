"""The quantity of every modality that measures range."""

from __future__ import annotations

from ..quantities import Quantity

__all__ = ["radial_range"]


def radial_range(*dims: str) -> Quantity:
    """Radial range along the ray of each element, m, over the dimensions `dims`."""
    return Quantity("range", "m", dims, "radial range", (1e3, "mm"), positive=True)
