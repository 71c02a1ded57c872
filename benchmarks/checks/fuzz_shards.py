"""What the campaigns of fuzzed and flipped inputs read of data sets: a store of shards, finished, its values changed and sealed."""

from __future__ import annotations

import hashlib
import json
import zlib
from pathlib import Path

import numpy as np

from .example_modalities import SMALL
from .fuzz_specs import Subject, all_tried, any_file
from .mutations import json_mutated, mutated

__all__ = ["SHARDED", "sharded_store"]

#: Captures of a shard, and of the store.
_LENGTH, _COUNT = 2, 3


def sharded_store(folder: Path) -> None:
    """Write a small data set, `folder`/s."""
    from ...captures import finalize
    from ...captures.example import example_capture
    from ...captures.store.journal import JOURNAL, mark_journal
    from ...captures.store.shard_finish import write_request
    from ...captures.store.shard_writer import ShardWriter

    partial = folder / "s.partial"
    partial.mkdir()
    with open(partial / JOURNAL, "xb") as file:
        mark_journal(file)
    write_request(partial, {"name": "s", "count": _COUNT, "identity": "i", "numbers": ["a"], "texts": []})
    for shard, first in enumerate(range(0, _COUNT, _LENGTH)):
        rows = range(first, min(first + _LENGTH, _COUNT))
        with ShardWriter(partial, "small", shard, rows, _LENGTH, last=first + _LENGTH >= _COUNT) as writer:
            for row in rows:
                capture = example_capture(SMALL, seed=row, optional=False)
                writer.append(capture, {"part": "train", "values": {"a": row / 2}})
            writer.close()
    finalize(folder / "s")


def _hostile(folder: Path, rng: np.random.Generator) -> None:
    """Change a value of a receipt and its copy, of the request, the manifest or a `zarr.json`, each with its right checksum."""
    store = folder / "s"
    names = ["manifest.json", "dataset.json", *(f"receipts/small.{n:06d}.z" for n in range(2))]
    names += [str(path.relative_to(store)) for path in sorted(store.rglob("zarr.json"))]
    name = names[int(rng.integers(len(names)))]
    path = store / name
    if name.startswith("receipts"):
        text = json_mutated(zlib.decompress(path.read_bytes()).partition(b" ")[2], rng)
        content = zlib.compress(hashlib.sha256(text).hexdigest().encode() + b" " + text)
        path.with_name(path.name + ".copy").write_bytes(content)
    else:
        content = json_mutated(path.read_bytes(), rng)
    path.write_bytes(content)
    _seal(store)


def _hostile_chunks(folder: Path, rng: np.random.Generator) -> None:
    """Change the bytes of a chunk, under the right CRC-32C, and under the right sha256 in the receipts and the manifest."""
    import google_crc32c

    store = folder / "s"
    shard = int(rng.integers(2))
    path = store / "receipts" / f"small.{shard:06d}.z"
    body = json.loads(zlib.decompress(path.read_bytes()).partition(b" ")[2])
    held = body["captures"][int(rng.integers(len(body["captures"])))]
    name = sorted(held["chunks"])[int(rng.integers(len(held["chunks"])))]
    mark = held["chunks"][name][0]
    file = next((store / "small" / name).glob(f"c.{shard}*"))
    content = bytearray(file.read_bytes())
    old = bytes(content[mark[0] : mark[0] + mark[1] - 4])
    # Bytes of the header, which state sizes, are changed as often as all others together.
    new = bytearray(mutated(old, rng)[: len(old)].ljust(len(old), b"\0"))
    if rng.random() < 0.5:
        new[int(rng.integers(min(16, len(new))))] ^= 1 << int(rng.integers(8))
    chunk = bytes(new) + int(google_crc32c.value(bytes(new))).to_bytes(4, "little")
    content[mark[0] : mark[0] + mark[1]] = chunk
    file.write_bytes(content)
    mark[2] = hashlib.sha256(chunk).hexdigest()
    text = json.dumps(body, sort_keys=True).encode()
    receipt = zlib.compress(hashlib.sha256(text).hexdigest().encode() + b" " + text)
    for place in (path, path.with_name(path.name + ".copy")):
        place.write_bytes(receipt)
    _seal(store)


def _seal(store: Path) -> None:
    """Give the manifest the checksums of what it lists."""
    try:
        manifest = json.loads((store / "manifest.json").read_bytes())
        for name in manifest["metadata"]:
            manifest["metadata"][name] = hashlib.sha256((store / name).read_bytes()).hexdigest()
        for name, listed in manifest["shards"].items():
            listed[0] = hashlib.sha256((store / "receipts" / name).read_bytes()).hexdigest()
    except (ValueError, TypeError, AttributeError, KeyError, OSError):
        pass  # the manifest itself is no manifest any more
    else:
        (store / "manifest.json").write_text(json.dumps(manifest))
    text = (store / "manifest.json").read_bytes()
    (store / "manifest.sha256").write_text(hashlib.sha256(text).hexdigest() + "\n")


def _read(folder: Path) -> None:
    from ...captures import open_captures, repair, verify
    from ...captures.contents import contents
    from ...captures.lazy import dataset
    from ...captures.readers import Captures

    store = folder / "s"
    all_tried(
        lambda: [capture.load() for capture in open_captures(store)],
        lambda: Captures(store, part="train")[0],
        lambda: dataset(store).isel(capture=-1).load(),
        lambda: contents(store),
        lambda: verify(store),
        lambda: repair(store),
    )


#: Kinds of inputs, for the tables of `fuzz` and `flips`.
SHARDED: dict[str, Subject] = {
    "data sets, bytes": Subject(sharded_store, any_file, _read),
    "data sets, values under right checksums": Subject(sharded_store, _hostile, _read),
    "data sets, chunks under right checksums": Subject(sharded_store, _hostile_chunks, _read),
}
