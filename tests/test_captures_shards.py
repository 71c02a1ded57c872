"""Stores of many captures: valid Zarr, whole shards only, every flipped bit found, and each file written again from the others."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.captures import finalize, open_captures, repair, verify
from beambench.captures.contents import contents
from beambench.captures.example import example_capture
from beambench.captures.layouts import LAYOUTS
from beambench.captures.store.journal import JOURNAL, mark_journal
from beambench.captures.store.ownership import remove_store
from beambench.captures.store.shard_chunks import decode_block, encode_block, index_of, inner_shape
from beambench.captures.store.shard_finish import write_request
from beambench.captures.store.shard_receipts import content_of, read_receipt
from beambench.captures.store.shard_writer import ShardWriter
from beambench.scenes.errors import InputError

LENGTH = 3
#: The modality of most tests: that with the fewest arrays.
MODALITY = "amcw"


def captures_of(modality: str, count: int) -> list[xr.Dataset]:
    return [example_capture(modality, seed=number).assign_attrs(seed=number) for number in range(count)]


def begun(partial: Path, count: int) -> None:
    partial.mkdir()
    with open(partial / JOURNAL, "xb") as file:
        mark_journal(file)
    write_request(partial, {"name": "x", "count": count, "identity": "i", "numbers": ["a"], "texts": ["b"]})


def filled(
    partial: Path, group: str, captures: Sequence[xr.Dataset], first: int = 0, leave_out: Sequence[int] = ()
) -> None:
    for shard, begin in enumerate(range(0, len(captures), LENGTH)):
        if shard in leave_out:
            continue
        own = captures[begin : begin + LENGTH]
        rows = range(first + begin, first + begin + len(own))
        with ShardWriter(partial, group, shard, rows, LENGTH, last=begin + LENGTH >= len(captures)) as writer:
            for number, capture in enumerate(own):
                writer.append(
                    capture, {"part": "train", "values": {"a": number / 2, "b": "x"}, "base": "w", "draw": number}
                )
            writer.close()


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


def test_a_flip_of_any_file_is_found_and_mended(store: Path, tmp_path: Path) -> None:
    """Two bits of every file of the store: `verify` names it; `repair` loses one capture for a chunk, and none for the rest."""
    before = [capture.load() for capture in open_captures(store)]
    content = open_captures(store).sha256
    rng = np.random.default_rng(1)
    work = tmp_path / "work"
    files = sorted(path for path in store.rglob("*") if path.is_file())
    assert len(files) > 20
    for path in files:
        for bit in rng.integers(0, 8 * path.stat().st_size, 2):
            shutil.copytree(store, work)
            place = path.relative_to(store)
            whole = bytearray((work / place).read_bytes())
            whole[bit // 8] ^= 1 << bit % 8
            (work / place).write_bytes(whole)
            assert str(place) in {damage.file for damage in verify(work)}, place
            done = repair(work)
            assert verify(work) == []
            assert len(done.dropped) <= (place.name.startswith("c.")), place
            after = open_captures(work)
            kept = [one for number, one in enumerate(before) if number not in done.dropped]
            assert len(after) == len(kept)
            assert all(one.identical(other) for one, other in zip(after, kept, strict=True))
            assert done.dropped or after.sha256 == content, place
            shutil.rmtree(work)


@pytest.mark.parametrize("keep", [0, 1, 100])
def test_a_truncated_file_is_found_and_mended(store: Path, tmp_path: Path, keep: int) -> None:
    before = [capture.load() for capture in open_captures(store)]
    work = tmp_path / "work"
    for path in sorted(path for path in store.rglob("*") if path.is_file()):
        shutil.copytree(store, work)
        place = path.relative_to(store)
        if path.stat().st_size <= keep:
            shutil.rmtree(work)
            continue
        (work / place).write_bytes(path.read_bytes()[:keep])
        assert str(place) in {damage.file for damage in verify(work)}, place
        done = repair(work, make=lambda attrs, where: before[int(attrs["seed"])])
        assert verify(work) == []
        assert done.dropped == ()
        assert all(one.identical(other) for one, other in zip(open_captures(work), before, strict=True))
        shutil.rmtree(work)


def test_a_missing_file_is_found_on_opening(store: Path) -> None:
    next((store / MODALITY / "samples").glob("c.1*")).unlink()
    with pytest.raises(InputError, match=r"missing|damaged"):
        open_captures(store)


def test_a_dropped_capture_leaves_its_place_empty(store: Path) -> None:
    """Its neighbours keep their places, and zarr reads the fill value in its own."""
    import pandas as pd
    import zarr

    path = store / MODALITY / "samples" / "c.1.0.0.0"
    content = bytearray(path.read_bytes())
    content[30] ^= 1
    path.write_bytes(content)
    assert repair(store).dropped == (3,)
    group: Any = zarr.open_group(str(store / MODALITY), mode="r")
    index = pd.read_parquet(store / "index.parquet")
    captures = open_captures(store)
    assert index["capture"].tolist() == [0, 1, 2, 4, 5, 6]
    for number, position in enumerate(index["position"]):
        np.testing.assert_array_equal(group["samples"][position], captures[number]["samples"].values)
    assert np.isnan(group["samples"][3]).all()
    assert np.isnan(group["truth_range"][3]).all()


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


def flip(path: Path, at: int = 30) -> None:
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)


def files_of(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


@pytest.mark.parametrize("whole_shard", [False, True])
def test_what_a_plain_repair_drops_is_made_again_later(store: Path, whole_shard: bool) -> None:
    """Its record stays: a later repair that makes captures again gives the very files that were there."""
    before, whole = [capture.load() for capture in open_captures(store)], files_of(store)
    path = store / MODALITY / "samples" / "c.1.0.0.0"
    path.unlink() if whole_shard else flip(path)
    gone = (3, 4, 5) if whole_shard else (3,)
    assert repair(store).dropped == gone
    assert verify(store) == []
    told = contents(store)
    assert (told["state"], told["missing"], tuple(told["dropped"])) == ("incomplete", len(gone), gone)
    assert len(open_captures(store)) == 7 - len(gone)
    flip(store / "receipts" / f"{MODALITY}.000001.z")  # the record has a copy, as others have
    assert verify(store)
    assert repair(store).dropped == ()
    done = repair(store, make=lambda attrs, where: before[int(attrs["seed"])])
    assert done.remade == gone
    assert files_of(store) == whole
    assert contents(store)["state"] == "complete"


def test_a_capture_that_is_made_otherwise_stays_lost(store: Path) -> None:
    flip(store / MODALITY / "samples" / "c.1.0.0.0")
    repair(store)
    other = example_capture(MODALITY, seed=99)
    done = repair(store, make=lambda attrs, where: other)
    assert done.remade == ()
    assert "capture 3" in done.not_remade[0]
    assert contents(store)["dropped"] == [3]


def test_status_tells_what_is_lost(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from beambench import cli

    assert cli.main(["data", "status", str(store)]) == 0
    assert "complete, 7 of 7" in capsys.readouterr().out
    (store / MODALITY / "samples" / "c.2.0.0.0").write_bytes(b"")
    assert cli.main(["data", "status", str(store)]) == 1
    assert "damaged, 6 of 7" in capsys.readouterr().out
    shutil.rmtree(store / "receipts")
    assert cli.main(["data", "status", str(store)]) == 1
    told = capsys.readouterr().out
    assert "damaged, 0 of 7" in told
    assert f"{MODALITY}.000001.z" in told
    assert "--resume" in told


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
