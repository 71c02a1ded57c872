"""One variable of a capture from files: read, cut, stacked, its axes in order, its unit that of the capture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...scenes.errors import InputError
from ..layouts.schema import Variable
from .files import read_recording
from .mapping import Tags, Values
from .recording import MOST_BYTES, Array, Recording
from .units import factor

__all__ = ["EvenValues", "Files", "variable_of"]


@dataclass(frozen=True)
class EvenValues:
    """start + step·k in the unit of the capture; their number follows from the other variables."""

    start: float
    step: float
    unit: str


class Files:
    """The recordings of one import: a folder or several files; each is read once.

    Main arguments:
        given: files, or one folder, as typed.
    """

    def __init__(self, given: tuple[Path, ...]) -> None:
        self.folder = given[0] if len(given) == 1 and given[0].is_dir() else None
        self.given = () if self.folder is not None else given
        self.used: list[Path] = []
        self._read: dict[Path, Recording] = {}

    def path(self, name: str, where: str) -> Path:
        """The file of a name: in the folder, or among the given files. Raises InputError where it is not there."""
        if self.folder is None:
            for path in self.given:
                if path.name == name:
                    return path
            raise InputError(
                "A file that the mapping names is not given.", where=where, value=name,
                allowed=", ".join(path.name for path in self.given), next_step="name its folder, or the file too",
            )  # fmt: skip
        path = self.folder / name
        # Links of the user's own folder may lead elsewhere; the mapping's names may not.
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise InputError("A mapping names files of the given folder only.", where=where, value=name)
        if not path.is_file():
            raise InputError("A file that the mapping names is not in the folder.", where=where, value=name)
        return path

    def read(self, path: Path) -> Recording:
        """The content of a file; kept for the next variable."""
        if path not in self._read:
            self._read[path] = read_recording(path)
            self.used.append(path)
        return self._read[path]


def variable_of(
    variable: Variable, spec: Values, files: Files, names: tuple[str, ...], where: str, averaged: bool = False
) -> Any:
    """The values of a variable as `make_capture` takes them, with their unit.

    Main arguments:
        variable: of the layout. spec: where it comes from. files: the recordings. names: files of this capture; () for the
            spec's own.
    Other arguments:
        where: for messages. averaged: counts may be floats.

    Raises InputError.
    """
    import xarray as xr

    bare = variable.dtypes[0] == "bool" or (variable.dtypes[0].startswith(("int", "uint")) and variable.units == ("1",))
    unit, scale = (variable.units[0], 1.0) if bare and not spec.units else factor(spec.units, variable.units, where)
    if spec.even is not None:
        return EvenValues(spec.even.start * scale, spec.even.step * scale, unit)
    values = _given(variable, spec, files, names, where)
    if variable.dtypes[0] == "bool":
        return np.asarray(values).astype(bool)
    if np.ndim(values) == 0:
        return values if bare else (values * spec.scale + spec.offset) * scale
    if bare or (spec.scale * scale == 1.0 and spec.offset == 0.0 and not spec.invalid):
        changed = values
    else:
        changed = (np.asarray(values, np.float64) * spec.scale + spec.offset) * scale
        for bad in spec.invalid:
            changed[np.asarray(values) == bad] = np.nan
    return xr.DataArray(_dtype(np.asarray(changed), variable, averaged, where), attrs={"units": unit})


def _dtype(values: Array, variable: Variable, averaged: bool, where: str) -> Array:
    """Values in a dtype of the layout, if none of them changes."""
    if variable.name == "counts":
        if averaged:
            return values.astype(np.float32)
        if values.dtype == np.uint16:
            return values
        whole = values.dtype.kind in "biuf" and bool(
            np.isfinite(values).all() and (values >= 0).all() and (values < 65536).all() and (values == np.rint(values)).all()
        )  # fmt: skip
        if not whole:
            raise InputError(
                "The frames are not whole counts from 0 to 65535.", where=where, value=str(values.dtype),
                allowed="averaged = true, for means or processed frames",
            )  # fmt: skip
        return values.astype(np.uint16)
    if values.dtype.name in variable.dtypes:
        return values
    return values.astype(variable.dtypes[0]) if values.dtype.kind in "biuf" else values


def _given(variable: Variable, spec: Values, files: Files, names: tuple[str, ...], where: str) -> Any:
    if spec.values is not None:
        return spec.values if np.ndim(spec.values) == 0 else np.asarray(spec.values)
    paths = [files.path(name, where) for name in (names or spec.files)] or list(files.given)
    if not paths:
        raise InputError(
            "No file is named for a variable.", where=where, allowed=f"{where}.files, or files behind `import`"
        )
    if spec.header:
        facts = files.read(paths[0]).header
        if spec.header not in facts:
            raise InputError(
                "The file's header has no such fact.", where=f"{where}.header", value=spec.header,
                allowed=", ".join(sorted(facts)) or "none",
            )  # fmt: skip
        try:
            return float(facts[spec.header])
        except ValueError as error:
            raise InputError(
                "The fact of the header is no number.", where=f"{where}.header", value=facts[spec.header]
            ) from error
    if spec.tags is not None:
        return _counted(files.read(paths[0]), spec.tags, where)
    return _stacked(variable, spec, files, paths, where)


def _counted(recording: Recording, tags: Tags, where: str) -> Array:
    """Histogram (shot, sample) of time tags."""
    _, scale = factor(tags.units, ("s",), f"{where}.tags")
    time = np.asarray(recording.array(tags.time, where), np.float64).ravel() * scale
    shot = np.zeros(time.size, np.int64)
    if tags.shot:
        shot = np.asarray(recording.array(tags.shot, where)).ravel().astype(np.int64)
    if shot.size != time.size or (shot.size and (shot.min() < 0 or shot.max() >= tags.shots)):
        raise InputError(
            "The tags' shots do not fit.", where=f"{where}.tags.shot", value=f"{shot.size} numbers of {time.size} tags",
            allowed=f"one number from 0 to {tags.shots - 1} per tag",
        )  # fmt: skip
    place = np.floor((time - tags.start_s) / tags.step_s + 0.5)
    inside = np.isfinite(place) & (place >= 0) & (place < tags.samples)
    flat = shot[inside] * tags.samples + place[inside].astype(np.int64)
    return np.bincount(flat, minlength=tags.shots * tags.samples).reshape(tags.shots, tags.samples).astype(np.float64)


def _stacked(variable: Variable, spec: Values, files: Files, paths: list[Path], where: str) -> Array:
    parts: list[Array] = []
    axes = spec.axes
    for path in paths:
        recording = files.read(path)
        array = recording.array(spec.array, f"{where}: {path.name}")
        main = array is next(iter(recording.arrays.values()))
        axes = (
            spec.axes or (recording.axes if main else ()) or (variable.dims if len(paths) == 1 else variable.dims[1:])
        )
        if array.dtype.kind not in "biuf" or len(axes) != array.ndim:
            raise InputError(
                "The axes do not fit the file's array.", where=f"{where}.axes: {path.name}",
                value=f"{list(axes)} for {array.dtype} {array.shape}", allowed=f"{array.ndim} names, e.g. {list(variable.dims)}",
            )  # fmt: skip
        part, names = _cut(array, axes, spec, where)
        if parts and part.shape != parts[0].shape:
            raise InputError(
                "The files are of different sizes.", where=f"{where}: {path.name}", value=part.shape, allowed=str(parts[0].shape)
            )  # fmt: skip
        parts.append(part)
        if sum(one.nbytes for one in parts) > MOST_BYTES:
            raise InputError("The files together are too large.", where=where, allowed=f"{MOST_BYTES:,} bytes")
    names = _page_is(variable, names)
    if spec.stack or len(parts) > 1:
        stack = spec.stack or next((dim for dim in variable.dims if dim not in names), "")
        joined = np.concatenate(parts, axis=names.index(stack)) if stack in names else np.stack(parts)
        names = names if stack in names else (stack, *names)
    else:
        joined = parts[0]
    return _ordered(joined, names, variable, where)


def _page_is(variable: Variable, names: tuple[str, ...]) -> tuple[str, ...]:
    """A picture's pages are the dimension that the variable has before its rows and columns."""
    return tuple(variable.dims[0] if name == "page" and "row" in variable.dims else name for name in names)


def _cut(array: Array, axes: tuple[str, ...], spec: Values, where: str) -> tuple[Array, tuple[str, ...]]:
    for name, (first, last) in spec.crop.items():
        if name not in axes or not 0 <= first < last <= array.shape[axes.index(name)]:
            raise InputError(
                "The crop does not lie in the array.", where=f"{where}.crop.{name}", value=[first, last],
                allowed=f"axes {list(axes)}, sizes {array.shape}",
            )  # fmt: skip
        array = array[(slice(None),) * axes.index(name) + (slice(first, last),)]
    for name, places in spec.roll.items():
        if name not in axes:
            raise InputError("The array has no such axis.", where=f"{where}.roll", value=name, allowed=", ".join(axes))
        array = np.roll(array, places, axis=axes.index(name))
    if spec.channels:
        if "channel" not in axes or array.shape[axes.index("channel")] != len(spec.channels):
            raise InputError(
                "The weights do not fit the channels.", where=f"{where}.channels", value=list(spec.channels),
                allowed=f"axes {list(axes)}, sizes {array.shape}",
            )  # fmt: skip
        array = np.tensordot(array.astype(np.float64), np.asarray(spec.channels), (axes.index("channel"), 0))
        axes = tuple(name for name in axes if name != "channel")
    return array, axes


def _ordered(array: Array, names: tuple[str, ...], variable: Variable, where: str) -> Array:
    """The axes in the order of the layout; one that the file lacks gets the length 1."""
    for dims in variable.allowed_dims:
        if set(names) <= set(dims) and len(dims) - len(names) <= 1 and len({*names}) == len(names):
            moved = array.transpose([names.index(name) for name in dims if name in names])
            return np.expand_dims(moved, tuple(i for i, name in enumerate(dims) if name not in names))
    allowed = " or ".join(str(list(dims)) for dims in variable.allowed_dims)
    raise InputError(
        "The axes are not those of the variable.", where=f"{where}.axes", value=list(names), allowed=allowed
    )
