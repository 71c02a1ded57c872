"""Stores of many captures: valid Zarr, whole shards only, and nothing of others is touched."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.captures import finalize, open_captures, repair, verify
from beambench.captures.contents import contents
from beambench.captures.example import example_capture
from beambench.captures.layouts import LAYOUTS
from beambench.captures.store.ownership import remove_store
from beambench.captures.store.shard_chunks import decode_block, encode_block, index_of, inner_shape
from beambench.captures.store.shard_receipts import content_of, read_receipt
from beambench.captures.store.shard_writer import ShardWriter
from beambench.scenes.errors import InputError

from ._shards import LENGTH, MODALITY, begun, captures_of, filled


@pytest.fixture
def store(tmp_path: Path) -> Path:
    begun(tmp_path / "s.partial", 7)
    filled(tmp_path / "s.partial", MODALITY, captures_of(MODALITY, 7))
    finalize(tmp_path / "s")
    return tmp_path / "s"


@pytest.mark.parametrize("modality", list(LAYOUTS))
def test_what_is_written_is_read_and_zarr_reads_the_same(tmp_path: Path, modality: str) -> None:
    import zarr

    captures = captures_of(modality, 4)
    begun(tmp_path / "s.partial", 4)
    filled(tmp_path / "s.partial", modality, captures)
    finalize(tmp_path / "s")
    assert verify(tmp_path / "s") == []
    read = open_captures(tmp_path / "s")
    group: Any = zarr.open_group(str(tmp_path / "s" / modality), mode="r")
    for number, capture in enumerate(captures):
        assert read[number].identical(capture)
        for name, variable in capture.variables.items():
            np.testing.assert_array_equal(group[name][number], variable.values)
    opened = xr.open_zarr(tmp_path / "s" / modality, consolidated=True)
    assert opened.sizes["capture"] == 4


def test_a_group_of_several_is_named_by_its_folder(tmp_path: Path) -> None:
    begun(tmp_path / "s.partial", 5)
    filled(tmp_path / "s.partial", "gated", captures_of("gated", 3))
    filled(tmp_path / "s.partial", "amcw", captures_of("amcw", 2), first=3)
    finalize(tmp_path / "s")
    with pytest.raises(InputError, match="several modalities"):
        open_captures(tmp_path / "s")
    assert [len(open_captures(tmp_path / "s" / name)) for name in ("gated", "amcw")] == [3, 2]
    assert open_captures(tmp_path / "s" / "amcw").modality == "amcw"


def test_large_captures_are_stored_in_equal_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    import zarr

    monkeypatch.setattr("beambench.captures.store.shard_chunks.CHUNK_BYTES", 100)
    entry = {"dims": ["slice", "row", "col"], "shape": [3, 12, 5], "dtype": "uint16"}
    assert inner_shape(entry) == (3, 3, 5)
    assert inner_shape({"dims": ["a"], "shape": [7], "dtype": "float64"}) == (7,)
    assert zarr.__version__


@pytest.mark.parametrize("dtype", ["bool", "uint16", "float32", "complex64", "int32"])
def test_a_chunk_survives(dtype: str) -> None:
    values = (np.arange(60) % 2).astype(dtype).reshape(3, 4, 5)
    entry = {"dims": ["a", "b", "c"], "shape": [3, 4, 5], "dtype": dtype}
    content = encode_block(values)
    np.testing.assert_array_equal(decode_block(content, entry), values)
    with pytest.raises(ValueError, match="unpack"):
        decode_block(content, entry | {"shape": [3, 4, 6]})
    with pytest.raises(ValueError, match=r"checksum|unpack"):
        decode_block(content[:-5] + b"x" + content[-4:], entry)


def test_empty_chunks_are_written(tmp_path: Path) -> None:
    """A chunk of zeros that were left out would read as zeros after it was lost, too."""
    capture = example_capture("amcw")
    for name in capture.data_vars:
        capture[name].values[...] = 0 if capture[name].dtype.kind in "iub" else capture[name].values
    capture["samples"].values[...] = 0
    begun(tmp_path / "s.partial", 3)
    filled(tmp_path / "s.partial", "amcw", [capture] * 3)
    content = next((tmp_path / "s.partial" / "amcw" / "samples").glob("c.*")).read_bytes()
    assert all(size < 2**63 for _, size in index_of(content, LENGTH))


def test_misaligned_writes_are_refused(tmp_path: Path) -> None:
    begun(tmp_path / "s.partial", 7)
    captures = captures_of("amcw", 4)
    with pytest.raises(InputError, match="written whole"):
        ShardWriter(tmp_path / "s.partial", "amcw", 0, [0, 1], LENGTH, last=False)
    with pytest.raises(InputError, match="written whole"):
        ShardWriter(tmp_path / "s.partial", "amcw", 0, range(4), LENGTH, last=True)
    with ShardWriter(tmp_path / "s.partial", "amcw", 0, range(3), LENGTH, last=False) as writer:
        writer.append(captures[0], {})
        with pytest.raises(InputError, match="written whole"):
            writer.close()
        writer.append(captures[1], {})
        writer.append(captures[2], {})
        with pytest.raises(InputError, match="full"):
            writer.append(captures[3], {})
    with ShardWriter(tmp_path / "s.partial", "amcw", 1, range(3), LENGTH, last=False) as writer:
        writer.append(captures[0], {})
        with pytest.raises(InputError, match="one layout"):
            writer.append(example_capture("gated"), {})
    with pytest.raises(InputError, match="no complete shard"):
        finalize(tmp_path / "s")


def test_a_shard_that_is_not_there_is_left_out(tmp_path: Path) -> None:
    captures = captures_of(MODALITY, 9)
    begun(tmp_path / "s.partial", 9)
    filled(tmp_path / "s.partial", MODALITY, captures, leave_out=[1])
    assert contents(tmp_path / "s")["count"] == 6
    assert finalize(tmp_path / "s").kept == 6
    read = open_captures(tmp_path / "s")
    assert [read.number(index) for index in range(6)] == [0, 1, 2, 6, 7, 8]
    assert read[3].identical(captures[6])
    assert verify(tmp_path / "s") == []
    told = contents(tmp_path / "s")
    assert (told["count"], told["asked"], told["finished"]) == (6, 9, True)


def test_ids_are_of_the_content_alone() -> None:
    """Neither of its compression, nor of the order of its variables, nor of the machine that made it."""
    capture = example_capture("amcw")
    arrays = {str(name): one.values for name, one in capture.variables.items()}
    attrs = dict(capture.attrs)
    first = content_of(arrays, attrs)
    assert first == content_of(dict(reversed(arrays.items())), attrs | {"provenance": "{}"})
    assert first != content_of(arrays, attrs | {"seed": 99})
    changed = {name: values.copy() for name, values in arrays.items()}
    changed["samples"].ravel()[0] += 1
    assert first != content_of(changed, attrs)


def test_others_files_are_told_and_never_removed(store: Path) -> None:
    (store / "notes.txt").write_text("mine")
    (store / MODALITY / "samples" / "notes.txt").write_text("mine")
    (store / "receipts" / "more").mkdir()
    foreign = {damage.file for damage in verify(store)}
    assert {"notes.txt", f"{MODALITY}/samples/notes.txt", "receipts/more"} <= foreign
    for act in (lambda: repair(store), lambda: remove_store(store)):
        with pytest.raises(InputError, match="not its own"):
            act()


def test_a_link_out_of_the_store_is_not_followed(store: Path, tmp_path: Path) -> None:
    place = store / MODALITY / "samples"
    shutil.move(place, tmp_path / "elsewhere")
    place.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError):
        open_captures(store)[0]
    assert any("link" in damage.problem or "not a file" in damage.problem for damage in verify(store))


def test_a_store_is_removed_whole(store: Path) -> None:
    remove_store(store)
    assert not store.exists()


def test_hostile_receipts_and_manifests_are_refused(store: Path) -> None:
    import hashlib
    import zlib

    def receipt(change: dict[str, Any]) -> bytes:
        text = json.dumps(json.loads(zlib.decompress(good).partition(b" ")[2]) | change).encode()
        return zlib.compress(hashlib.sha256(text).hexdigest().encode() + b" " + text)

    path = store / "receipts" / f"{MODALITY}.000000.z"
    good = path.read_bytes()
    for change in (
        {"group": "../x"}, {"structure": {"../x": {}}}, {"length": 2**40}, {"captures": [{}]}, {"captures": None}, {"texts": []},
        {"structure": None}, {"shard": -1},
    ):  # fmt: skip
        path.write_bytes(receipt(change))
        with pytest.raises(InputError, match="receipt"):
            read_receipt(store, MODALITY, 0)
    path.write_bytes(zlib.compress(b"0" * (2**28 + 2**20)))
    with pytest.raises(InputError, match="too large"):
        read_receipt(store, MODALITY, 0)
    path.write_bytes(good)
    text = (store / "manifest.json").read_text()
    for old, new in (
        ('"length": 3', '"length": -3'),
        ('"amcw.000000.z"', '"../x.000000.z"'),
        ('"rows": 7', '"rows": "7"'),
    ):
        assert old in text
        bad = text.replace(old, new).encode()
        (store / "manifest.json").write_bytes(bad)
        (store / "manifest.sha256").write_text(hashlib.sha256(bad).hexdigest() + "\n")
        with pytest.raises(InputError, match="not that of a store"):
            open_captures(store)


def test_reading_names_what_does_not_exist(store: Path) -> None:
    captures = open_captures(store)
    with pytest.raises(InputError, match="no such variable"):
        captures.load(0, ["nothing"])
    with pytest.raises(IndexError):
        captures[7]
    assert captures[-1].identical(captures[6])
    assert list(captures.load(0, ["truth_range"]).variables) == ["truth_range"]


def test_shards_are_not_taken_for_an_empty_store(tmp_path: Path) -> None:
    """A store of the other kind is not begun in the place of an unfinished data set, but with `overwrite`."""
    from beambench.captures import write
    from beambench.captures.store.status import status

    begun(tmp_path / "s.partial", 4)
    filled(tmp_path / "s.partial", MODALITY, captures_of(MODALITY, 4), leave_out=[1])
    assert (status(tmp_path / "s").state, status(tmp_path / "s").count) == ("unfinished", 3)
    for resume in (False, True):
        with pytest.raises(InputError, match="in the way"):
            write(tmp_path / "s", captures_of(MODALITY, 2), resume=resume)
    assert finalize(tmp_path / "s").kept == 3
    assert (status(tmp_path / "s").state, status(tmp_path / "s").count) == ("complete", 3)
    write(tmp_path / "s", captures_of(MODALITY, 2), overwrite=True)
    assert len(open_captures(tmp_path / "s")) == 2
    assert not (tmp_path / "s" / "receipts").exists()


def test_two_writers_of_one_shard_do_not_mix(tmp_path: Path) -> None:
    """A worker that was taken for dead goes on beside the one that took its place: each has files of its own."""
    captures = captures_of(MODALITY, 2)
    begun(tmp_path / "s.partial", 2)
    first, second = (ShardWriter(tmp_path / "s.partial", MODALITY, 0, [0, 1], 2, last=True) for _ in range(2))
    with first, second:
        for writer, capture in ((first, captures[0]), (second, captures[0]), (second, captures[1])):
            writer.append(capture, {})
        second.close()
        first.append(captures[1], {})
        first.close()
    assert verify(tmp_path / "s.partial") == []
    (tmp_path / "s.partial" / MODALITY / "samples" / f"c.0.0.0.0.{'a' * 32}.partial").write_bytes(b"left by a stop")
    finalize(tmp_path / "s")
    assert verify(tmp_path / "s") == []
    assert open_captures(tmp_path / "s")[1].identical(captures[1])
