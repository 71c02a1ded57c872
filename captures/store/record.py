"""The second manifest of a store: a journal of all of its captures, from which all other metadata can be written again.

`record.jsonl` has one line for the format and the number of captures, one for the structure, and one for each capture with its
attributes and the marks of its chunks; each line begins with its sha256. It holds all that the first manifest and the `zarr.json`
files hold, so that damage of either set can be mended from the other.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError
from ...scenes.json_keys import read_json
from ..layouts.schema import SCHEMA_VERSION
from .arrays import chunk_keys, metadata_files
from .journal import Journal, Record, line_of, read_journal
from .layout import attributes_problem, group_structure
from .manifest import (
    FORMAT,
    RECORD,
    STORE_VERSION,
    TAKE_ANEW,
    DamagedManifest,
    Manifest,
    chunk_mark,
    regular_size,
)

__all__ = ["journal_of_group", "manifest_of", "metadata_of", "read_record", "record_text", "with_sums"]


def record_text(journal: Journal) -> bytes:
    """The second manifest of a complete store."""
    lines: list[dict[str, Any]] = [
        {"format": FORMAT, "store_version": STORE_VERSION, "count": len(journal.records)},
        {"modality": journal.modality, "structure": journal.structure},
        *({"attrs": one.attrs, "texts": one.texts, "chunks": one.chunks} for one in journal.records),
    ]
    return b"".join(map(line_of, lines))


def read_record(root: Path) -> Journal:
    """The second manifest at `root`. Raises DamagedManifest where it is absent or not whole, InputError where it is hostile."""
    damaged = DamagedManifest(
        "The manifest and the second manifest are damaged.", where=str(root), value=RECORD, next_step=TAKE_ANEW
    )
    size = regular_size(root / RECORD)
    if size is None:
        raise damaged
    try:
        journal = read_journal(root, RECORD)
    except InputError as error:
        raise damaged from error
    if journal.sound_bytes != size or journal.stated != len(journal.records) or not journal.records:
        raise damaged
    return journal


def metadata_of(journal: Journal) -> dict[str, bytes]:
    """Content of every `zarr.json` of the complete store, by path."""
    attributes = {
        "schema_version": SCHEMA_VERSION,
        "modality": journal.modality,
        "variables": list(journal.structure),
        "captures": [record.attrs for record in journal.records],
        "texts": journal.texts,
    }
    return metadata_files(journal.structure, len(journal.records), attributes)


def manifest_of(journal: Journal) -> Manifest:
    """The manifest of the complete store, with the metadata as this version of zarr writes them."""
    metadata = {name: hashlib.sha256(content).hexdigest() for name, content in metadata_of(journal).items()}
    record = hashlib.sha256(record_text(journal)).hexdigest()
    return Manifest(journal.modality, len(journal.records), metadata, journal.chunks, record)


def journal_of_group(root: Path, manifest: Manifest) -> Journal:
    """The journal of a store whose group metadata are sound, but the second manifest is damaged or absent (version 1).

    Raises KeyError, TypeError, ValueError, AttributeError, OSError where the metadata are not those of a store.
    """
    body: Any = read_json((root / "zarr.json").read_bytes())
    attributes, texts = body["attributes"], body["attributes"]["texts"]
    structure = group_structure(attributes, body["consolidated_metadata"]["metadata"])
    records: list[Record] = []
    told: set[str] = set()
    for index, attrs in enumerate(attributes["captures"]):
        if wrong := attributes_problem(attrs, texts):
            raise ValueError(wrong)
        new = {value: texts[value] for kind, value in attrs.values() if kind == "text" and value not in told}
        told |= set(new)
        records.append(Record(attrs, new, {
            name: {key: manifest.chunks[name][key] for key in chunk_keys(index, entry)} for name, entry in structure.items()
        }))  # fmt: skip
    return Journal(manifest.modality, structure, records)


def with_sums(root: Path, journal: Journal) -> Journal:
    """The journal with the sha256 of chunks that have a CRC-32C only (unfinished stores of version 1). Raises OSError."""
    records = [
        Record(one.attrs, one.texts, {
            name: {key: mark if len(mark[1]) == 64 else chunk_mark(root / name / key) for key, mark in marks.items()}
            for name, marks in one.chunks.items()
        })
        for one in journal.records
    ]  # fmt: skip
    return Journal(journal.modality, journal.structure, records)
