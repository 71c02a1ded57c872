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

__all__ = ["Place", "write_picture"]

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Place:
    """Where in a run a picture belongs."""

    scene: str
    estimator: str
    condition: str


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
