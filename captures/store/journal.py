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
from ...scenes.json_keys import read_json
from .arrays import Structure, chunk_keys
from .layout import attributes_problem, structure_problem
from .manifest import CHUNK_KEY, FORMAT, Mark, mark_of, regular_size

__all__ = [
    "JOURNAL", "MARK_LINE", "Journal", "Record", "append_line", "fsync_path", "has_header", "has_mark", "header_of", "line_of",
    "lock_journal", "mark_journal", "read_journal", "refuse_busy", "write_file",
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
    """A partial store: the properties that all captures share, and one record for each capture.

    `sound_bytes`: length up to the last intact line. `stated`: the number of captures by the first line of a second manifest.
    """

    modality: str
    structure: Structure
    records: list[Record] = field(default_factory=list)
    sound_bytes: int = 0
    stated: int | None = None

    @property
    def chunks(self) -> dict[str, dict[str, Mark]]:
        """The marks of all chunks by array."""
        return {
            name: {k: m for record in self.records for k, m in record.chunks[name].items()} for name in self.structure
        }

    @property
    def texts(self) -> dict[str, str]:
        """Every long text by its sha256."""
        return {key: text for record in self.records for key, text in record.texts.items()}


def append_line(file: IO[bytes], payload: dict[str, Any]) -> None:
    """Append one line and force it to disk. Raises OSError."""
    file.write(line_of(payload))
    file.flush()
    os.fsync(file.fileno())


def line_of(payload: dict[str, Any]) -> bytes:
    """A line: the sha256 of its text, then the text."""
    text = json.dumps(payload).encode()
    return hashlib.sha256(text).hexdigest().encode() + b" " + text + b"\n"


#: The first line of a journal, which says that the folder is a store.
MARK_LINE = line_of({"format": FORMAT})


def mark_journal(file: IO[bytes]) -> None:
    """Begin a journal: its first line says that the folder is a store. Raises OSError."""
    append_line(file, {"format": FORMAT})


def read_journal(partial: Path, name: str = JOURNAL) -> Journal:
    """The journal of `partial` up to its last intact line; `name` is the file's.

    Raises InputError where not even the header is intact, and where an intact line is not that of a journal: names that lead
    out of the store, folders that are links, wrong types.
    """
    journal: Journal | None = None
    sound, stated = 0, None
    texts: dict[str, str] = {}
    try:
        with _opened(partial, name) as file:
            while line := file.readline(_LONGEST):
                payload = _payload(line)
                if payload is None:
                    break
                sound += len(line)
                if _is_mark(payload):
                    stated = payload.get("count")
                    continue
                if journal is None:
                    journal = Journal(*header_of(partial, payload))
                else:
                    journal.records.append(_record(partial, journal, payload, texts))
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
    journal.sound_bytes, journal.stated = sound, stated
    return journal


def has_mark(folder: Path, name: str = JOURNAL) -> bool:
    """Whether the first line of the journal is intact, so that the folder is a store of this package; `name` is the file's."""
    try:
        with _opened(folder, name) as file:
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


def _opened(partial: Path, name: str = JOURNAL) -> IO[bytes]:
    """The journal, open to read; a link counts as none. Raises OSError."""
    if regular_size(partial / name) is None:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(partial / name))
    return open(partial / name, "rb")


def _is_mark(payload: dict[str, Any]) -> bool:
    return payload.get("format") == FORMAT and "modality" not in payload


def header_of(partial: Path, payload: dict[str, Any]) -> tuple[str, Structure]:
    """Modality and structure, checked. Raises InputError."""
    modality, structure = payload.get("modality"), payload.get("structure")
    if not isinstance(modality, str) or not isinstance(structure, dict) or not structure:
        raise _wrong(partial, "its header has no modality or no arrays", type(structure).__name__)
    for name in structure:
        if not _ARRAY.fullmatch(name):
            raise _wrong(partial, "the name of an array leads out of the store", name)
        if os.path.islink(partial / name):
            raise _wrong(partial, "the folder of an array is a link", name)
    if (problem := structure_problem(structure)) is not None:
        raise _wrong(partial, *problem)
    return modality, structure


def _record(partial: Path, journal: Journal, payload: dict[str, Any], known: dict[str, str]) -> Record:
    """One capture, checked; its texts are added to those that are `known`."""
    attrs, texts, marks = payload.get("attrs"), payload.get("texts"), payload.get("chunks")
    number = len(journal.records)
    if not isinstance(texts, dict) or not isinstance(marks, dict) or set(marks) != set(journal.structure):
        raise _wrong(partial, "a capture has no attributes, or chunks of other arrays", number)
    known |= texts
    if problem := attributes_problem(attrs, known):
        raise _wrong(partial, problem, number)
    chunks: dict[str, dict[str, Mark]] = {}
    for array, files in marks.items():
        if not isinstance(files, dict) or not all(CHUNK_KEY.fullmatch(key) for key in files):
            raise _wrong(partial, "the name of a chunk leads out of the store", array)
        keys = chunk_keys(number, journal.structure[array])
        if set(files) != set(keys):
            raise _wrong(partial, "a capture has other chunks than its shape needs", array)
        try:
            chunks[array] = {key: mark_of(files[key]) for key in keys}
        except (TypeError, ValueError) as error:
            raise _wrong(partial, "a capture has no list of its chunks", array) from error
    return Record(attrs, texts, chunks)  # type: ignore[arg-type]


def _wrong(partial: Path, what: str, value: object) -> InputError:
    return InputError(
        f"The journal is not that of a store of captures: {what}.", where=str(partial / JOURNAL), value=value,
        allowed="written by beambench", next_step="do not use this folder",
    )  # fmt: skip


def lock_journal(file: IO[bytes], partial: Path, *, shared: bool = False) -> None:
    """Hold the journal for this process until it is closed; `shared`: beside others that do. Raises InputError where another
    process writes the store."""
    import fcntl

    try:
        fcntl.flock(file.fileno(), (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
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


def write_file(file: Path, content: bytes, mark: str = "") -> None:
    """Write or replace a file atomically, forced to disk. Where two may write one file at once, each has a `mark` of its own, which
    the name of its temporary file holds. Raises OSError."""
    temporary = file.with_name(f"{file.name}.{mark}.new" if mark else f"{file.name}.new")
    # A new file, never one that stands there: that may be a link to another place.
    temporary.unlink(missing_ok=True)
    try:
        with open(temporary, "xb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, file)
    except BaseException:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise


def _payload(line: bytes) -> dict[str, Any] | None:
    digest, _, text = line.removesuffix(b"\n").partition(b" ")
    if not line.endswith(b"\n") or hashlib.sha256(text).hexdigest().encode() != digest:
        return None
    try:
        payload = read_json(text)
    except (ValueError, RecursionError):
        return None
    return payload if isinstance(payload, dict) else None
