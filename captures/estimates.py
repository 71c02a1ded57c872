"""Files of estimates: one HDF5 file per estimator, written by Beambench or by another program.

Attributes: `schema_version` = 1, `estimator` (label; default: the file's name), `modality`, `stage` (default: the first of the
modality), and `captures_sha256`, the sha256 of the manifest of the captures that were read (`beambench export` copies it).
Datasets with a leading capture axis: the variables of the stage, such as `range` and `sigma` (capture, row, col) float, m, and
`valid` (capture, row, col) bool or 0/1; `sigma` may be missing (no errors are stated); optional `cpu_s`,
`wall_s`, `peak_bytes` (capture) and `status` (capture) text.
"""

from __future__ import annotations

import difflib
import math
import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..scenes.errors import InputError, reason
from ..scenes.nearest import did_you_mean
from .hdf5_input import Hdf5Input, hdf5_input
from .layouts import layout_of, stage_of
from .quantities import Stage, possible_sigma, possible_value

if TYPE_CHECKING:
    from .hdf5 import Hdf5Output

__all__ = ["Estimates", "EstimatesOutput", "estimates_output", "list_estimates", "read_estimates", "write_estimates"]

SCHEMA_VERSION = 1
#: Longest dimension that an estimator may choose.
_LONGEST = 65536
#: Most arrays that an error message looks through.
_MOST_NAMES = 1000


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
    with estimates_output(path, estimates.label, estimates.modality, estimates.captures_sha256) as output:
        for number, arrays in enumerate(estimates.arrays):
            costs = (estimates.cpu_s[number], estimates.wall_s[number], estimates.peak_bytes[number])
            output.add(arrays, estimates.gives, costs, estimates.status[number])


@contextmanager
def estimates_output(path: Path, label: str, modality: str, captures_sha256: str = "") -> Iterator[EstimatesOutput]:
    """A file of estimates that takes one capture after the other, and is there when the block has ended without an error.

    Main arguments:
        path: the file. label, modality, captures_sha256: as of `Estimates`.

    Raises InputError if the disk is full or the file cannot be written.
    """
    from .hdf5 import hdf5_output

    with hdf5_output(path) as output:
        file = output.h5
        file.attrs.update(schema_version=SCHEMA_VERSION, estimator=label, modality=modality)
        if captures_sha256:
            file.attrs["captures_sha256"] = captures_sha256
        taken = EstimatesOutput(output)
        yield taken
        taken.finish(layout_of(modality).stages[0])


class EstimatesOutput:
    """An open file of estimates: one capture is in memory at a time."""

    def __init__(self, output: Hdf5Output) -> None:
        self._output, self._stage = output, ""
        #: Status of each capture so far.
        self.status: list[str] = []
        self._costs: list[tuple[float, float, float]] = []

    def add(
        self, arrays: Mapping[str, NDArray[Any]] | None, stage: Stage, costs: tuple[float, float, float], status: str
    ) -> None:
        """Append the estimates of one capture, None where there are none; `costs` are cpu_s, wall_s, peak_bytes."""
        number = len(self.status)
        self.status.append(status)
        self._costs.append(costs)
        if not number:
            # The first capture tells the stage also where the estimator gave nothing.
            self._stage = stage.word
        if arrays is None:
            return
        for quantity in stage.gives:
            names = stage.variables(quantity)
            for name in names.all:
                self._put(number, name, np.asarray(arrays[name]), name == names.valid, quantity.unit)
        self._output.check()

    def _put(self, number: int, name: str, values: NDArray[Any], flag: bool, unit: str) -> None:
        """One variable of one capture; NaN (False) where an estimator chose a shorter dimension than for others."""
        file = self._output.h5
        if name not in file:
            self._create(name, values.shape, flag, unit)
        dataset = file[name]
        shape = (number + 1, *(max(pair) for pair in zip(dataset.shape[1:], values.shape, strict=True)))
        dataset.resize(shape)
        dataset[(number, *(slice(0, length) for length in values.shape))] = values

    def _create(self, name: str, shape: tuple[int, ...], flag: bool, unit: str) -> None:
        whole = all(shape)
        dataset = self._output.h5.create_dataset(
            name, (0, *shape), dtype="?" if flag else "f8", maxshape=(None,) * (1 + len(shape)),
            chunks=(1, *(max(length, 1) for length in shape)), fillvalue=False if flag else np.nan,
            compression="gzip" if whole else None, fletcher32=whole,
        )  # fmt: skip
        if not flag:
            dataset.attrs["units"] = unit

    def finish(self, first: Stage) -> None:
        """Write what is known at the end; `first` is the stage where nothing was added."""
        import h5py

        file, count = self._output.h5, len(self.status)
        stage = stage_of(self._stage) if self._stage else first
        file.attrs["stage"] = stage.word
        for quantity in stage.gives:
            names = stage.variables(quantity)
            for name in names.all:
                if name not in file:
                    self._create(name, (0,) * len(stage.dims()[name]), name == names.valid, quantity.unit)
                file[name].resize(count, axis=0)
        for name, values in zip(("cpu_s", "wall_s", "peak_bytes"), zip(*self._costs, strict=True), strict=False):
            file.create_dataset(name, data=np.asarray(values, dtype="f8"))
        file.create_dataset("status", data=self.status, dtype=h5py.string_dtype())


def list_estimates(source: Path) -> list[Path]:
    """The files of estimates in a folder, or the one file given.

    Raises:
        InputError: there are none, or nothing of that name.
    """
    if not source.exists():
        there = sorted(path.name for path in source.parent.glob("*")) if source.parent.is_dir() else []
        raise InputError(
            "There is no such file or folder of estimates.", where=str(source), value=source.name,
            allowed="a folder with .h5 files, or one such file",
            next_step=did_you_mean(source.name, there, "beambench estimate DATA -e NAME", folder=source.parent),
        )  # fmt: skip
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
            unstated = frozenset(name for name in stacks if name not in file)
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
            status[index] = _judged(one, stage, unstated)
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
    names = [stage.variables(quantity) for quantity in stage.gives]
    flags, sigmas = {one.valid for one in names}, {one.sigma for one in names}
    for name, dims in stage.dims().items():
        if name in file:  # the estimator chooses the length of a dimension that the captures lack
            lengths = file.shape(name)[1:]
            known |= {dim: n for dim, n in zip(dims, lengths, strict=False) if dim not in known and 0 < n <= _LONGEST}
        shape = (count, *(known.get(dim, 0) for dim in dims))
        if name in sigmas and name not in file:  # a program that states no errors: they are unknown, never invented
            stacks[name] = np.full(shape, np.nan)
            continue
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


def _judged(one: dict[str, NDArray[Any]], stage: Stage, unstated: frozenset[str]) -> str:
    """Status of the estimate of one capture: "ok", or what is wrong with its numbers. Sigmas that are `unstated` are not judged."""
    for quantity in stage.gives:
        names = stage.variables(quantity)
        value, sigma, valid = (one[name] for name in names.all)
        valid = valid.reshape(valid.shape + (1,) * len(quantity.components))
        with np.errstate(invalid="ignore"):
            sound = possible_value(value)
            if names.sigma not in unstated:
                sound &= possible_sigma(sigma)
        bad = valid & ~sound
        if bad.any():
            what = f"{names.value} is not finite" if names.sigma in unstated else (
                f"{names.value} or {names.sigma} is not finite and positive"
            )  # fmt: skip
            return f"invalid: {what} at {int(bad.sum())} elements marked valid"
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
        held = file.names(_MOST_NAMES)
        near = difflib.get_close_matches(name, held, n=1)
        raise InputError(
            f"The estimates hold no `{name}`.", where=str(path), value=", ".join(held) or "no arrays", allowed=allowed,
            next_step=f"rename `{near[0]}` to `{name}`" if near else "docs/external-estimators.md has the format",
        )  # fmt: skip
    found = file.shape(name)
    if found != shape:
        # An estimator that failed on every capture writes no image; its statuses give the reasons.
        if 0 in found and found[0] == shape[0]:
            return np.full(shape, False if flag else np.nan)
        raise InputError(
            "The estimates do not fit the captures.",
            where=f"{path}: {name}",
            value=found,
            allowed=str(shape),
            next_step="rows and columns are exchanged: docs/external-estimators.md has the order of the axes"
            if len(shape) > 2 and found == (*shape[:-2], shape[-1], shape[-2])
            else "docs/external-estimators.md has the axes",
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
