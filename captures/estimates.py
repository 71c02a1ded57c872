"""Estimates on disk: one HDF5 file per estimator, also as another program may write them.

Attributes: `schema_version` = 1, `estimator` (label; default: the file's name), `modality`, and `captures_sha256`, the sha256
of the manifest of the captures that were read (`beambench export` hands it on). Datasets with a leading capture axis:
`range` and `sigma` (capture, row, col) float, m; `valid` (capture, row, col) bool or 0/1; optional `cpu_s`, `wall_s`,
`peak_bytes` (capture) and `status` (capture) text.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scenes.errors import InputError

__all__ = ["Estimates", "list_estimates", "read_estimates", "write_estimates"]

SCHEMA_VERSION = 1


@dataclass(frozen=True)
class Estimates:
    """One estimator's answers to all captures of a store; `arrays[i]` is None where it gave none."""

    label: str
    modality: str
    arrays: list[dict[str, NDArray[Any]] | None]
    cpu_s: list[float]
    wall_s: list[float]
    peak_bytes: list[float]
    status: list[str]
    captures_sha256: str = ""


def write_estimates(path: Path, estimates: Estimates) -> None:
    """Write a file, whole or not at all. Raises InputError where the place is full or may not be written."""
    import h5py

    from .hdf5 import hdf5_output

    given = [arrays for arrays in estimates.arrays if arrays is not None]
    shape = given[0]["range"].shape if given else (0, 0)
    with hdf5_output(path) as output:
        file = output.h5
        file.attrs.update(schema_version=SCHEMA_VERSION, estimator=estimates.label, modality=estimates.modality)
        if estimates.captures_sha256:
            file.attrs["captures_sha256"] = estimates.captures_sha256
        for name, kind in (("range", "f8"), ("sigma", "f8"), ("valid", "?")):
            empty = np.full(shape, np.nan if kind == "f8" else False, dtype=kind)
            stack = np.stack([empty if a is None else np.asarray(a[name], dtype=kind) for a in estimates.arrays])
            dataset = file.create_dataset(
                name,
                data=stack,
                chunks=(1, *shape) if stack.size else None,
                compression="gzip" if stack.size else None,
                fletcher32=bool(stack.size),
            )
            if kind == "f8":
                dataset.attrs["units"] = "m"
        for name in ("cpu_s", "wall_s", "peak_bytes"):
            file.create_dataset(name, data=np.asarray(getattr(estimates, name), dtype="f8"))
        file.create_dataset("status", data=estimates.status, dtype=h5py.string_dtype())


def list_estimates(source: Path) -> list[Path]:
    """The files of estimates in a folder, or the one file given.

    Raises:
        InputError: there is none.
    """
    files = sorted([*source.glob("*.h5"), *source.glob("*.hdf5")]) if source.is_dir() else [source]
    if not files or not files[0].is_file():
        raise InputError(
            "There are no estimates.",
            where=str(source),
            allowed="a folder with .h5 files, or one such file",
            next_step="beambench estimate DATA -e NAME",
        )
    return files


def read_estimates(
    path: Path, count: int, shape: tuple[int, ...], *, modality: str = "gated", captures_sha256: str = ""
) -> Estimates:
    """Read one file and check it against the captures: `count` of them, each of `shape` (row, col).

    Main arguments:
        modality: of the captures; the file's, where it states one, must be the same.
        captures_sha256: of the captures' manifest (`CaptureSet.sha256`); the file's, where it states one, must be the same.

    Raises:
        InputError: not such a file, arrays of another shape or type, or estimates from other captures.
    Warns:
        UserWarning: the file does not tell from which captures it was made.
    """
    import h5py

    try:
        with h5py.File(path, "r") as file:
            _check_version(file, path)
            label = _text(file.attrs.get("estimator", path.stem))
            _check_origin(file, path, modality, captures_sha256)
            stacks = {name: _stack(file, name, path, (count, *shape)) for name in ("range", "sigma", "valid")}
            numbers = {name: _numbers(file, name, path, count) for name in ("cpu_s", "wall_s", "peak_bytes")}
            status = (
                [_text(item) for item in np.ravel(_dataset(file, "status", path)[()])]
                if "status" in file
                else ["ok"] * count
            )
            if len(status) != count:
                raise InputError(
                    "The estimates do not fit the captures.",
                    where=f"{path}: status",
                    value=len(status),
                    allowed=str(count),
                )
    except (OSError, KeyError, ValueError, TypeError, AttributeError, RuntimeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            "The estimates cannot be read.",
            where=str(path),
            value=str(error),
            allowed="HDF5 with range, sigma and valid",
        ) from error
    arrays: list[dict[str, NDArray[Any]] | None] = []
    for index in range(count):
        one = {
            "range": stacks["range"][index].astype(float),
            "sigma": stacks["sigma"][index].astype(float),
            "valid": stacks["valid"][index].astype(bool),
        }
        bad = one["valid"] & ~(np.isfinite(one["range"]) & np.isfinite(one["sigma"]) & (one["sigma"] > 0))
        if status[index] == "ok" and bad.any():
            status[index] = (
                f"invalid: range or sigma is not finite and positive at {int(bad.sum())} elements marked valid"
            )
        arrays.append(one if status[index] == "ok" else None)
    return Estimates(
        label, modality, arrays, numbers["cpu_s"], numbers["wall_s"], numbers["peak_bytes"], status, captures_sha256
    )


def _check_version(file: Any, path: Path) -> None:
    stated = np.ravel(file.attrs.get("schema_version", SCHEMA_VERSION))
    if stated.size != 1 or stated.dtype.kind not in "iuf" or stated[0] != SCHEMA_VERSION:
        raise InputError(
            "The estimates have another schema version.",
            where=f"{path}: schema_version",
            value=stated.tolist(),
            allowed=str(SCHEMA_VERSION),
        )


def _check_origin(file: Any, path: Path, modality: str, captures_sha256: str) -> None:
    """Refuse estimates of other captures: shapes that agree by chance would be scored against a foreign truth."""
    stated = _text(file.attrs.get("modality", modality))
    if stated != modality:
        raise InputError(
            "The estimates are of another modality than the captures.",
            where=f"{path}: modality",
            value=stated,
            allowed=modality,
        )
    source = _text(file.attrs.get("captures_sha256", ""))
    if not captures_sha256:
        return
    if not source:
        warnings.warn(
            f"{path.name} does not tell from which captures it was made (attribute captures_sha256, as `beambench export` "
            "hands it on), so that nothing shows that it fits.",
            stacklevel=3,
        )
    elif source != captures_sha256:
        raise InputError(
            "The estimates were made from other captures.",
            where=f"{path}: captures_sha256",
            value=source[:16],
            allowed=captures_sha256[:16],
            next_step="score them against the captures that they are of, or run beambench estimate anew",
        )


def _stack(file: Any, name: str, path: Path, shape: tuple[int, ...]) -> NDArray[Any]:
    if name not in file:
        raise InputError(f"The estimates hold no `{name}`.", where=str(path), allowed="range, sigma and valid")
    dataset = _dataset(file, name, path)
    if tuple(dataset.shape) != shape:
        # An estimator that failed on every capture leaves no image; its statuses tell why.
        if 0 in dataset.shape and dataset.shape[0] == shape[0]:
            return np.full(shape, np.nan if name != "valid" else False)
        raise InputError(
            "The estimates do not fit the captures.",
            where=f"{path}: {name}",
            value=tuple(dataset.shape),
            allowed=f"{shape}: (capture, row, col)",
        )
    values = np.asarray(dataset[()])
    if values.dtype.kind not in "biuf":
        raise InputError(
            f"The estimates' `{name}` holds no numbers.", where=f"{path}: {name}", value=str(values.dtype),
            allowed="floating point" if name != "valid" else "0 and 1",
        )  # fmt: skip
    if name == "valid" and not np.isin(values, (0, 1)).all():
        raise InputError("The estimates' `valid` is neither yes nor no.", where=f"{path}: valid", allowed="0 and 1")
    return values


def _dataset(file: Any, name: str, path: Path) -> Any:
    import h5py

    found = file[name]
    if not isinstance(found, h5py.Dataset) or found.shape is None:
        raise InputError(
            f"The estimates' `{name}` is no array.", where=f"{path}: {name}", value=type(found).__name__,
            allowed="a dataset over (capture, row, col)",
        )  # fmt: skip
    return found


def _numbers(file: Any, name: str, path: Path, count: int) -> list[float]:
    # A vector of a program without one-dimensional arrays is a row or a column.
    values = list(map(float, np.ravel(_dataset(file, name, path)[()]))) if name in file else []
    return values if len(values) == count else [math.nan] * count


def _text(value: Any) -> str:
    """Text of any string type of HDF5; MATLAB also writes it as an array of one."""
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.ravel()[0]
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
