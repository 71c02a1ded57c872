"""Files of estimates: one HDF5 file per estimator, written by Beambench or by another program.

Attributes: `schema_version` = 1, `estimator` (label; default: the file's name), `modality`, `stage` (default: the first of the
modality), and `captures_sha256`, the sha256 of the manifest of the captures that were read (`beambench export` copies it).
Datasets with a leading capture axis: the variables of the stage, such as `range` and `sigma` (capture, row, col) float, m, and
`valid` (capture, row, col) bool or 0/1; optional `cpu_s`, `wall_s`, `peak_bytes` (capture) and `status` (capture) text.
"""

from __future__ import annotations

import math
import warnings
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scenes.errors import InputError, reason
from .hdf5_input import Hdf5Input, hdf5_input
from .layouts import layout_of, stage_of
from .quantities import Stage, possible_sigma, possible_value

__all__ = ["Estimates", "list_estimates", "read_estimates", "write_estimates"]

SCHEMA_VERSION = 1
#: Longest dimension that an estimator may choose.
_LONGEST = 65536


@dataclass(frozen=True)
class Estimates:
    """Estimates of one estimator for all captures of a store; `arrays[i]` is None where it returned none for capture i."""

    label: str
    modality: str
    arrays: list[dict[str, NDArray[Any]] | None]
    cpu_s: list[float]
    wall_s: list[float]
    peak_bytes: list[float]
    status: list[str]
    captures_sha256: str = ""
    stage: str = ""

    @property
    def gives(self) -> Stage:
        """The stage of the estimator; if `stage` is empty, the first of the modality."""
        return stage_of(self.stage) if self.stage else layout_of(self.modality).stages[0]


def write_estimates(path: Path, estimates: Estimates) -> None:
    """Write a file completely or not at all. Raises InputError if the disk is full or the file cannot be written."""
    import h5py

    from .hdf5 import hdf5_output

    stage = estimates.gives
    with hdf5_output(path) as output:
        file = output.h5
        file.attrs.update(schema_version=SCHEMA_VERSION, estimator=estimates.label, modality=estimates.modality)
        file.attrs["stage"] = stage.word
        if estimates.captures_sha256:
            file.attrs["captures_sha256"] = estimates.captures_sha256
        for quantity in stage.gives:
            names = stage.variables(quantity)
            for name in names.all:
                stack = _stacked(estimates.arrays, name, len(stage.dims()[name]), flag=name == names.valid)
                dataset = file.create_dataset(
                    name,
                    data=stack,
                    chunks=(1, *stack.shape[1:]) if stack.size else None,
                    compression="gzip" if stack.size else None,
                    fletcher32=bool(stack.size),
                )
                if name != names.valid:
                    dataset.attrs["units"] = quantity.unit
        for name in ("cpu_s", "wall_s", "peak_bytes"):
            file.create_dataset(name, data=np.asarray(getattr(estimates, name), dtype="f8"))
        file.create_dataset("status", data=estimates.status, dtype=h5py.string_dtype())


def _stacked(arrays: list[dict[str, NDArray[Any]] | None], name: str, ndim: int, *, flag: bool) -> NDArray[Any]:
    """One variable of all captures; NaN (False) where the estimator returned nothing, or chose a shorter dimension."""
    shapes = [np.shape(one[name]) for one in arrays if one is not None]
    shape = tuple(max(lengths) for lengths in zip(*shapes, strict=True)) if shapes else (0,) * ndim
    stack = np.full((len(arrays), *shape), False if flag else np.nan, dtype="?" if flag else "f8")
    for index, one in enumerate(arrays):
        if one is not None:
            place: tuple[slice, ...] = tuple(slice(0, length) for length in np.shape(one[name]))
            stack[index][place] = one[name]
    return stack


def list_estimates(source: Path) -> list[Path]:
    """The files of estimates in a folder, or the one file given.

    Raises:
        InputError: there are none.
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
    path: Path, count: int, sizes: Mapping[str, int], *, modality: str, captures_sha256: str = ""
) -> Estimates:
    """Read one file and check that it fits `count` captures, each of `sizes` (dimension: length).

    Main arguments:
        modality: modality of the captures; if the file states one, it must be equal.
        captures_sha256: sha256 of the captures' manifest (`CaptureSet.sha256`); if the file states one, it must be equal.

    Raises:
        InputError: the file is not one of estimates, its arrays have another shape or type, or it is of other captures.
    Warns:
        UserWarning: the file does not state from which captures it was made.
    """
    variables = "the variables of a stage"
    try:
        with hdf5_input(path) as file:
            _check_version(file, path)
            label = _text(file.attribute("estimator", path.stem))
            _check_origin(file, path, modality, captures_sha256)
            stage = _stage(file, path, modality)
            variables = ", ".join(stage.dims())
            stacks = _stacks(file, path, count, stage, sizes)
            numbers = {name: _numbers(file, name, path, count) for name in ("cpu_s", "wall_s", "peak_bytes")}
            status = _statuses(file, path, count)
    except (
        OSError,
        KeyError,
        ValueError,
        TypeError,
        AttributeError,
        RuntimeError,
        OverflowError,
        MemoryError,
        zlib.error,
    ) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            "The estimates cannot be read.", where=str(path), value=reason(error), allowed=f"HDF5 with {variables}"
        ) from error
    arrays: list[dict[str, NDArray[Any]] | None] = []
    for index in range(count):
        one = {name: stack[index] for name, stack in stacks.items()}
        if status[index] == "ok":
            status[index] = _judged(one, stage)
        arrays.append(one if status[index] == "ok" else None)
    return Estimates(
        label, modality, arrays, numbers["cpu_s"], numbers["wall_s"], numbers["peak_bytes"], status, captures_sha256,
        stage.word,
    )  # fmt: skip


def _stage(file: Hdf5Input, path: Path, modality: str) -> Stage:
    """The stage that a file states, checked against the captures' modality; by default the modality's first."""
    first = layout_of(modality).stages[0]
    word = _text(file.attribute("stage", first.word))
    words = [stage.word for stage in layout_of(modality).stages]
    if word not in words:
        raise InputError(
            "The estimates are of a stage that these captures do not have.", where=f"{path}: stage", value=word,
            allowed=", ".join(words),
        )  # fmt: skip
    return stage_of(word)


def _stacks(file: Hdf5Input, path: Path, count: int, stage: Stage, sizes: Mapping[str, int]) -> dict[str, NDArray[Any]]:
    """All variables of a stage, checked, as float or (flags) bool."""
    known = dict(sizes)
    stacks: dict[str, NDArray[Any]] = {}
    flags = {stage.variables(quantity).valid for quantity in stage.gives}
    for name, dims in stage.dims().items():
        if name in file:  # the estimator chooses the length of a dimension that the captures lack
            lengths = file.shape(name)[1:]
            known |= {dim: n for dim, n in zip(dims, lengths, strict=False) if dim not in known and 0 < n <= _LONGEST}
        shape = (count, *(known.get(dim, 0) for dim in dims))
        stack = _stack(file, name, path, shape, flag=name in flags, allowed=", ".join(stage.dims()))
        stacks[name] = stack.astype(bool if name in flags else float)
    return stacks


def _statuses(file: Hdf5Input, path: Path, count: int) -> list[str]:
    if "status" not in file:
        return ["ok"] * count
    if (found := math.prod(file.shape("status"))) != count:
        raise InputError(
            "The estimates do not fit the captures.", where=f"{path}: status", value=found, allowed=str(count)
        )
    return [_text(item) for item in np.ravel(file.array("status"))]


def _judged(one: dict[str, NDArray[Any]], stage: Stage) -> str:
    """Status of the estimate of one capture: "ok", or what is wrong with its numbers."""
    for quantity in stage.gives:
        names = stage.variables(quantity)
        value, sigma, valid = (one[name] for name in names.all)
        valid = valid.reshape(valid.shape + (1,) * len(quantity.components))
        with np.errstate(invalid="ignore"):
            bad = valid & ~(possible_value(value) & possible_sigma(sigma))
        if bad.any():
            return (
                f"invalid: {names.value} or {names.sigma} is not finite and positive at {int(bad.sum())} elements marked "
                "valid"
            )
    return "ok"


def _check_version(file: Hdf5Input, path: Path) -> None:
    stated = np.ravel(file.attribute("schema_version", SCHEMA_VERSION))
    if stated.size != 1 or stated.dtype.kind not in "iuf" or stated[0] != SCHEMA_VERSION:
        raise InputError(
            "The estimates have another schema version.",
            where=f"{path}: schema_version",
            value=stated.tolist(),
            allowed=str(SCHEMA_VERSION),
        )


def _check_origin(file: Hdf5Input, path: Path, modality: str, captures_sha256: str) -> None:
    """Refuse estimates of other captures: equal shapes would have them scored against another capture's truth."""
    stated = _text(file.attribute("modality", modality))
    if stated != modality:
        raise InputError(
            "The estimates are of another modality than the captures.",
            where=f"{path}: modality",
            value=stated,
            allowed=modality,
        )
    source = _text(file.attribute("captures_sha256", ""))
    if not captures_sha256:
        return
    if not source:
        warnings.warn(
            f"{path.name} does not state from which captures it was made (attribute captures_sha256, which `beambench export` "
            "writes), so it cannot be checked against these captures.",
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


def _stack(file: Hdf5Input, name: str, path: Path, shape: tuple[int, ...], *, flag: bool, allowed: str) -> NDArray[Any]:
    if name not in file:
        raise InputError(f"The estimates hold no `{name}`.", where=str(path), allowed=allowed)
    found = file.shape(name)
    if found != shape:
        # An estimator that failed on every capture writes no image; its statuses give the reasons.
        if 0 in found and found[0] == shape[0]:
            return np.full(shape, False if flag else np.nan)
        raise InputError(
            "The estimates do not fit the captures.",
            where=f"{path}: {name}",
            value=found,
            allowed=f"{shape}: (capture, row, col)",
        )
    values = file.array(name)
    if values.dtype.kind not in "biuf":
        raise InputError(
            f"The estimates' `{name}` holds no numbers.", where=f"{path}: {name}", value=str(values.dtype),
            allowed="0 and 1" if flag else "floating point",
        )  # fmt: skip
    if flag and not np.isin(values, (0, 1)).all():
        raise InputError(
            "The estimates' `valid` holds values other than 0 and 1.", where=f"{path}: {name}", allowed="0 and 1"
        )
    return values


def _numbers(file: Hdf5Input, name: str, path: Path, count: int) -> list[float]:
    # A program without one-dimensional arrays writes a vector as a row or a column.
    if name not in file or math.prod(file.shape(name)) != count:
        return [math.nan] * count
    return list(map(float, np.ravel(file.array(name))))


def _text(value: Any) -> str:
    """Text from any string type of HDF5. MATLAB also writes text as an array of length 1."""
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.ravel()[0]
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
