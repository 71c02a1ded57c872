"""The journal of a store that is being written: one checksummed line per complete capture.

A partial store is valid up to its last intact line, whatever follows: a torn line or a half-written capture.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from ...scenes.errors import InputError
from .arrays import Structure
from .manifest import CHUNK_KEY, FORMAT, Mark, regular_size

__all__ = [
    "JOURNAL", "MARK_LINE", "Journal", "Record", "append_line", "fsync_path", "has_header", "has_mark", "lock_journal",
    "mark_journal", "read_journal", "refuse_busy", "write_file",
]  # fmt: skip

JOURNAL = "journal.jsonl"
#: An array's name becomes a folder in the store, and must not lead out of it.
_ARRAY = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.\-]{0,200}")
#: Longest line that is read: 64 MiB hold the marks of a million chunks.
_LONGEST = 64 * 2**20


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
    file.write(_line(payload))
    file.flush()
    os.fsync(file.fileno())


def _line(payload: dict[str, Any]) -> bytes:
    text = json.dumps(payload).encode()
    return hashlib.sha256(text).hexdigest().encode() + b" " + text + b"\n"


#: The first line of a journal, which says that the folder is a store.
MARK_LINE = _line({"format": FORMAT})


def mark_journal(file: IO[bytes]) -> None:
    """Begin a journal: its first line says that the folder is a store. Raises OSError."""
    append_line(file, {"format": FORMAT})


def read_journal(partial: Path) -> Journal:
    """The journal of `partial` up to its last intact line.

    Raises InputError where not even the header is intact, and where an intact line is not that of a journal: names that lead
    out of the store, folders that are links, wrong types.
    """
    journal: Journal | None = None
    sound = 0
    try:
        with _opened(partial) as file:
            while line := file.readline(_LONGEST):
                payload = _payload(line)
                if payload is None:
                    break
                sound += len(line)
                if _is_mark(payload):
                    continue
                if journal is None:
                    journal = Journal(*_header(partial, payload))
                else:
                    journal.records.append(_record(partial, journal, payload))
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


def has_mark(folder: Path) -> bool:
    """Whether the first line of the journal is intact, so that the folder is a store of this package."""
    try:
        with _opened(folder) as file:
            payload = _payload(file.readline(_LONGEST))
    except OSError:
        return False
    return payload is not None and (_is_mark(payload) or {"modality", "structure"} <= set(payload))


def has_header(partial: Path) -> bool:
    """Whether the journal of `partial` contains an intact header."""
    try:
        with _opened(partial) as file:
            payload = _payload(file.readline(_LONGEST))
            if payload is not None and _is_mark(payload):
                payload = _payload(file.readline(_LONGEST))
            return payload is not None
    except FileNotFoundError:
        return False


def _opened(partial: Path) -> IO[bytes]:
    """The journal, open to read; a link counts as none. Raises OSError."""
    if regular_size(partial / JOURNAL) is None:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(partial / JOURNAL))
    return open(partial / JOURNAL, "rb")


def _is_mark(payload: dict[str, Any]) -> bool:
    return payload.get("format") == FORMAT and "modality" not in payload


def _header(partial: Path, payload: dict[str, Any]) -> tuple[str, Structure]:
    modality, structure = payload.get("modality"), payload.get("structure")
    if not isinstance(modality, str) or not isinstance(structure, dict) or not structure:
        raise _wrong(partial, "its header has no modality or no arrays", type(structure).__name__)
    for name, entry in structure.items():
        if not _ARRAY.fullmatch(name):
            raise _wrong(partial, "the name of an array leads out of the store", name)
        keys = {"dims": list, "shape": list, "dtype": str, "coord": bool, "attrs": dict}
        if not isinstance(entry, dict) or any(type(entry.get(key)) is not kind for key, kind in keys.items()):
            raise _wrong(partial, "an array is not described", name)
        if not all(type(n) is int and 0 <= n < 2**40 for n in entry["shape"]) or len(entry["dims"]) != len(
            entry["shape"]
        ):
            raise _wrong(partial, "an array has no possible shape", f"{name}: {entry['shape']}")
        if os.path.islink(partial / name):
            raise _wrong(partial, "the folder of an array is a link", name)
    return modality, structure


def _record(partial: Path, journal: Journal, payload: dict[str, Any]) -> Record:
    attrs, texts, marks = payload.get("attrs"), payload.get("texts"), payload.get("chunks")
    if not all(isinstance(part, dict) for part in (attrs, texts, marks)) or set(marks) != set(journal.structure):  # type: ignore[arg-type]
        raise _wrong(partial, "a capture has no attributes, or chunks of other arrays", len(journal.records))
    chunks: dict[str, dict[str, Mark]] = {}
    for array, files in marks.items():  # type: ignore[union-attr]
        try:
            chunks[array] = {key: (int(size), str(crc)) for key, (size, crc) in files.items()}
        except (AttributeError, TypeError, ValueError) as error:
            raise _wrong(partial, "a capture has no list of its chunks", array) from error
        for key in chunks[array]:
            if not CHUNK_KEY.fullmatch(key):
                raise _wrong(partial, "the name of a chunk leads out of the store", key)
    return Record(attrs, texts, chunks)  # type: ignore[arg-type]


def _wrong(partial: Path, what: str, value: object) -> InputError:
    return InputError(
        f"The journal is not that of a store of captures: {what}.", where=str(partial / JOURNAL), value=value,
        allowed="written by beambench", next_step="do not use this folder",
    )  # fmt: skip


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
    with suppress(FileNotFoundError), _opened(partial) as file:
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
    # A new file, never one that stands there: that may be a link to another place.
    temporary.unlink(missing_ok=True)
    with open(temporary, "xb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())
    os.replace(temporary, file)


def _payload(line: bytes) -> dict[str, Any] | None:
    digest, _, text = line.removesuffix(b"\n").partition(b" ")
    if not line.endswith(b"\n") or hashlib.sha256(text).hexdigest().encode() != digest:
        return None
    try:
        payload = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return payload if isinstance(payload, dict) else None
