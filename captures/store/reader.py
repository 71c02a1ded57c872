"""Read a store: it is checked when opened; each capture is loaded on demand."""

from __future__ import annotations

import math
import operator
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsIndex

import numpy as np

from ...scenes.errors import InputError
from ...scenes.json_keys import read_json
from ...scenes.machine import free_bytes
from ..validate import validate
from .arrays import Structure, chunk_bytes, decode_attributes, open_arrays
from .layout import LARGE_BYTES, array_problem, attributes_problem, group_structure, size_problem
from .manifest import (
    ASK_FOR_RIGHTS,
    UNREADABLE,
    Manifest,
    Mark,
    check_metadata,
    load_manifest,
    read_problem,
    refused_metadata,
    regular_size,
    safe_join,
)
from .publish import partial_of
from .verification import chunk_problem

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["CaptureIndexError", "CaptureSet", "open_flat", "unchecked_captures"]


class CaptureIndexError(InputError, IndexError):
    """There is no capture of this index."""


def open_flat(path: str | os.PathLike[str]) -> CaptureSet:
    """Open the store of one file per chunk at `path`, as `faces.open_captures` does.

    Raises InputError: no such path, a file, not a store, an unfinished one, another version, damaged metadata, missing or
    truncated chunks. Damage inside a chunk is detected when its capture is read, or by `verify`.
    """
    root = Path(path).expanduser()
    _check_kind(root)
    manifest = load_manifest(root)
    problems = check_metadata(root, manifest)
    names = {name.rpartition("/")[0] for name in manifest.metadata} - {""}
    if not problems:
        for array, marks in manifest.chunks.items():
            folder = safe_join(root, array)
            for key, (size, _) in marks.items():
                try:
                    found = regular_size(safe_join(folder, key))
                except OSError as error:
                    problems.append((f"{array}/{key}", read_problem(error)))
                    continue
                if found != size:
                    problems.append((f"{array}/{key}", "missing" if found is None else f"{found} bytes, not {size}"))
    if problems:
        raise _refusal(root, problems)
    for array in names:
        if (root / array).is_symlink():
            raise InputError("A folder of the store is a link, which leads out of it.", where=str(root / array))
    return unchecked_captures(root, manifest)


def _refusal(root: Path, problems: list[tuple[str, str]]) -> InputError:
    refused = [entry for entry in problems if entry[1].startswith(UNREADABLE)]
    (name, problem), *more = refused or problems
    listed = f"{name}: {problem}" + (f", and {len(more)} more" if more else "")
    if refused:
        return InputError(f"A file of the store cannot be read: {listed}.", where=str(root), next_step=ASK_FOR_RIGHTS)
    if any(name.endswith("zarr.json") for name, _ in problems):
        return refused_metadata(root, listed)
    return InputError(
        f"The store is damaged: {listed}.",
        where=str(root),
        next_step=f"`beambench data verify {root}` lists the damage, `beambench data repair {root}` keeps the intact captures",
    )


def unchecked_captures(root: Path, manifest: Manifest) -> CaptureSet:
    """The captures that `manifest` lists in `root`, whose metadata are intact. Raises InputError if they disagree."""
    try:
        structure, attributes = _checked(root, manifest)
        captures = CaptureSet(
            root,
            manifest.modality,
            structure,
            attributes["captures"],
            attributes["texts"],
            manifest.chunks,
            manifest.sha256,
        )
        expected = {name: array.nchunks for name, array in captures.arrays.items()}
        agree = expected == {name: len(marks) for name, marks in manifest.chunks.items()}
    except (KeyError, TypeError, ValueError, AttributeError, OSError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"The metadata of the store are not those of captures: {error!r}.", where=str(root)) from error
    if not agree:
        raise InputError(
            "The metadata and the manifest of the store disagree on the number of chunks.", where=str(root)
        )
    return captures


def _checked(root: Path, manifest: Manifest) -> tuple[Structure, dict[str, Any]]:
    """Structure and attributes of a store, from its metadata, bounded before any array is opened.

    Raises KeyError, TypeError, ValueError, AttributeError, OSError, RecursionError, InputError.
    """
    attributes = read_json((root / "zarr.json").read_bytes())["attributes"]
    arrays = {name: read_json((safe_join(root, name) / "zarr.json").read_bytes()) for name in attributes["variables"]}
    structure = group_structure(attributes, arrays)
    if attributes["modality"] != manifest.modality:
        raise ValueError(f"their modality is {attributes['modality']!r}, not {manifest.modality!r}")
    if set(structure) != set(manifest.chunks) or len(attributes["captures"]) != manifest.count:
        raise InputError(
            "The metadata and the manifest of the store disagree on the number of chunks.", where=str(root)
        )
    problems = [f"{name}: {found}" for name, entry in structure.items()
                if (found := array_problem(arrays[name], entry, manifest.count))]  # fmt: skip
    problems += [f"capture {index}: {found}" for index, encoded in enumerate(attributes["captures"])
                 if (found := attributes_problem(encoded, attributes["texts"]))]  # fmt: skip
    if problems or (problems := list(filter(None, [size_problem(structure, manifest.chunks)]))):
        raise ValueError(problems[0])
    return structure, attributes


class CaptureSet:
    """The captures of a store as a sequence: `len(s)`, `s[i]`, `for capture in s`; one in memory at a time.

    `path` and `modality` describe them; `attributes(i)` reads the attributes of a capture without its arrays, and
    `load(i, names)` only some of its variables. `sha256` is that of the manifest and identifies the whole content.
    """

    def __init__(
        self,
        path: Path,
        modality: str,
        structure: Structure,
        records: list[dict[str, list[Any]]],
        texts: dict[str, str],
        chunks: dict[str, dict[str, Mark]],
        sha256: str = "",
    ) -> None:
        self.sha256 = sha256
        self.path, self.modality, self.variables = path, modality, tuple(structure)
        self._coordinates = frozenset(name for name, entry in structure.items() if entry["coord"])
        self._decoded = {name: chunk_bytes(entry) for name, entry in structure.items()}
        self._records, self._texts = records, texts
        self._marks: list[list[tuple[str, str, Mark]]] = [[] for _ in records]
        for array, marks in chunks.items():
            for key, mark in marks.items():
                self._marks[int(key.split(".")[1])].append((array, key, mark))
        self.arrays = open_arrays(path, structure, "r")

    def __len__(self) -> int:
        return len(self._records)

    def __iter__(self) -> Iterator[xr.Dataset]:
        return (self[i] for i in range(len(self)))

    def __getitem__(self, index: SupportsIndex) -> xr.Dataset:
        return self.load(index)

    def __repr__(self) -> str:
        return f"<CaptureSet of {len(self)} {self.modality} captures in {str(self.path)!r}>"

    def attributes(self, index: SupportsIndex) -> dict[str, Any]:
        """Attributes of one capture. Raises CaptureIndexError (an InputError and an IndexError)."""
        return decode_attributes(self._records[self._index(index)], self._texts)

    def number(self, index: SupportsIndex) -> int:
        """What tells a capture from others of the same scene: its seed, or its number in a data set of one seed."""
        return int(self.attributes(index).get("seed", self._index(index)))

    def load(self, index: SupportsIndex, names: Iterable[str] | None = None) -> xr.Dataset:
        """One capture in memory, without the `capture` dimension.

        Main arguments:
            index: 0 … len − 1, or negative from the end.
            names: the variables to read; all if None.

        Raises CaptureIndexError for the index; InputError for an unknown name, a missing or damaged chunk, or too little memory.
        """
        import xarray as xr

        number = self._index(index)
        wanted = self.variables if names is None else tuple(names)
        for name in wanted:
            if name not in self.arrays:
                raise InputError(
                    "The store has no such variable.",
                    where=str(self.path),
                    value=name,
                    allowed=", ".join(self.variables),
                )
        self._check_memory(wanted)
        self._check_marks(number, frozenset(wanted))
        data: dict[str, xr.Variable] = {}
        coords: dict[str, xr.Variable] = {}
        for name in wanted:
            array = self.arrays[name]
            dims = (getattr(array.metadata, "dimension_names", None) or ())[1:]
            variable = xr.Variable(dims, self._read(name, number), dict(array.attrs))
            (coords if name in self._coordinates else data)[name] = variable
        capture = xr.Dataset(data, coords, self.attributes(number))
        if names is None:
            validate(capture, "layout", where=f"{self.path}: capture {number}")
        return capture

    def _index(self, index: SupportsIndex) -> int:
        try:
            number = operator.index(index)
        except TypeError as error:
            raise InputError("A capture must be selected by its number.", where=str(self.path), value=index) from error
        if not -len(self) <= number < len(self):
            raise CaptureIndexError(
                "There is no capture of this index.", where=str(self.path), value=number, allowed=f"0 … {len(self) - 1}"
            )
        return number % len(self)

    def _check_memory(self, wanted: Iterable[str]) -> None:
        arrays = (self.arrays[name] for name in wanted)
        self._check_room([{"dtype": one.dtype, "shape": one.shape[1:]} for one in arrays])

    def _check_room(self, entries: Iterable[dict[str, Any]]) -> None:
        size = sum(np.dtype(one["dtype"]).itemsize * math.prod(one["shape"]) for one in entries)
        if size > LARGE_BYTES and size > (free := free_bytes()):
            raise InputError(
                "A capture needs more than the free memory of this machine.",
                where=str(self.path), value=f"{size:,} bytes", allowed=f"{free:,} bytes",
                next_step="read some of its variables only (`load(i, names)`), or on a larger machine",
            )  # fmt: skip

    def _check_marks(self, number: int, wanted: frozenset[str]) -> None:
        # A chunk of another store or capture has a valid checksum of its own, and so has one that was forged: the marks differ.
        for array, key, mark in self._marks[number]:
            if array not in wanted:
                continue
            if self.path.joinpath(array).is_symlink():
                raise self._damage(array, "its folder is a link")
            problem = chunk_problem(self.path / array / key, mark, self._decoded[array])
            if problem.startswith(UNREADABLE):
                raise _refusal(self.path, [(f"{array}/{key}", problem)])
            if problem:
                raise self._damage(f"{array}/{key}", problem)

    def _read(self, name: str, number: int) -> np.ndarray[Any, Any]:
        try:
            return np.asarray(self.arrays[name][number])
        except PermissionError as error:
            raise _refusal(self.path, [(f"{name}, capture {number}", read_problem(error))]) from error
        except (OSError, ValueError, RuntimeError, TypeError) as error:
            raise self._damage(f"{name}, capture {number}", str(error)) from error

    def _damage(self, what: str, problem: str) -> InputError:
        return InputError(
            f"A chunk is damaged: {problem}.",
            where=f"{self.path}: {what}",
            next_step=f"`beambench data verify {self.path}` lists the damage, `beambench data repair {self.path}` "
            "keeps the intact captures",
        )


def _check_kind(root: Path) -> None:
    if root.is_dir():
        if root.name.endswith(".partial"):
            raise InputError(
                "The store is unfinished.",
                where=str(root),
                next_step=f"`beambench data finalize {root}` keeps its complete captures",
            )
        return
    if root.exists():
        raise InputError(
            "The path is a file, not a store of captures.",
            where=str(root), allowed="a folder written by beambench",
            next_step="`beambench generate SCENE --out PATH` creates a store",
        )  # fmt: skip
    raise InputError(
        "There is no such store.",
        where=str(root),
        next_step=_where_else(root),
    )  # fmt: skip


def _where_else(root: Path) -> str:
    partial, replaced = partial_of(root), root.with_name(root.name + ".replaced")
    if partial.is_dir():
        return f"`beambench data finalize {partial}` keeps the complete captures of an interrupted run"
    if replaced.is_dir():
        return f"it was being replaced when the writing stopped, and is still in {replaced}: give it its name back"
    return "`beambench generate SCENE --out PATH` creates a store"
