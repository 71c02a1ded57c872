"""Temporary files of a run: captures that children read and, in a separate folder, the truth that scores them."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import xarray as xr

from ...captures.hide import hide_truth
from ...captures.sizes import sizes_of
from ...scenes.errors import InputError, reason
from ..scores.truth import Bound, Truth
from ..suites.suite import Cell
from .protocol import file_sums, write_capture, write_meta
from .scratch import scratch_folder

__all__ = ["Entry", "Spool", "unusable"]


@dataclass(frozen=True)
class Entry:
    """One spooled capture: its cell, its folder for children, the checksums of its files, and its size in bytes."""

    index: int
    cell: Cell
    folder: Path
    modality: str
    sizes: dict[str, int]
    sums: dict[str, str]
    bytes: int


def unusable(error: OSError) -> InputError:
    """The error of a temporary folder that is full or cannot be written."""
    return InputError(
        "The folder for temporary files cannot be used.",
        where=tempfile.gettempdir(),
        value=reason(error),
        next_step="make room there, or set TMPDIR to another folder",
    )


class Spool:
    """Two private folders, deleted at the end or, after a kill, by the next run.

    Children know the path of `open`, but never that of `closed`.

    Captures and truth are on disk, so that one capture is in memory at a time, for suites of any size.
    """

    def __init__(self) -> None:
        self._folders = ExitStack()
        try:
            self.open = self._folders.enter_context(scratch_folder("run"))
            self.closed = self._folders.enter_context(scratch_folder("truth"))
        except OSError as error:
            self._folders.close()
            raise unusable(error) from error

    def __enter__(self) -> Spool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._folders.close()

    def add(
        self,
        index: int,
        cell: Cell,
        capture: xr.Dataset,
        conditions: dict[str, Callable[[xr.Dataset], xr.Dataset]],
        truth: Mapping[str, Truth],
        bound: Mapping[str, Bound],
    ) -> Entry:
        """Spool a capture under each condition (name -> function that changes a capture without truth).

        Raises:
            InputError: the temporary folder is full or cannot be written.
        """
        try:
            return self._add(index, cell, capture, conditions, truth, bound)
        except OSError as error:
            raise unusable(error) from error

    def _add(
        self,
        index: int,
        cell: Cell,
        capture: xr.Dataset,
        conditions: dict[str, Callable[[xr.Dataset], xr.Dataset]],
        truth: Mapping[str, Truth],
        bound: Mapping[str, Bound],
    ) -> Entry:
        folder = self.open / f"{index:06d}"
        hidden = hide_truth(capture)
        write_capture(folder, hidden)
        for name, change in conditions.items():
            write_meta(folder, change(hidden), name, hidden)
        np.savez(self.closed / f"{index:06d}.npz", **_flat(truth, bound))  # type: ignore[arg-type]
        size = sum(path.stat().st_size for path in folder.iterdir())
        sizes = sizes_of(hidden)
        return Entry(index, cell, folder, str(capture.attrs["modality"]), sizes, file_sums(folder), size)

    def truth(self, entry: Entry) -> tuple[dict[str, Truth], dict[str, Bound]]:
        """The truth and the bound that score the estimates of an entry."""
        with np.load(self.closed / f"{entry.index:06d}.npz", allow_pickle=False) as data:
            return _nested(dict(data))

    def intact(self, entry: Entry) -> bool:
        """Whether the files of the capture are unchanged."""
        return entry.folder.is_dir() and file_sums(entry.folder) == entry.sums

    def drop(self, entry: Entry) -> None:
        """Delete an entry."""
        shutil.rmtree(entry.folder, ignore_errors=True)
        (self.closed / f"{entry.index:06d}.npz").unlink(missing_ok=True)


def _flat(truth: Mapping[str, Truth], bound: Mapping[str, Bound]) -> dict[str, np.ndarray[Any, Any]]:
    """Truth and bounds as arrays by name."""
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    for name, true in truth.items():
        arrays |= {f"{name}:value": true.value, f"{name}:mixed": true.mixed}
        arrays |= {f"{name}:other-{number}": other for number, other in enumerate(true.alternatives)}
        one = bound[name]
        arrays |= {f"{name}:bound": one.sigma, f"{name}:kind": np.array(one.kind)}
        arrays[f"{name}:scales"] = np.array([one.scale, one.window, one.drawn])
    return arrays


def _nested(arrays: dict[str, np.ndarray[Any, Any]]) -> tuple[dict[str, Truth], dict[str, Bound]]:
    """Inverse of `_flat`."""
    truth: dict[str, Truth] = {}
    bound: dict[str, Bound] = {}
    for name in [key.removesuffix(":value") for key in arrays if key.endswith(":value")]:
        others = sorted(key for key in arrays if key.startswith(f"{name}:other-"))
        truth[name] = Truth(arrays[f"{name}:value"], arrays[f"{name}:mixed"], tuple(arrays[key] for key in others))
        scale, window, drawn = map(float, arrays[f"{name}:scales"])
        bound[name] = Bound(arrays[f"{name}:bound"], str(arrays[f"{name}:kind"]), scale, window, drawn)
    return truth, bound
