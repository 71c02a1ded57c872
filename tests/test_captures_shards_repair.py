"""Stores of many captures: every flipped bit is found, and each file is written again from the others."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.captures import finalize, open_captures, repair, verify
from beambench.captures.contents import contents
from beambench.captures.example import example_capture
from beambench.scenes.errors import InputError

from ._shards import MODALITY, begun, captures_of, filled


@pytest.fixture
def store(tmp_path: Path) -> Path:
    begun(tmp_path / "s.partial", 7)
    filled(tmp_path / "s.partial", MODALITY, captures_of(MODALITY, 7))
    finalize(tmp_path / "s")
    return tmp_path / "s"


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
