"""The journal of a store that is being written: one checksummed line per complete capture.

A partial store is valid up to its last intact line, whatever follows: a torn line or a half-written capture.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from ...scenes.errors import InputError
from .arrays import Structure
from .manifest import Mark

__all__ = [
    "JOURNAL", "Journal", "Record", "append_line", "fsync_path", "has_header", "lock_journal", "read_journal",
    "refuse_busy", "write_file",
]  # fmt: skip

JOURNAL = "journal.jsonl"


@dataclass(frozen=True)
class Record:
    """One complete capture: its encoded attributes, the long texts that it added, the marks of its chunks by array."""

    attrs: dict[str, list[Any]]
    texts: dict[str, str]
    chunks: dict[str, dict[str, Mark]]


@dataclass
class Journal:
    """A partial store: the properties that all captures share, and one record for each capture."""

    modality: str
    structure: Structure
    records: list[Record] = field(default_factory=list)
    sound_bytes: int = 0

    @property
    def texts(self) -> dict[str, str]:
        """Every long text by its sha256."""
        return {key: text for record in self.records for key, text in record.texts.items()}


def append_line(file: IO[bytes], payload: dict[str, Any]) -> None:
    """Append one line and force it to disk. Raises OSError."""
    text = json.dumps(payload).encode()
    file.write(hashlib.sha256(text).hexdigest().encode() + b" " + text + b"\n")
    file.flush()
    os.fsync(file.fileno())


def read_journal(partial: Path) -> Journal:
    """The journal of `partial` up to its last intact line. Raises InputError where not even the header is intact."""
    journal: Journal | None = None
    sound = 0
    try:
        with open(partial / JOURNAL, "rb") as file:
            for line in file:
                payload = _payload(line)
                if payload is None:
                    break
                sound += len(line)
                if journal is None:
                    journal = Journal(payload["modality"], payload["structure"])
                else:
                    chunks = {
                        array: {key: (int(size), str(crc)) for key, (size, crc) in marks.items()}
                        for array, marks in payload["chunks"].items()
                    }
                    journal.records.append(Record(payload["attrs"], payload["texts"], chunks))
    except OSError as error:
        raise InputError(
            f"There is no journal of an unfinished store: {error.strerror}.",
            where=str(partial),
            allowed="a .partial folder",
        ) from error
    if journal is None:
        raise InputError(
            "The unfinished store contains no complete capture.",
            where=str(partial), next_step="remove the folder and generate the captures again",
        )  # fmt: skip
    journal.sound_bytes = sound
    return journal


def has_header(partial: Path) -> bool:
    """Whether the journal of `partial` contains an intact first line."""
    try:
        with open(partial / JOURNAL, "rb") as file:
            return _payload(file.readline()) is not None
    except FileNotFoundError:
        return False


def lock_journal(file: IO[bytes], partial: Path) -> None:
    """Hold the journal for this process until it is closed. Raises InputError where another process writes the store."""
    import fcntl

    try:
        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise InputError(
            "Another process is writing this store.",
            where=str(partial),
            next_step="wait until it ends, or choose another --out",
        ) from error
    except OSError as error:
        # Some shared file systems have no locks; there too the journal's checksums detect mixed writes.
        if error.errno not in (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS):
            raise


def refuse_busy(partial: Path) -> None:
    """Raise InputError if another process is writing the store, before anything in it is moved or removed."""
    with suppress(FileNotFoundError), open(partial / JOURNAL, "rb") as file:
        lock_journal(file, partial)


def fsync_path(path: Path) -> None:
    """Force a file or folder to disk. Raises OSError."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_file(file: Path, content: bytes) -> None:
    """Write or replace a file atomically, forced to disk. Raises OSError."""
    temporary = file.with_name(file.name + ".new")
    with open(temporary, "wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())
    os.replace(temporary, file)


def _payload(line: bytes) -> dict[str, Any] | None:
    digest, _, text = line.removesuffix(b"\n").partition(b" ")
    if not line.endswith(b"\n") or hashlib.sha256(text).hexdigest().encode() != digest:
        return None
    payload: dict[str, Any] = json.loads(text)
    return payload
