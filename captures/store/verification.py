"""Read every byte of a store and list what is damaged."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from ...scenes.errors import InputError
from .manifest import UNREADABLE, Mark, check_metadata, load_manifest, read_problem, regular_size, safe_join

__all__ = ["Damage", "chunk_problem", "verify"]


@dataclass(frozen=True)
class Damage:
    """One damaged or unreadable file of a store; `capture` is the index of the capture affected, None for all."""

    file: str
    problem: str
    capture: int | None

    @property
    def unreadable(self) -> bool:
        """The file could not be read, e.g. for lack of permission: its content may be intact."""
        return self.problem.startswith(UNREADABLE)

    def __str__(self) -> str:
        return f"{self.file}: {self.problem}"


def verify(path: str | os.PathLike[str]) -> list[Damage]:
    """Every damaged file of the store at `path`; an empty list if the store is intact.

    Metadata are compared with their sha256, chunks with their size and CRC-32C, both with the manifest; chunks that
    the manifest does not know are listed too. Raises InputError where there is no store with an intact manifest.
    """
    root = Path(path).expanduser()
    if not root.is_dir():
        raise InputError("There is no such store.", where=str(root), allowed="a folder written by beambench")
    manifest = load_manifest(root)
    damage = [Damage(name, problem, None) for name, problem in check_metadata(root, manifest)]
    for array, marks in manifest.chunks.items():
        folder = safe_join(root, array)
        damage += chunks_damage(folder, array, marks)
        damage += _unknown_files(folder, array, {"zarr.json", *marks})
    return damage


def _unknown_files(folder: Path, array: str, known: set[str]) -> list[Damage]:
    try:
        names = sorted(os.listdir(folder))
    except (FileNotFoundError, NotADirectoryError):
        return []  # its files are reported as missing
    except OSError as error:
        return [Damage(array, read_problem(error), None)]
    return [Damage(f"{array}/{name}", "not in the manifest", None) for name in names if name not in known]


def chunks_damage(folder: Path, array: str, marks: dict[str, Mark]) -> list[Damage]:
    """The damaged chunks of one array."""
    damage = []
    for key, mark in marks.items():
        problem = chunk_problem(safe_join(folder, key), mark)
        if problem:
            damage.append(Damage(f"{array}/{key}", problem, int(key.split(".")[1])))
    return damage


def chunk_problem(file: Path, mark: Mark) -> str:
    """The problem of a chunk file, or an empty text."""
    size, stored = mark
    try:
        found = regular_size(file)
        if found is None:
            return "missing"
        if found != size:
            return f"{found} bytes, not {size}"
        content = file.read_bytes()
    except OSError as error:
        return read_problem(error)
    if content[-4:].hex() != stored:
        return "not the chunk that was written"
    if _crc32c(content[:-4]).to_bytes(4, "little") != content[-4:]:
        return "checksum does not match"
    return ""


def _crc32c(content: bytes) -> int:
    # The implementation that zarr's codec uses; zarr depends on it.
    import google_crc32c

    return int(google_crc32c.value(content))
