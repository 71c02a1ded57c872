"""pictures/<scene>__<estimator>.npz: value, truth and error of one estimate, for the report."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...captures.quantities import Quantity
from ..folders.files import write_atomic

__all__ = ["Place", "picture_index", "write_picture"]

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Place:
    """Where in a run a picture belongs."""

    scene: str
    estimator: str
    condition: str


#: Dimensions along which neighbours in the array are neighbours in space or time.
_EXTENDED = {"row", "col", "frame", "pupil_row", "pupil_col", "image_row", "image_col"}


def picture_index(quantity: Quantity) -> tuple[Any, ...] | None:
    """Index that reduces an estimate to the picture that a page shows, for all dimensions of the quantity; None without one.

    An image (row, col) is whole, of wavefronts and deblurred images the first frame's; a line's profiles are the first return
    of every row, one profile a frame, and of a point the last component (z, its depth). Coefficients, spots and single
    numbers have no picture.
    """
    left = [name for name in quantity.element_dims if name != "return"]
    if len(left) == 3 and left[0] == "frame":
        left = left[1:]
    if len(left) != 2 or not set(left) <= _EXTENDED:
        return None
    return tuple(
        slice(None) if name in left else -1 if name in quantity.components else 0 for name in quantity.dims
    )  # fmt: skip


def write_picture(
    folder: Path, place: Place, quantity: Quantity, value: Array, valid: Array, truth: Array, error: Array
) -> Path:
    """Write one picture; all arrays (row, col) in the unit of the quantity, NaN where there is no answer or no truth."""
    factor, unit = quantity.display
    arrays: dict[str, Array] = {
        "value": np.where(valid, value, np.nan).astype(np.float32),
        "truth": truth.astype(np.float32),
        "error": np.where(valid, error, np.nan).astype(np.float32),
        "valid": valid,
        "scene": np.array(place.scene),
        "estimator": np.array(place.estimator),
        "condition": np.array(place.condition),
        "quantity": np.array(quantity.name),
        "unit": np.array(quantity.unit),
        "shown": np.array([str(factor), unit]),
    }

    def save(path: Path) -> None:
        # As numpy.savez_compressed, at zlib's fastest level: higher levels take five times as long and save nothing on noise.
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for name, array in arrays.items():
                with archive.open(f"{name}.npy", "w") as file:
                    np.lib.format.write_array(file, array, allow_pickle=False)

    safe = "".join(c if c.isalnum() or c in "._-" else "-" for c in f"{place.scene}__{place.estimator}")
    path = folder / f"{safe}.npz"
    write_atomic(path, save)
    return path
