"""pictures/<scene>__<estimator>.npz: range, truth and error of one estimate, for the report."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..folders.files import write_atomic

__all__ = ["write_picture"]


def write_picture(
    folder: Path,
    scene: str,
    estimator: str,
    condition: str,
    estimate: dict[str, np.ndarray],
    truth: npt.NDArray[Any],
    error: npt.NDArray[Any],
) -> Path:
    """Write one picture, all arrays (row, col) in m, NaN where there is no answer or no truth."""
    valid = estimate["valid"]
    arrays: dict[str, npt.NDArray[Any]] = {
        "range": np.where(valid, estimate["range"], np.nan).astype(np.float32),
        "truth": truth.astype(np.float32),
        "error": np.where(valid, error, np.nan).astype(np.float32),
        "valid": valid,
        "scene": np.array(scene),
        "estimator": np.array(estimator),
        "condition": np.array(condition),
    }

    def save(path: Path) -> None:
        # As numpy.savez_compressed, at zlib's fastest level: noise does not shrink further, in five times the time.
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for name, array in arrays.items():
                with archive.open(f"{name}.npy", "w") as file:
                    np.lib.format.write_array(file, array, allow_pickle=False)

    safe = "".join(c if c.isalnum() or c in "._-" else "-" for c in f"{scene}__{estimator}")
    path = folder / f"{safe}.npz"
    write_atomic(path, save)
    return path
