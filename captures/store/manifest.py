"""The manifest of a store: sha256 of every metadata file, size and checksum of every chunk; its own sha256 beside."""

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
ASK_FOR_RIGHTS = "nothing shows that it is damaged: take the right to read it, then try again"
TAKE_ANEW = "take the store from its source again, or generate it anew"
FORMAT = "beambench-captures"
#: How the problem of a file begins that is there but could not be read: that tells nothing of its content.
UNREADABLE = "cannot be read"
#: What a medium answers that has lost the content; all else (rights, handles, a share that is away) may pass.
_LOST = {errno.EIO, errno.EBADMSG, getattr(errno, "EUCLEAN", errno.EIO)}
STORE_VERSION = 1
_KEY = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.\-]*(/[A-Za-z0-9_][A-Za-z0-9_.\-]*)*")
_CHUNK = re.compile(r"c(\.[0-9]{1,10})+")

Mark = tuple[int, str]
"""Size of a chunk's file in bytes, and the CRC-32C that ends it, in hex."""


@dataclass(frozen=True)
class Manifest:
    """What a store must consist of.

    Main arguments:
        modality, count: what the captures are, and how many.
        metadata: sha256 by path inside the store.
        chunks: for each array, its chunks' marks by chunk key.
    Other arguments:
        sha256: of the manifest's file in hex, where it was read from one.
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
            "not a store of captures, or one that lost its manifest",
            where=str(root), allowed=f"a folder with {MANIFEST} and {MANIFEST_SUM}",
            next_step="`beambench generate SCENE --out PATH` makes one",
        ) from error  # fmt: skip
    except OSError as error:
        raise InputError(f"the manifest cannot be read: {error.strerror}", where=str(root)) from error
    if expected != (hashlib.sha256(text).hexdigest() + "\n").encode():
        raise InputError(
            "the manifest is damaged: its sha256 does not match",
            where=str(root / MANIFEST), next_step=TAKE_ANEW,
        )  # fmt: skip
    try:
        body = json.loads(text)
        versions = (body["format"], body["store_version"], body["schema_version"])
        if versions != (FORMAT, STORE_VERSION, SCHEMA_VERSION):
            raise InputError(
                "the store was written under another version of the format",
                where=str(root), value=versions, allowed=f"{(FORMAT, STORE_VERSION, SCHEMA_VERSION)}",
                next_step="read it with the beambench that wrote it, or generate it anew",
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
            f"the manifest is not one of captures: {error!r}",
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
    """What is wrong with a file that gave `error` when read: lost content, or one that cannot be read now."""
    return f"{'lost' if error.errno in _LOST else UNREADABLE}: {error.strerror or error}"


def safe_join(root: Path, key: str) -> Path:
    """`root/key`, refusing keys that leave the store. Raises InputError."""
    if not _KEY.fullmatch(key):
        raise InputError(
            "a path in the manifest leaves the store", where=str(root), value=key, allowed="relative names"
        )
    return root / key


def _chunk_key(key: str, count: int) -> str:
    if not _CHUNK.fullmatch(key) or int(key.split(".")[1]) >= count:
        raise ValueError(f"chunk {key!r} of {count} captures")
    return key


def regular_size(path: Path) -> int | None:
    """Size of a regular file in bytes, None where there is none. A link counts as none: it may lead out of here."""
    try:
        status = os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
    return status.st_size if stat.S_ISREG(status.st_mode) else None


def chunk_mark(path: Path) -> Mark:
    """Size and stored CRC-32C (the last four bytes) of a chunk's file. Raises OSError."""
    with open(path, "rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - 4))
        return size, file.read(4).hex()


def sha256_file(path: Path) -> str:
    """Hex sha256 of a file. Raises OSError."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
