"""The slots of a recording on disk: preallocated, and each counts only when its line is in the journal.

A shot's data are written and forced to disk first, its line (sha256, settings read back, identifiers, both clocks) after them:
whatever dies in between, the slot is empty or whole. The folder is `OUT.recording` until the capture has its name.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ...scenes.errors import InputError
from ...scenes.json_keys import read_json
from ..store.journal import append_line, fsync_path, lock_journal
from ..store.publish import disk_error

__all__ = ["JOURNAL", "SlotStore", "folder_of", "remove_recording"]

JOURNAL = "journal.jsonl"
_FRAMES = "frames.bin"
_FORMAT = "beambench recording 1"


def folder_of(out: Path) -> Path:
    """The folder of a recording whose capture will be `out`."""
    return out.parent / f"{out.name}.recording"


class SlotStore:
    """`count` slots of `shape` and `dtype` in `folder`.

    Main arguments:
        plan: plain data of plan and instrument; a recording is continued with the same only.
    Other arguments:
        resume: continue what is there; without it, an existing recording is refused.

    Raises InputError: another recording, or one that another process writes; a full disk, before anything is recorded.
    """

    def __init__(
        self, folder: Path, count: int, shape: tuple[int, ...], dtype: str, plan: Mapping[str, Any], *, resume: bool
    ) -> None:
        self.folder, self.shape, self.dtype = folder, shape, np.dtype(dtype)
        self.lines: list[dict[str, Any] | None] = [None] * count
        self.events: list[dict[str, Any]] = []
        self._size = math.prod(shape) * self.dtype.itemsize
        self._journal: IO[bytes] | None = None
        self._frames: int | None = None
        self._plan = json.loads(json.dumps(plan))
        try:
            if resume and (folder / JOURNAL).is_file():
                self._reopen()
            else:
                self._begin()
        except OSError as error:
            self.close()
            raise disk_error(error, "Preparing the recording", folder) from error
        except BaseException:
            self.close()
            raise

    @property
    def count(self) -> int:
        """Number of slots that are recorded."""
        return sum(line is not None for line in self.lines)

    def commit(self, slot: int, data: NDArray[Any], line: Mapping[str, Any]) -> None:
        """Put a reading into its slot; it is on disk when this returns.

        Numbers of a smaller type are widened. Raises InputError for data of another shape or type, and where the disk is full.
        """
        if data.shape != self.shape or not np.can_cast(data.dtype, self.dtype, "safe"):
            raise InputError(
                "The device gives other data than the plan's instrument.", where=str(self.folder),
                value=f"{data.shape} {data.dtype}", allowed=f"{self.shape} {self.dtype}",
                next_step="correct the size in the plan (changes) or the settings in the rig file",
            )  # fmt: skip
        assert self._journal is not None and self._frames is not None
        content = np.ascontiguousarray(data, self.dtype).tobytes()
        whole = {"event": "slot", "slot": slot, "sha256": hashlib.sha256(content).hexdigest(), **line}
        try:
            _write_all(self._frames, content, slot * self._size)
            os.fdatasync(self._frames)
            append_line(self._journal, whole)
        except OSError as error:
            raise disk_error(error, f"Recording slot {slot}", self.folder, self.advice()) from error
        self.lines[slot] = whole

    def note(self, event: str, **what: Any) -> None:
        """A line of the journal about something else: a retake, a loss, a device that was opened. Raises InputError."""
        assert self._journal is not None
        line = json.loads(json.dumps({"event": event, **what}, default=str))
        try:
            append_line(self._journal, line)
        except OSError as error:
            raise disk_error(error, "Writing the journal", self.folder, self.advice()) from error
        self.events.append(line)

    def read(self) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Data (slot, …) and which slots hold some: those whose bytes have the sha256 of their line."""
        data = np.zeros((len(self.lines), *self.shape), self.dtype)
        valid = np.zeros(len(self.lines), dtype=bool)
        for slot, line in enumerate(self.lines):
            if line is not None and (content := self._content(slot, line)) is not None:
                data[slot] = np.frombuffer(content, self.dtype).reshape(self.shape)
                valid[slot] = True
        return data, valid

    def close(self) -> None:
        """Close the files; another process may then continue."""
        if self._journal is not None:
            with suppress(OSError):
                self._journal.close()
        if self._frames is not None:
            with suppress(OSError):
                os.close(self._frames)
        self._journal = self._frames = None

    def advice(self) -> str:
        """How to go on with what is there."""
        there = f"{self.count} of {len(self.lines)} shots are in {self.folder}"
        if self.count == len(self.lines):
            return f"{there}: --resume makes the capture of them, and records nothing again"
        return f"{there}: --resume records the rest, --finish keeps them as they are"

    def _header(self) -> dict[str, Any]:
        return {
            "format": _FORMAT, "slots": len(self.lines), "shape": list(self.shape), "dtype": self.dtype.name, "plan": self._plan,
        }  # fmt: skip

    def _begin(self) -> None:
        if os.path.lexists(self.folder):
            raise InputError(
                "A recording with this name was begun.", where=str(self.folder),
                next_step="--resume goes on with it, --finish keeps what it has; or remove the folder, or choose another --out",
            )  # fmt: skip
        self.folder.parent.mkdir(parents=True, exist_ok=True)
        self.folder.mkdir()
        try:
            self._frames = os.open(self.folder / _FRAMES, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)
            # All the room that is needed now, and not at midnight.
            os.posix_fallocate(self._frames, 0, len(self.lines) * self._size)
            os.fsync(self._frames)
            self._journal = open(self.folder / JOURNAL, "xb")  # noqa: SIM115 (closed by close)
            lock_journal(self._journal, self.folder)
            append_line(self._journal, self._header())
            fsync_path(self.folder)
            fsync_path(self.folder.parent)
        except OSError:
            self.close()
            remove_recording(self.folder)
            raise

    def _reopen(self) -> None:
        self._journal = open(self.folder / JOURNAL, "r+b")  # noqa: SIM115 (closed by close)
        lock_journal(self._journal, self.folder)
        lines, sound = _intact(self._journal)
        header = self._header()
        if not lines or lines[0] != header:
            what = next((key for key in header if not lines or lines[0].get(key) != header[key]), "format")
            raise InputError(
                "The recording that was begun is another one.", where=str(self.folder / JOURNAL), value=what,
                allowed="the same plan and instrument",
                next_step="continue with the plan it was begun with, or choose another --out",
            )  # fmt: skip
        self._frames = os.open(self.folder / _FRAMES, os.O_RDWR)
        if os.fstat(self._frames).st_size < len(self.lines) * self._size:
            os.posix_fallocate(self._frames, 0, len(self.lines) * self._size)
        for line in lines[1:]:
            slot = line.get("slot")
            if line.get("event") != "slot":
                self.events.append(line)
            elif isinstance(slot, int) and 0 <= slot < len(self.lines) and self._content(slot, line) is not None:
                self.lines[slot] = line
        self._journal.truncate(sound)
        self._journal.seek(sound)

    def _content(self, slot: int, line: Mapping[str, Any]) -> bytes | None:
        """The bytes of a slot; None where they are not those of its line."""
        assert self._frames is not None
        content = os.pread(self._frames, self._size, slot * self._size)
        good = len(content) == self._size and hashlib.sha256(content).hexdigest() == line.get("sha256")
        good = good and {"told", "index", "device_ns", "host_ns"} <= set(line)
        return content if good else None


def remove_recording(folder: Path) -> None:
    """Remove a recording's own files, and its folder if nothing else is in it. Raises OSError."""
    for name in (_FRAMES, JOURNAL):
        (folder / name).unlink(missing_ok=True)
    folder.rmdir()


def _write_all(descriptor: int, content: bytes, offset: int) -> None:
    done = 0
    while done < len(content):
        done += os.pwrite(descriptor, content[done:], offset + done)


def _intact(file: IO[bytes]) -> tuple[list[dict[str, Any]], int]:
    """The lines up to the last intact one, and their length in bytes."""
    lines: list[dict[str, Any]] = []
    sound = 0
    for raw in file:
        digest, _, text = raw.removesuffix(b"\n").partition(b" ")
        if not raw.endswith(b"\n") or hashlib.sha256(text).hexdigest().encode() != digest:
            break
        try:
            line = read_json(text)
        except ValueError:
            break
        if not isinstance(line, dict):
            break
        lines.append(line)
        sound += len(raw)
    return lines, sound
