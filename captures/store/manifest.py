"""The manifest of a store: sha256 of every metadata file, size and sha256 of every chunk. A second file holds its sha256.

Version 2 of the store (`STORE_VERSION`) has the sha256 of each chunk and a second manifest (`record`). Stores of version 1, whose
chunks have their CRC-32C only and which have no second manifest, are read as they are; whatever is written is of version 2.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError, other_version
from ...scenes.json_keys import read_json
from ..layouts.schema import SCHEMA_VERSION

__all__ = [
    "ASK_FOR_RIGHTS",
    "CHUNK_KEY",
    "FORMAT",
    "MANIFEST",
    "MANIFEST_SUM",
    "RECORD",
    "STORE_VERSION",
    "TAKE_ANEW",
    "UNREADABLE",
    "DamagedManifest",
    "Manifest",
    "check_metadata",
    "check_metadata_files",
    "chunk_mark",
    "in_a_link",
    "load_manifest",
    "mark_of",
    "read_problem",
    "regular_size",
    "refused_metadata",
    "safe_join",
    "sha256_file",
    "sum_text",
]

MANIFEST = "manifest.json"
MANIFEST_SUM = "manifest.sha256"
#: The second manifest, in the form of a journal: all that is needed to write the others again (`record`).
RECORD = "record.jsonl"
ASK_FOR_RIGHTS = "there is no sign of damage: get permission to read it, then try again"
TAKE_ANEW = "copy the store from its source again, or generate it anew"
FORMAT = "beambench-captures"
#: Beginning of the problem of a file that exists but could not be read: its content may be intact.
UNREADABLE = "cannot be read"
#: Errors of a medium that has lost the content; all others (permissions, handles, a missing share) may be temporary.
_LOST = {errno.EIO, errno.EBADMSG, getattr(errno, "EUCLEAN", errno.EIO)}
STORE_VERSION = 2
_READ_VERSIONS = (1, 2)
#: Most captures of a store: the length of its arrays while it is written.
_MOST = 2**31
_KEY = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.\-]*(/[A-Za-z0-9_][A-Za-z0-9_.\-]*)*")
#: Name of a chunk's file in the folder of its array: capture, then block along each dimension.
CHUNK_KEY = re.compile(r"c(\.[0-9]{1,10})+")

Mark = tuple[int, str]
"""Size of a chunk's file in bytes, and its sha256 in hex; in stores of version 1 the CRC-32C that ends it (8 digits)."""


class DamagedManifest(InputError):
    """The manifest is not the one that was written."""


@dataclass(frozen=True)
class Manifest:
    """Required content of a store.

    Main arguments:
        modality, count: modality and number of the captures.
        metadata: sha256 by path inside the store.
        chunks: for each array, the marks of its chunks by chunk key.
    Other arguments:
        record: sha256 of the second manifest; empty in version 1, which has none.
        sha256: of the manifest file in hex, where it was read from one.
    """

    modality: str
    count: int
    metadata: dict[str, str]
    chunks: dict[str, dict[str, Mark]]
    record: str = ""
    sha256: str = ""

    def text(self) -> str:
        """The manifest as JSON."""
        body = {
            "format": FORMAT,
            "store_version": STORE_VERSION,
            "schema_version": SCHEMA_VERSION,
            "modality": self.modality,
            "count": self.count,
            "metadata": self.metadata,
            "chunks": self.chunks,
            "record": self.record,
        }
        return json.dumps(body, indent=0, sort_keys=True) + "\n"


def load_manifest(root: Path) -> Manifest:
    """Read and check the manifest of the store at `root`.

    Raises DamagedManifest where it is not as it was written, InputError where it is absent or unknown.
    """
    try:
        text, expected = (root / MANIFEST).read_bytes(), (root / MANIFEST_SUM).read_bytes()
    except FileNotFoundError as error:
        kind = InputError if regular_size(root / RECORD) is None else DamagedManifest
        raise kind(
            "The folder is not a store of captures, or its manifest is missing.",
            where=str(root), allowed=f"a folder with {MANIFEST} and {MANIFEST_SUM}",
            next_step="`beambench generate SCENE --out PATH` creates a store" if kind is InputError else _advice(root),
        ) from error  # fmt: skip
    except OSError as error:
        raise InputError(f"The manifest cannot be read: {error.strerror}.", where=str(root)) from error
    if expected != sum_text(text):
        raise DamagedManifest(
            "The manifest is damaged: its sha256 does not match.",
            where=str(root / MANIFEST), next_step=_advice(root),
        )  # fmt: skip
    try:
        return _parsed(root, text)
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"The manifest is not that of a store of captures: {error!r}.",
            where=str(root / MANIFEST),
            allowed="written by beambench",
        ) from error


def _parsed(root: Path, text: bytes) -> Manifest:
    body = read_json(text)
    versions = (body["format"], body["store_version"], body["schema_version"])
    if versions not in [(FORMAT, version, SCHEMA_VERSION) for version in _READ_VERSIONS]:
        raise other_version(
            "The store was written in another version of the format.", where=str(root),
            found=max(versions[1:], key=lambda one: one if type(one) is int else -1), known=STORE_VERSION,
            older="read it with the version of Beambench that wrote it, or generate it anew",
        )  # fmt: skip
    count = body["count"]
    if type(count) is not int or not 0 < count <= _MOST:
        raise ValueError(f"count {count!r}")
    chunks = {
        str(array): {_chunk_key(key, count): mark_of(mark) for key, mark in marks.items()}
        for array, marks in body["chunks"].items()
    }
    metadata = {str(name): str(digest) for name, digest in body["metadata"].items()}
    digest = hashlib.sha256(text).hexdigest()
    return Manifest(str(body["modality"]), count, metadata, chunks, str(body.get("record", "")), digest)


def mark_of(mark: Any) -> Mark:
    """A mark read from a file. Raises TypeError, ValueError."""
    size, digest = mark
    if type(size) is not int or not isinstance(digest, str):
        raise ValueError(f"mark {mark!r}")
    return size, digest


def sum_text(manifest: bytes) -> bytes:
    """Content of the file that holds the manifest's sha256."""
    return (hashlib.sha256(manifest).hexdigest() + "\n").encode()


def _advice(root: Path) -> str:
    """What helps where metadata are damaged: a repair only where there is something to repair them from."""
    if regular_size(root / RECORD) is None:
        return TAKE_ANEW
    return f"`beambench data repair {root}` writes them again from the second manifest"


def refused_metadata(root: Path, told: str) -> InputError:
    """The error of damaged metadata."""
    return InputError(f"The store is damaged: {told}.", where=str(root), next_step=_advice(root))


def check_metadata(root: Path, manifest: Manifest) -> list[tuple[str, str]]:
    """(file, problem) of each metadata file that is missing or altered."""
    return check_metadata_files(root, manifest.metadata)


def check_metadata_files(root: Path, sums: Mapping[str, str]) -> list[tuple[str, str]]:
    """(file, problem) of each file that is missing or has another sha256 than `sums` states."""
    problems = []
    for name, expected in sums.items():
        try:
            if regular_size(safe_join(root, name)) is None:
                problems.append((name, "missing"))
            elif sha256_file(root / name) != expected:
                problems.append((name, "sha256 does not match"))
        except OSError as error:
            problems.append((name, read_problem(error)))
    return problems


def read_problem(error: OSError) -> str:
    """The problem of a file that gave `error` when read: its content is lost, or it cannot be read at present."""
    return f"{'lost' if error.errno in _LOST else UNREADABLE}: {error.strerror or error}"


def safe_join(root: Path, key: str) -> Path:
    """`root/key`, refusing keys that leave the store. Raises InputError."""
    if not _KEY.fullmatch(key):
        raise InputError(
            "A path in the manifest leaves the store.", where=str(root), value=key, allowed="relative names"
        )
    return root / key


def _chunk_key(key: str, count: int) -> str:
    if not CHUNK_KEY.fullmatch(key) or int(key.split(".")[1]) >= count:
        raise ValueError(f"chunk {key!r} of {count} captures")
    return key


def regular_size(path: Path) -> int | None:
    """Size of a regular file in bytes, None where there is none. A link counts as none: it may lead out of the store."""
    try:
        status = os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
    return status.st_size if stat.S_ISREG(status.st_mode) else None


def in_a_link(path: Path) -> bool:
    """Whether the folder of a shard's file, GROUP/ARRAY, or that of its group is a link."""
    return path.parent.is_symlink() or path.parent.parent.is_symlink()


def chunk_mark(path: Path) -> Mark:
    """Size and sha256 of a chunk file. Raises OSError."""
    with open(path, "rb") as file:
        content = file.read()
    return len(content), hashlib.sha256(content).hexdigest()


def sha256_file(path: Path) -> str:
    """Hex sha256 of a file. Raises OSError."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
