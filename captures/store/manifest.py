"""The manifest of a store: sha256 of every metadata file, size and checksum of every chunk. A second file holds its sha256."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import stat
from dataclasses import dataclass
from pathlib import Path

from ...scenes.errors import InputError
from ..layouts.schema import SCHEMA_VERSION

__all__ = [
    "ASK_FOR_RIGHTS",
    "CHUNK_KEY",
    "FORMAT",
    "MANIFEST",
    "MANIFEST_SUM",
    "TAKE_ANEW",
    "UNREADABLE",
    "Manifest",
    "check_metadata",
    "chunk_mark",
    "load_manifest",
    "read_problem",
    "regular_size",
    "safe_join",
    "sha256_file",
]

MANIFEST = "manifest.json"
MANIFEST_SUM = "manifest.sha256"
ASK_FOR_RIGHTS = "there is no sign of damage: get permission to read it, then try again"
TAKE_ANEW = "copy the store from its source again, or generate it anew"
FORMAT = "beambench-captures"
#: Beginning of the problem of a file that exists but could not be read: its content may be intact.
UNREADABLE = "cannot be read"
#: Errors of a medium that has lost the content; all others (permissions, handles, a missing share) may be temporary.
_LOST = {errno.EIO, errno.EBADMSG, getattr(errno, "EUCLEAN", errno.EIO)}
STORE_VERSION = 1
_KEY = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.\-]*(/[A-Za-z0-9_][A-Za-z0-9_.\-]*)*")
#: Name of a chunk's file in the folder of its array: capture, then block along each dimension.
CHUNK_KEY = re.compile(r"c(\.[0-9]{1,10})+")

Mark = tuple[int, str]
"""Size of a chunk's file in bytes, and the CRC-32C that ends it, in hex."""


@dataclass(frozen=True)
class Manifest:
    """Required content of a store.

    Main arguments:
        modality, count: modality and number of the captures.
        metadata: sha256 by path inside the store.
        chunks: for each array, the marks of its chunks by chunk key.
    Other arguments:
        sha256: of the manifest file in hex, where it was read from one.
    """

    modality: str
    count: int
    metadata: dict[str, str]
    chunks: dict[str, dict[str, Mark]]
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
        }
        return json.dumps(body, indent=0, sort_keys=True) + "\n"


def load_manifest(root: Path) -> Manifest:
    """Read and check the manifest of the store at `root`. Raises InputError if it is absent, damaged or unknown."""
    try:
        text, expected = (root / MANIFEST).read_bytes(), (root / MANIFEST_SUM).read_bytes()
    except FileNotFoundError as error:
        raise InputError(
            "The folder is not a store of captures, or its manifest is missing.",
            where=str(root), allowed=f"a folder with {MANIFEST} and {MANIFEST_SUM}",
            next_step="`beambench generate SCENE --out PATH` creates a store",
        ) from error  # fmt: skip
    except OSError as error:
        raise InputError(f"The manifest cannot be read: {error.strerror}.", where=str(root)) from error
    if expected != (hashlib.sha256(text).hexdigest() + "\n").encode():
        raise InputError(
            "The manifest is damaged: its sha256 does not match.",
            where=str(root / MANIFEST), next_step=TAKE_ANEW,
        )  # fmt: skip
    try:
        body = json.loads(text)
        versions = (body["format"], body["store_version"], body["schema_version"])
        if versions != (FORMAT, STORE_VERSION, SCHEMA_VERSION):
            raise InputError(
                "The store was written in another version of the format.",
                where=str(root), value=versions, allowed=f"{(FORMAT, STORE_VERSION, SCHEMA_VERSION)}",
                next_step="read it with the version of Beambench that wrote it, or generate it anew",
            )  # fmt: skip
        count = int(body["count"])
        chunks = {
            str(array): {_chunk_key(key, count): (int(size), str(crc)) for key, (size, crc) in marks.items()}
            for array, marks in body["chunks"].items()
        }
        metadata = {str(name): str(digest) for name, digest in body["metadata"].items()}
        return Manifest(str(body["modality"]), count, metadata, chunks, hashlib.sha256(text).hexdigest())
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"The manifest is not that of a store of captures: {error!r}.",
            where=str(root / MANIFEST),
            allowed="written by beambench",
        ) from error


def check_metadata(root: Path, manifest: Manifest) -> list[tuple[str, str]]:
    """(file, problem) of each metadata file that is missing or altered."""
    problems = []
    for name, expected in manifest.metadata.items():
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


def chunk_mark(path: Path) -> Mark:
    """Size and stored CRC-32C (the last four bytes) of a chunk file. Raises OSError."""
    with open(path, "rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - 4))
        return size, file.read(4).hex()


def sha256_file(path: Path) -> str:
    """Hex sha256 of a file. Raises OSError."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
