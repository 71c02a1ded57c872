"""Read every byte of a store and list what is damaged."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

from ...scenes.errors import InputError
from .journal import JOURNAL, Journal
from .manifest import (
    ASK_FOR_RIGHTS,
    MANIFEST,
    MANIFEST_SUM,
    RECORD,
    UNREADABLE,
    DamagedManifest,
    Manifest,
    Mark,
    check_metadata,
    load_manifest,
    read_problem,
    regular_size,
    safe_join,
    sha256_file,
)
from .record import manifest_of, read_record

__all__ = [
    "FOREIGN", "LINK", "Damage", "chunk_problem", "chunks_damage", "partial_damage", "refused_partial", "unreadable_store",
    "verify",
]  # fmt: skip

#: Problem of what lies in a store and is not of its format.
FOREIGN = "not a file of the store"
#: Problem of an array whose folder is somewhere else.
LINK = "a link, not a folder of the store"
#: Files that a stop may leave, or that say what becomes of the store; they hold no data.
_LEFT = {JOURNAL, "replaced.mark", "repair.mark"}


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

    Metadata are compared with their sha256, chunks with their size and sha256, both with the manifest; what the manifest does not
    know is listed too: files, folders, links. Raises InputError where there is no store with an intact manifest or second manifest.
    """
    root = Path(path).expanduser()
    if not root.is_dir():
        raise InputError("There is no such store.", where=str(root), allowed="a folder written by beambench")
    manifest, damage = _manifest(root)
    damage += [Damage(name, problem, None) for name, problem in check_metadata(root, manifest)]
    damage += _foreign(root, {name.partition("/")[0] for name in manifest.metadata})
    for array, marks in manifest.chunks.items():
        folder = safe_join(root, array)
        if folder.is_symlink():
            damage.append(Damage(array, LINK, None))
            continue
        damage += chunks_damage(folder, array, marks)
        damage += _unknown_files(folder, array, {"zarr.json", *marks})
    return damage


def _manifest(root: Path) -> tuple[Manifest, list[Damage]]:
    """The manifest, or that of the second one where the first is damaged; and what is wrong with either."""
    try:
        manifest = load_manifest(root)
    except DamagedManifest as error:
        second = manifest_of(read_record(root))
        name = MANIFEST_SUM if _is(root / MANIFEST, second.text().encode()) else MANIFEST
        return second, [Damage(name, error.what.partition(": ")[2] or "missing", None)]
    if not manifest.record:
        return manifest, []
    try:
        found = sha256_file(root / RECORD) if regular_size(root / RECORD) is not None else ""
    except OSError as error:
        return manifest, [Damage(RECORD, read_problem(error), None)]
    if found == manifest.record:
        return manifest, []
    return manifest, [Damage(RECORD, "sha256 does not match" if found else "missing", None)]


def _is(file: Path, content: bytes) -> bool:
    try:
        return file.read_bytes() == content
    except OSError:
        return False


def _foreign(root: Path, arrays: set[str]) -> list[Damage]:
    """Files, folders and links beside those of the store."""
    known = {MANIFEST, MANIFEST_SUM, RECORD, *arrays, *_LEFT}
    return [Damage(name, FOREIGN, None) for name in sorted(os.listdir(root)) if name not in known]


def _unknown_files(folder: Path, array: str, known: set[str]) -> list[Damage]:
    try:
        names = sorted(os.listdir(folder))
    except (FileNotFoundError, NotADirectoryError):
        return []  # its files are reported as missing
    except OSError as error:
        return [Damage(array, read_problem(error), None)]
    return [Damage(f"{array}/{name}", "not in the manifest", None) for name in names if name not in known]


def partial_damage(partial: Path, journal: Journal) -> list[Damage]:
    """The damaged chunks of an unfinished store."""
    damage: list[Damage] = []
    for name in journal.structure:
        marks = {key: mark for record in journal.records for key, mark in record.chunks[name].items()}
        damage += chunks_damage(partial / name, name, marks)
    return damage


def refused_partial(partial: Path, damage: list[Damage]) -> InputError:
    """The error of an unfinished store with damaged captures: they are neither published nor continued."""
    refused = [entry for entry in damage if entry.unreadable]
    if refused:
        return unreadable_store(partial, refused)
    return InputError(
        f"The unfinished store is damaged: {damage[0]}.",
        where=str(partial), next_step=f"`beambench data repair {partial}` keeps the intact captures; with --regenerate it makes "
        "the damaged ones again",
    )  # fmt: skip


def unreadable_store(root: Path, refused: list[Damage]) -> InputError:
    """The error of a store with files that cannot be read, `refused`."""
    more = f" and {len(refused) - 1} more" if len(refused) > 1 else ""
    return InputError(
        f"A file of the store cannot be read: {refused[0]}{more}.", where=str(root), next_step=ASK_FOR_RIGHTS
    )


def chunks_damage(folder: Path, array: str, marks: dict[str, Mark]) -> list[Damage]:
    """The damaged chunks of one array."""
    damage = []
    for key, mark in marks.items():
        problem = chunk_problem(safe_join(folder, key), mark)
        if problem:
            damage.append(Damage(f"{array}/{key}", problem, int(key.split(".")[1])))
    return damage


def chunk_problem(file: Path, mark: Mark, decoded: int | None = None) -> str:
    """The problem of a chunk file, or an empty text.

    Main arguments:
        file, mark: the file, and what the manifest says of it.
    Other arguments:
        decoded: bytes that it must unpack to, as its own header states before anything is unpacked.
    """
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
    if len(stored) == 64:
        if hashlib.sha256(content).hexdigest() != stored:
            return "sha256 does not match"
    elif content[-4:].hex() != stored:
        return "not the chunk that was written"
    if _crc32c(content[:-4]).to_bytes(4, "little") != content[-4:]:
        return "checksum does not match"
    if decoded is not None and (len(content) < 20 or int.from_bytes(content[4:8], "little") != decoded):
        return f"it does not unpack to {decoded} bytes"
    return ""


def _crc32c(content: bytes) -> int:
    # The implementation that zarr's codec uses; zarr depends on it.
    import google_crc32c

    return int(google_crc32c.value(content))
