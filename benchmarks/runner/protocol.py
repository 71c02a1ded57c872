"""The protocol between runner and child: arrays as .npy files (never pickled), everything else as lines of JSON.

Folder of one capture: `<variable>.npy` for every variable and coordinate, `meta-<condition>.json` with the dimensions
and attributes of each. The child gets them as a sealed block (`sealed`), never the folder. Its result is one .npy file
per variable and one line of JSON.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ...captures.quantities import COMPONENTS, GREATEST, Quantity, Stage, possible_sigma, possible_value
from ...scenes.errors import InputError
from ...scenes.npz import read_npy
from ...scenes.plain_text import plain_text

__all__ = [
    "THREAD_VARIABLES", "content_id", "file_sums", "misshapen", "read_results", "unsound", "write_capture",
    "write_meta",
]  # fmt: skip

#: Longest dimension that an estimator may choose.
_LONGEST = 65536

#: Variables that are set to 1 in the child's environment, before it imports anything.
THREAD_VARIABLES = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "NUMEXPR_NUM_THREADS",
    "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "RAYON_NUM_THREADS", "DRJIT_NUM_THREADS",
)  # fmt: skip


def _plain(value: Any) -> Any:
    """Plain JSON values in place of NumPy scalars and arrays in attributes."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return value


def _attributes(attrs: Any) -> dict[str, Any]:
    return {str(key): _plain(value) for key, value in attrs.items()}


def write_capture(folder: Path, capture: xr.Dataset) -> None:
    """Write the arrays of a capture without truth.

    Raises:
        ValueError: the capture holds truth; then nothing is written.
    """
    names = [str(name) for name in capture.variables]
    if held := [name for name in [*names, *map(str, capture.attrs)] if name.startswith("truth_")]:
        raise ValueError(f"a capture for an estimator must not hold truth: {held}")
    folder.mkdir(parents=True)
    for name in names:
        path = folder / f"{name}.npy"
        np.save(path, np.ascontiguousarray(capture[name].values), allow_pickle=False)
        path.chmod(0o444)


def write_meta(folder: Path, capture: xr.Dataset, condition: str, common: xr.Dataset | None = None) -> None:
    """Write the dimensions and attributes of a capture under one condition.

    Other arguments:
        common: the capture whose arrays are in the folder. Coordinates that differ from its own are written as well, under
            the name of the condition.
    """
    variables = {
        str(name): {
            "dims": [str(dim) for dim in variable.dims],
            "attrs": _attributes(variable.attrs),
            "coordinate": name in capture.coords,
        }
        for name, variable in capture.variables.items()
    }
    for name in capture.coords if common is not None else ():
        assert common is not None
        if not np.array_equal(capture[name].values, common[name].values, equal_nan=capture[name].dtype.kind == "f"):
            path = folder / f"{name}@{condition}.npy"
            np.save(path, np.ascontiguousarray(capture[name].values), allow_pickle=False)
            path.chmod(0o444)
            variables[str(name)]["file"] = path.name
    meta = {"variables": variables, "attrs": _attributes(capture.attrs)}
    (folder / f"meta-{condition}.json").write_text(json.dumps(meta), encoding="utf-8")


def file_sums(folder: Path) -> dict[str, str]:
    """SHA-256 of every file of a capture, which shows whether an estimator has changed the input of the next one.

    A CRC would not: other bytes with the same one are found at once.
    """
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}


def content_id(sums: Mapping[str, str], condition: str) -> str:
    """SHA-256, in hex, of all that an estimator reads of a capture under one condition: arrays, coordinates, declared rig.

    `sums`: of the capture's files, as of `file_sums`.
    """
    digest = hashlib.sha256()
    read = (name for name in sums if name.endswith(".npy") and ("@" not in name or name.endswith(f"@{condition}.npy")))
    for name in sorted(read):
        digest.update(name.encode() + bytes.fromhex(sums[name]))
    digest.update(b"meta" + bytes.fromhex(sums[f"meta-{condition}.json"]))
    return digest.hexdigest()


def misshapen(name: str, dims: tuple[str, ...], shape: tuple[int, ...], sizes: dict[str, int]) -> str:
    """Reason why the shape of one array of a result is wrong, or "".

    Main arguments:
        dims, shape: dimensions and shape of the array `name`.
        sizes: lengths of the capture's dimensions, and of those that earlier arrays chose; new dimensions are added.
    """
    if len(shape) != len(dims):
        return f"{name} has shape {shape}, not one length for each of {dims}"
    for dim, length in zip(dims, shape, strict=True):
        if dim in COMPONENTS:
            sizes.setdefault(dim, COMPONENTS[dim])
        if dim not in sizes and not 0 < length <= _LONGEST:
            return f"{name} has {length} of dimension {dim}, not 1 to {_LONGEST}"
        sizes.setdefault(dim, length)
    expected = tuple(sizes[dim] for dim in dims)
    return "" if shape == expected else f"{name} has shape {shape}, not {expected} {dims}"


def read_results(folder: Path, stage: Stage, sizes: dict[str, int]) -> tuple[dict[str, np.ndarray], str]:
    """Read and check a child's result: (arrays, "") or ({}, reason). Never unpickles, and checks before it loads.

    Main arguments:
        stage: stage of the estimator. sizes: lengths of the capture's dimensions.

    Checked: presence, shape, kind (floats, `valid` boolean), finite values and finite positive `sigma` where valid.
    """
    arrays: dict[str, np.ndarray] = {}
    flags = {stage.variables(quantity).valid for quantity in stage.gives}
    known = dict(sizes)
    for name, dims in stage.dims().items():
        path = folder / f"{name}.npy"
        if not path.is_file() or os.path.islink(path):
            return {}, f"no variable {name!r}"
        try:
            # Read, not mapped: the child may shorten the file meanwhile, and a mapping would end this process (SIGBUS).
            found = read_npy(path, name)
        except InputError as error:
            return {}, plain_text(f"{name} is not an array: {error.value}")
        if wrong := misshapen(name, dims, found.shape, known):
            return {}, wrong
        if found.dtype.kind != ("b" if name in flags else "f"):
            return {}, f"{name} is of type {found.dtype}"
        arrays[name] = np.array(found, dtype=bool if name in flags else np.float64)
    wrong = unsound(arrays, stage)
    return ({}, wrong) if wrong else (arrays, "")


def unsound(arrays: dict[str, np.ndarray], stage: Stage) -> str:
    """Reason why the numbers of an answer are invalid, or "": types, and values that are none."""
    for name, array in arrays.items():
        flag = name in {stage.variables(quantity).valid for quantity in stage.gives}
        if array.dtype.kind != ("b" if flag else "f"):
            return f"{name} is of type {array.dtype}"
    for quantity in stage.gives:
        if wrong := _not_finite(arrays, stage, quantity):
            return wrong
    return ""


def _not_finite(arrays: dict[str, np.ndarray], stage: Stage, quantity: Quantity) -> str:
    """Reason why the numbers of a quantity are invalid, or ""."""
    names = stage.variables(quantity)
    value, sigma = arrays[names.value], arrays[names.sigma]
    valid = arrays[names.valid].reshape(arrays[names.valid].shape + (1,) * len(quantity.components))
    with np.errstate(invalid="ignore"):
        wrong, odd = valid & ~possible_value(value), valid & ~possible_sigma(sigma)
    if bad := int(np.count_nonzero(wrong)):
        what = (
            "not finite"
            if not np.isfinite(value[np.broadcast_to(wrong, value.shape)]).all()
            else f"beyond {GREATEST:g}"
        )
        return f"{names.value} is {what} at {bad} elements marked valid"
    if bad := int(np.count_nonzero(odd)):
        return f"{names.sigma} is not finite and positive at {bad} elements marked valid"
    return ""
