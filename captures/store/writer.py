"""Write captures to a store one by one: one is in memory at a time, and a crash loses at most one."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from ...scenes.errors import InputError
from ..validate import validate
from .arrays import (
    CAPACITY,
    Structure,
    chunk_keys,
    decode_attributes,
    encode_attributes,
    metadata_files,
    open_arrays,
    structure_of,
)
from .journal import (
    JOURNAL,
    Journal,
    Record,
    append_line,
    fsync_path,
    has_header,
    lock_journal,
    mark_journal,
    read_journal,
    refuse_busy,
    write_file,
)
from .manifest import Mark, chunk_mark
from .ownership import REPAIR_MARK, is_ours, is_removable_partial, remove_store, settle_replacement
from .publish import disk_error, partial_of, publish, refuse_existing
from .shard_manifest import is_sharded
from .verification import partial_damage, refused_partial

if TYPE_CHECKING:
    import xarray as xr
    import zarr

__all__ = ["CaptureWriter", "write"]


def write(
    path: str | os.PathLike[str],
    captures: xr.Dataset | Iterable[xr.Dataset],
    *,
    overwrite: bool = False,
    resume: bool = False,
) -> Path:
    """Write captures to the store `path` and return it; the name appears only when all are on disk.

    Main arguments:
        captures: one capture, or any iterable of them, consumed one by one; all of one modality, layout and shape.
        overwrite: replace an existing store, after the new one is complete.
        resume: append to `path`.partial, whose complete captures are kept (`CaptureWriter.count` of them); without one,
            begin a new store.

    Raises InputError: output exists, invalid capture, captures that differ in layout, disk full, folder not writable.
    If writing fails nothing appears under the final name; complete captures stay in `path`.partial for `finalize`.
    """
    import xarray as xr

    items = [captures] if isinstance(captures, xr.Dataset) else captures
    with CaptureWriter(path, overwrite=overwrite, resume=resume) as writer:
        for capture in items:
            writer.append(capture)
    return writer.path


class CaptureWriter:
    """A store being written, for use in a `with` block; leaving it without an error gives the store its name.

    Main arguments:
        path: the store; it is written as `path`.partial first.
        overwrite, resume: as for `write`.
    Other arguments:
        keep_replaced: the name that an overwritten store gets; it is removed if None.
        repairs: the store is the repair of one that stays as it is until this one is complete.

    `count` is the number of complete captures, `attributes(i)` the attributes of one. Raises InputError as `write` does.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        overwrite: bool = False,
        resume: bool = False,
        keep_replaced: Path | None = None,
        repairs: bool = False,
    ) -> None:
        self.path = Path(path).expanduser()
        self.partial = partial_of(self.path)
        self.overwrite, self._keep_replaced, self._repairs = overwrite, keep_replaced, repairs
        self._journal: Journal | None = None
        self._arrays: dict[str, zarr.Array[Any]] = {}
        self._texts: dict[str, str] = {}
        self._file: IO[bytes] | None = None
        if not self.path.name or self.path.name.endswith(".partial"):
            raise InputError(
                "This cannot be the name of a store.", where=str(path), allowed="a name without .partial at its end"
            )
        try:
            settle_replacement(self.path)
            refuse_existing(self.path, overwrite)
            if not (resume and self._reopen()):
                self._start(resume)
        except OSError as error:
            raise disk_error(error, "Creating the store", self.path) from error

    @property
    def count(self) -> int:
        """Number of complete captures on disk."""
        return len(self._journal.records) if self._journal else 0

    def attributes(self, index: int) -> dict[str, Any]:
        """Attributes of a complete capture, as in its `Dataset`. Raises IndexError."""
        if self._journal is None:
            raise IndexError(index)
        return decode_attributes(self._journal.records[index].attrs, self._texts)

    def append(self, capture: xr.Dataset) -> None:
        """Validate and write one capture; it is on disk when this returns. Raises InputError."""
        where = f"capture {self.count}"
        if self._file is None:
            raise InputError("The store is closed.", where=str(self.path), next_step="open a writer with resume=True")
        validate(capture, "values", where=where)
        structure = structure_of(capture)
        try:
            if self._journal is None:
                self._create(str(capture.attrs["modality"]), structure)
            journal = self._journal
            assert journal is not None
            self._check_same(str(capture.attrs["modality"]), structure, where)
            if self.count >= CAPACITY:
                raise InputError("The store is full.", where=str(self.path), value=self.count, allowed=f"< {CAPACITY}")
            new_texts: dict[str, str] = {}
            attrs = encode_attributes({str(k): v for k, v in capture.attrs.items()}, new_texts)
            new_texts = {key: text for key, text in new_texts.items() if key not in self._texts}
            chunks = {name: self._write_array(name, capture.variables[name]) for name in structure}
            append_line(self._file, {"attrs": attrs, "texts": new_texts, "chunks": chunks})
        except OSError as error:
            # The journal may now end in a torn line: nothing may be appended to it.
            self.abandon()
            raise disk_error(error, f"Writing {where}", self.path) from error
        self._texts.update(new_texts)
        journal.records.append(Record(attrs, new_texts, chunks))

    def close(self) -> None:
        """Give the store its final name. Raises InputError."""
        self._release()
        if self._journal is None or not self.count:
            self.abandon()
            raise InputError("There is no capture to write.", where=str(self.path), allowed="at least one capture")
        try:
            publish(self.partial, self.path, self._journal, overwrite=self.overwrite, keep_replaced=self._keep_replaced)
        except OSError as error:
            raise disk_error(error, "Completing the store", self.path, self._advice()) from error

    def abandon(self) -> None:
        """Stop without a store: complete captures stay in the partial folder; without any, the folder is removed."""
        self._release()
        if not self.count and is_removable_partial(self.partial):
            # Files of other origin stay, and the folder with them.
            with suppress(OSError, InputError):
                remove_store(self.partial)

    def __enter__(self) -> CaptureWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
            return
        self.abandon()
        if isinstance(error, InputError) and self.count:
            said = "; ".join(filter(None, [error.next_step, self._advice()]))
            raise InputError(
                error.what, where=error.where, value=error.value, allowed=error.allowed, next_step=said
            ) from error
        if self.count:
            error.add_note(self._advice())

    def _advice(self) -> str:
        return f"{self.count} complete captures are in {self.partial}: `beambench data finalize {self.partial}`"

    def _start(self, resume: bool) -> None:
        if os.path.lexists(self.partial):
            # Shards of a data set are not continued here, and not taken for a store without captures.
            begun = resume and not is_sharded(self.partial)
            if not (self.overwrite or begun) or not is_removable_partial(self.partial):
                raise InputError(
                    "An unfinished store is in the way.",
                    where=str(self.partial),
                    next_step=f"`beambench data finalize {self.partial}` keeps its complete captures; "
                    "--resume continues it; or remove it",
                )
            refuse_busy(self.partial)
            remove_store(self.partial)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.partial.mkdir()
        try:
            self._file = open(self.partial / JOURNAL, "xb")  # noqa: SIM115 (closed by _release)
            lock_journal(self._file, self.partial)
            if self._repairs:
                write_file(self.partial / REPAIR_MARK, b"a repair of the store beside it\n")
            mark_journal(self._file)
        except OSError:
            self._release()
            for name in (JOURNAL, REPAIR_MARK):
                (self.partial / name).unlink(missing_ok=True)
            self.partial.rmdir()
            raise

    def _reopen(self) -> bool:
        """Continue the partial store; False if there is none, or it has no capture yet."""
        if not is_ours(self.partial) or not has_header(self.partial):
            return False
        self._file = open(self.partial / JOURNAL, "r+b")  # noqa: SIM115 (closed by _release)
        try:
            lock_journal(self._file, self.partial)
            self._journal = journal = read_journal(self.partial)
            self._texts = journal.texts
            if damage := partial_damage(self.partial, journal):
                raise refused_partial(self.partial, damage)
            self._open_arrays(journal.structure)
        except BaseException:
            self._release()
            raise
        self._file.truncate(journal.sound_bytes)
        self._file.seek(journal.sound_bytes)
        return True

    def _create(self, modality: str, structure: Structure) -> None:
        self._open_arrays(structure)
        assert self._file is not None
        append_line(self._file, {"modality": modality, "structure": structure})
        self._journal = Journal(modality, structure)

    def _open_arrays(self, structure: Structure) -> None:
        for name, content in metadata_files(structure, CAPACITY, {}).items():
            (self.partial / name).parent.mkdir(exist_ok=True)
            write_file(self.partial / name, content)
        self._arrays = open_arrays(self.partial, structure, "r+")

    def _check_same(self, modality: str, structure: Structure, where: str) -> None:
        assert self._journal is not None
        first = {"modality": self._journal.modality} | self._journal.structure
        this = {"modality": modality} | structure
        for name in [*first, *(name for name in this if name not in first)]:
            if first.get(name) != this.get(name):
                raise InputError(
                    f"All captures of a store must have one layout, but {name} differs from the first capture.",
                    where=where, value=this.get(name), allowed=str(first.get(name)),
                    next_step="write captures of another layout to another store",
                )  # fmt: skip

    def _write_array(self, name: str, variable: xr.Variable) -> dict[str, Mark]:
        assert self._journal is not None
        self._arrays[name][self.count] = np.asarray(variable.values)
        marks = {}
        for key in chunk_keys(self.count, self._journal.structure[name]):
            file = self.partial / name / key
            fsync_path(file)
            marks[key] = chunk_mark(file)
        return marks

    def _release(self) -> None:
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
            self._file = None
