"""Squared errors by tile of a capture, on which two estimators are compared (errors_by_tile.npz).

The estimators of a run read the same pixels with the same noise, so that the difficulty of a tile is the same for all. For
unchanged scenes the file holds the sum over each tile of the squared errors of its unmixed elements. An invalid element has
the error of a guess (`scores.truth.refusal_error`): √(Σ sums/Σ counts) is `rmse_full`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...captures.quantities import Stage
from ...scenes.errors import InputError, reason
from ...scenes.json_keys import read_json
from ...scenes.npz import read_npz
from ..folders.files import write_atomic
from .truth import Bound, Truth, aligned, errors_of, refusal_error, single_valued

__all__ = ["FILE", "TileKey", "main_tiles", "read_tiles", "tile_sums", "tiles_of", "write_tiles"]

Float = npt.NDArray[np.float64]
#: (scene, condition, seed, label of the estimator).
TileKey = tuple[str, str, int, str]

FILE = "errors_by_tile.npz"
_TILES = 64


def tiles_of(shape: tuple[int, ...]) -> npt.NDArray[np.intp]:
    """The tile number of every element: at most 8 × 8 tiles over the first two dimensions, or 64 along a record of shots.
    Further dimensions (returns of a row, components) do not change the tile."""
    if len(shape) == 1:
        return np.asarray(np.arange(shape[0]) * min(_TILES, shape[0]) // max(shape[0], 1), np.intp)
    side = math.isqrt(_TILES)
    rows, cols = (np.arange(size) * min(side, size) // max(size, 1) for size in shape[:2])
    plane = np.asarray(rows[:, None] * side + cols[None, :], np.intp)
    return np.broadcast_to(plane.reshape(plane.shape + (1,) * (len(shape) - 2)), shape)


def main_tiles(
    stage: Stage, arrays: dict[str, npt.NDArray[Any]], truths: Mapping[str, Truth], bounds: Mapping[str, Bound]
) -> list[list[float]]:
    """[sums, counts] per tile of an answer's main quantity, as plain numbers; `arrays` is empty where there is no answer."""
    quantity = stage.gives[0]
    truth, bound = truths[quantity.name], bounds[quantity.name]
    answer = None
    if arrays:
        value, _, valid = aligned(arrays, stage, quantity, truth.value.shape)
        answer = value, valid
    sums, counts = tile_sums(answer, truth, refusal_error(truth, single_valued(truth), bound))
    return [sums.tolist(), counts.tolist()]


def tile_sums(
    estimate: tuple[Float, npt.NDArray[np.bool_]] | None, truth: Truth, refusal: float
) -> tuple[Float, Float]:
    """(sums, counts) per tile (64) of one estimate (value, valid); without an estimate (None) every element is invalid.

    `refusal`: the error of an invalid element (`refusal_error`).
    """
    chosen = single_valued(truth)
    tile = tiles_of(truth.value.shape)[chosen]
    counts = np.bincount(tile, minlength=_TILES).astype(np.float64)
    if estimate is None:
        return counts * refusal**2, counts
    value, answered = estimate
    valid, error = answered[chosen], errors_of(value, truth)[chosen]
    sums = np.bincount(tile, weights=np.where(valid, error, refusal) ** 2, minlength=_TILES)
    return np.asarray(sums, np.float64), counts


def write_tiles(folder: Path, tiles: Mapping[TileKey, tuple[Float, Float]]) -> None:
    """Write the file of a run, completely or not at all; equal runs give equal bytes."""
    keys = sorted(tiles)
    names = np.array([json.dumps(key) for key in keys], dtype=np.str_)
    # A run whose estimators were all skipped has no errors, and a table without rows.
    values = [
        np.array([tiles[key][part] for key in keys], np.float64).reshape(len(keys), -1 if keys else _TILES)
        for part in (0, 1)
    ]

    def save(path: Path) -> None:
        with open(path, "wb") as file:
            np.savez_compressed(file, key=names, sums=values[0], counts=values[1])

    write_atomic(folder / FILE, save)


def read_tiles(folder: Path) -> dict[TileKey, tuple[Float, Float]]:
    """{(scene, condition, seed, label): (sums, counts)}; empty if the folder has no such file.

    Raises:
        InputError: the file is damaged.
    """
    path = folder / FILE
    if not path.is_file():
        return {}
    try:
        data = read_npz(path, "The file of errors by tile")
        keys = [read_json(str(name)) for name in data["key"]]
        sums, counts = np.asarray(data["sums"], np.float64), np.asarray(data["counts"], np.float64)
        found = {
            (str(k[0]), str(k[1]), int(k[2]), str(k[3])): (a, n) for k, a, n in zip(keys, sums, counts, strict=True)
        }
    except (ValueError, KeyError, IndexError, TypeError, RecursionError) as error:
        raise InputError("The errors by tile cannot be read.", where=str(path), value=reason(error)) from error
    return found
