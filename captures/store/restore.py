"""Write damaged metadata of a store again, from the second manifest or, where that is the damaged one, from the others."""

from __future__ import annotations

import hashlib
from pathlib import Path

from ...scenes.errors import InputError
from .journal import Journal, fsync_path, write_file
from .manifest import (
    MANIFEST,
    MANIFEST_SUM,
    RECORD,
    TAKE_ANEW,
    DamagedManifest,
    Manifest,
    check_metadata,
    load_manifest,
    regular_size,
    sum_text,
)
from .record import journal_of_group, manifest_of, metadata_of, read_record, record_text

__all__ = ["restore_metadata", "write_changed"]


def restore_metadata(root: Path) -> list[str]:
    """Write the damaged metadata files of the store at `root` again, and return their names.

    Every file is compared with the sha256 that the sound manifest states, where there is one; the second manifest is taken only
    if it is whole. Raises InputError where neither suffices, OSError.
    """
    try:
        manifest: Manifest | None = load_manifest(root)
    except DamagedManifest:
        manifest = None
    damaged = [] if manifest is None else [name for name, _ in check_metadata(root, manifest)]
    journal = _second(root, manifest)
    if manifest is None:
        if journal is None:
            read_record(root)  # tells what is wrong
            raise _beyond(root, MANIFEST)
    elif not damaged and (journal is not None or not manifest.record):
        return []
    if journal is None:
        assert manifest is not None
        journal = _from_group(root, manifest, damaged)
    new = manifest_of(journal)
    contents = metadata_of(journal)
    old = manifest.metadata if manifest is not None else new.metadata
    # What is sound stays as it is: another version of zarr may have written it in other words.
    kept = [] if manifest is None else [name for name in contents if name in old and name not in damaged]
    if manifest is not None and not manifest.record:
        return _of_version_1(root, manifest, contents, damaged)
    metadata = {name: old[name] if name in kept else new.metadata[name] for name in contents}
    final = Manifest(new.modality, new.count, metadata, new.chunks, new.record)
    text = final.text().encode()
    files = {name: content for name, content in contents.items() if name not in kept}
    files |= {RECORD: record_text(journal), MANIFEST: text, MANIFEST_SUM: sum_text(text)}
    return write_changed(root, files)


def _second(root: Path, manifest: Manifest | None) -> Journal | None:
    """The second manifest, None where it is damaged or not that of `manifest`."""
    try:
        journal = read_record(root)
    except DamagedManifest:
        return None
    text = record_text(journal)
    return journal if manifest is None or hashlib.sha256(text).hexdigest() == manifest.record else None


def _from_group(root: Path, manifest: Manifest, damaged: list[str]) -> Journal:
    if "zarr.json" in damaged:
        raise _beyond(root, "zarr.json")
    try:
        return journal_of_group(root, manifest)
    except (KeyError, TypeError, ValueError, AttributeError, OSError, RecursionError) as error:
        raise InputError(f"The metadata of the store are not those of captures: {error!r}.", where=str(root)) from error


def _of_version_1(root: Path, manifest: Manifest, contents: dict[str, bytes], damaged: list[str]) -> list[str]:
    """A store of version 1 keeps its manifest, so that only files with exactly the stated sha256 are written."""
    for name in damaged:
        if hashlib.sha256(contents.get(name, b"")).hexdigest() != manifest.metadata[name]:
            raise _beyond(root, name)
    return write_changed(root, {name: contents[name] for name in damaged})


def write_changed(root: Path, files: dict[str, bytes]) -> list[str]:
    """Write those files that differ from what is on disk, the manifest last."""
    changed = []
    for name, content in files.items():
        file = root / name
        if file.parent.is_symlink():
            raise InputError(
                "A folder of the store is a link.", where=str(file.parent), next_step="do not use this store"
            )
        if regular_size(file) is None or file.read_bytes() != content:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_file(file, content)
            changed.append(name)
    fsync_path(root)
    return changed


def _beyond(root: Path, name: str) -> InputError:
    return InputError(
        f"The metadata are damaged, so that no capture can be trusted: {name}.", where=str(root), next_step=TAKE_ANEW
    )
