"""Every damage of a store is reported: flipped bits, lost files, full disks, refused folders, killed writers."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.captures import CaptureWriter, finalize, open_captures, repair, verify, write
from beambench.captures.example import example_capture
from beambench.captures.store.manifest import load_manifest
from beambench.captures.store.verification import chunk_problem
from beambench.scenes.errors import InputError


@pytest.fixture(scope="module")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    captures = [example_capture("gated", seed=seed) for seed in range(3)]
    return write(tmp_path_factory.mktemp("pristine") / "store", captures)


@pytest.fixture
def store(pristine: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(pristine, tmp_path / "store"))


def files_of(store: Path) -> list[Path]:
    return sorted(file for file in store.rglob("*") if file.is_file())


def detected_on_reading(store: Path) -> bool:
    try:
        for capture in open_captures(store):
            capture.load()
    except InputError:
        return True
    return False


def detected_by_verify(store: Path) -> bool:
    try:
        return bool(verify(store))
    except InputError:
        return True


def flip(file: Path, bit: int) -> None:
    content = bytearray(file.read_bytes())
    content[bit // 8] ^= 1 << (bit % 8)
    file.write_bytes(content)


def test_a_flipped_bit_in_any_file_is_detected(store: Path) -> None:
    # Every file once (metadata, manifest, coordinates, data), and 25 more anywhere, weighted by size. Reading is the
    # slower way: every fourth file is read as well, and all of the 25.
    rng = np.random.default_rng(2)
    files = files_of(store)
    sizes = np.array([file.stat().st_size for file in files])
    anywhere = rng.choice(len(files), 25, p=sizes / sizes.sum())
    missed = []
    for turn, number in enumerate([*range(len(files)), *anywhere]):
        file = files[number]
        original = file.read_bytes()
        bit = int(rng.integers(8 * len(original)))
        flip(file, bit)
        # The second manifest is not read where the first is sound.
        read_too = (turn % 4 == 0 or turn >= len(files)) and file.name != "record.jsonl"
        if not detected_by_verify(store) or (read_too and not detected_on_reading(store)):
            missed.append((file, bit))
        file.write_bytes(original)
    assert not missed
    assert verify(store) == [] and not detected_on_reading(store)


def test_every_bit_of_a_delay_chunk(store: Path) -> None:
    file = store / "delay" / "c.1.0"
    mark = load_manifest(store).chunks["delay"]["c.1.0"]
    assert chunk_problem(file, mark) == ""
    bits = 8 * file.stat().st_size
    for bit in range(bits):
        flip(file, bit)
        assert chunk_problem(file, mark), bit
        flip(file, bit)
    assert bits > 300 and chunk_problem(file, mark) == ""


@pytest.mark.parametrize("name", ["counts/c.1.0.0.0", "delay/c.2.0", "zarr.json", "gate/zarr.json", "manifest.json"])
@pytest.mark.parametrize("how", ["truncated", "emptied", "missing", "lengthened", "linked"])
def test_a_damaged_file_is_named(store: Path, name: str, how: str) -> None:
    file = store / name
    content = file.read_bytes()
    file.unlink()
    if how == "truncated":
        file.write_bytes(content[:-3])
    elif how == "emptied":
        file.touch()
    elif how == "lengthened":
        file.write_bytes(content + b"\0")
    elif how == "linked":
        (store.parent / "elsewhere").write_bytes(content)
        file.symlink_to(store.parent / "elsewhere")
    if how == "linked" and name == "manifest.json":
        assert len(open_captures(store)) == 3  # the same bytes by another way; its sha256 still guards them
        return
    with pytest.raises(InputError) as caught:
        open_captures(store)
    assert name.split("/")[0] in str(caught.value) or "manifest" in str(caught.value)
    if name != "manifest.json":
        assert name in [damage.file for damage in verify(store)]


def test_a_swapped_chunk_with_a_sound_checksum_is_detected(store: Path) -> None:
    first, second = store / "truth_range" / "c.0.0.0", store / "truth_range" / "c.1.0.0"
    assert first.stat().st_size == second.stat().st_size  # so that only its checksum shows it
    first.write_bytes(second.read_bytes())
    open_captures(store)
    assert detected_by_verify(store) and detected_on_reading(store)


def test_a_chunk_lost_after_opening_is_not_read_as_zeros(store: Path) -> None:
    opened = open_captures(store)
    (store / "counts" / "c.1.0.0.0").unlink()
    opened[0]
    with pytest.raises(InputError, match="A chunk is damaged"):
        opened[1]


def test_a_checksum_failure_on_reading_says_what_to_do(store: Path) -> None:
    file = store / "truth_range" / "c.0.0.0"
    flip(file, 8 * (file.stat().st_size // 2))
    with pytest.raises(InputError, match="beambench data verify"):
        open_captures(store)[0]
    open_captures(store)[1]


def forge(store: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Alter the manifest and give it a matching sha256, as a hostile or broken writer would."""
    body = json.loads((store / "manifest.json").read_text())
    change(body)
    text = json.dumps(body).encode()
    (store / "manifest.json").write_bytes(text)
    (store / "manifest.sha256").write_text(hashlib.sha256(text).hexdigest() + "\n")


@pytest.mark.parametrize("key", ["../secret", "/etc/passwd", "counts/../../secret", "", ".hidden", "a//b"])
def test_paths_that_leave_the_store_are_refused(store: Path, key: str) -> None:
    (store.parent / "secret").write_text("private")
    forge(store, lambda body: body["metadata"].update({key: hashlib.sha256(b"private").hexdigest()}))
    for look in (open_captures, verify):
        with pytest.raises(InputError, match="leaves the store"):
            look(store)


def test_a_folder_that_leads_out_of_the_store_is_refused(store: Path) -> None:
    shutil.move(store / "delay", store.parent / "outside")
    (store / "delay").symlink_to(store.parent / "outside")
    with pytest.raises(InputError, match="leads out"):
        open_captures(store)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda body: body.update(schema_version=2), "another version"),
        (lambda body: body.update(store_version=99), "another version"),
        (lambda body: body.pop("chunks"), "not that of a store of captures"),
        (lambda body: body.update(chunks=[1]), "not that of a store of captures"),
        (lambda body: body["chunks"]["delay"].update({"c.9.0": [3, "00"]}), "not that of a store of captures"),
        (lambda body: body["chunks"]["delay"].update({"../../x": [3, "00"]}), "not that of a store of captures"),
        (lambda body: body["chunks"]["delay"].pop("c.1.0"), "disagree"),
        (lambda body: body["chunks"].pop("delay"), "disagree"),
        (lambda body: body.update(count=4), "disagree"),
    ],
)
def test_a_manifest_that_lies_is_refused(store: Path, change: Callable[[dict[str, Any]], None], message: str) -> None:
    forge(store, change)
    with pytest.raises(InputError, match=message):
        open_captures(store)


def test_repair_keeps_the_sound_captures(store: Path) -> None:
    flip(store / "counts" / "c.1.0.0.0", 77)
    recovery = repair(store)
    assert (recovery.kept, recovery.dropped) == (2, (1,))
    assert verify(store) == [] and [c.attrs["seed"] for c in open_captures(store)] == [0, 2]
    again = repair(store)
    assert (again.kept, again.dropped) == (2, ())
    assert sorted(os.listdir(store.parent)) == ["store", "store.dropped"]


def test_repair_does_not_cost_an_unfinished_neighbour(store: Path) -> None:
    flip(store / "counts" / "c.1.0.0.0", 77)
    neighbour = store.with_name("store.partial")
    with pytest.raises(RuntimeError), CaptureWriter(store.with_name("other")) as writer:
        writer.append(example_capture("gated", seed=7))
        raise RuntimeError
    os.rename(store.with_name("other.partial"), neighbour)
    with pytest.raises(InputError, match="An unfinished store is beside"):
        repair(store)
    assert neighbour.exists() and len(open_captures(store)) == 3


def test_a_repair_that_was_killed_is_begun_again(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its own unfinished store was in the way of every further repair."""
    from beambench.captures.store import writer

    flip(store / "counts" / "c.1.0.0.0", 77)
    for failing in ("append_line", "mark_journal", "write_file", "publish"):

        def stop(*given: object, **more: object) -> None:
            raise SystemError("killed")

        with monkeypatch.context() as patch, pytest.raises(SystemError):
            patch.setattr(writer, failing, stop)
            patch.setattr(CaptureWriter, "abandon", CaptureWriter._release)  # a kill cleans nothing up
            repair(store)
        assert store.with_name("store.partial").is_dir() and len(open_captures(store)) == 3
    assert repair(store).dropped == (1,) and verify(store) == []
    assert sorted(os.listdir(store.parent)) == ["store", "store.dropped"]


def test_repair_that_leaves_no_capture_is_refused(store: Path) -> None:
    for index in range(3):
        flip(store / "counts" / f"c.{index}.0.0.0", 77)
    with pytest.raises(InputError, match="No capture is intact"):
        repair(store)


def test_repair_refuses_what_it_cannot_trust(store: Path) -> None:
    flip(store / "zarr.json", 999)
    flip(store / "record.jsonl", 999)
    with pytest.raises(InputError, match="The metadata are damaged"):
        repair(store)
    with pytest.raises(InputError, match="already complete"):
        finalize(store)


# ---------------------------------------------------------------- the second manifest

METADATA = ["manifest.json", "manifest.sha256", "record.jsonl", "zarr.json", "counts/zarr.json", "delay/zarr.json"]


def tree(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in files_of(folder)}


@pytest.mark.parametrize("name", METADATA)
@pytest.mark.parametrize("how", ["flipped", "emptied", "missing"])
def test_damaged_metadata_are_written_again_bit_by_bit(store: Path, name: str, how: str) -> None:
    """One flipped bit of metadata made `repair` refuse a store whose chunks were all sound."""
    before = tree(store)
    file = store / name
    if how == "flipped":
        flip(file, 8 * (file.stat().st_size // 2) + 1)
    else:
        file.unlink()
        if how == "emptied":
            file.touch()
    assert name in [damage.file for damage in verify(store)]
    recovery = repair(store)
    assert recovery.restored == (name,) and recovery.kept == 3 and not recovery.dropped and recovery.aside is None
    assert tree(store) == before and verify(store) == []


def test_all_first_metadata_may_be_lost_and_captures_damaged_too(store: Path) -> None:
    before = tree(store)
    for file in (*store.rglob("zarr.json"), store / "manifest.json", store / "manifest.sha256"):
        file.unlink()
    flip(store / "counts" / "c.1.0.0.0", 77)
    recovery = repair(store)
    assert recovery.dropped == (1,) and len(recovery.restored) > 10 and verify(store) == []
    assert [capture.attrs["seed"] for capture in open_captures(store)] == [0, 2]
    assert {name: content for name, content in before.items() if "c.0." in name}.items() <= tree(store).items()


def test_a_second_manifest_of_fewer_captures_is_not_taken(store: Path) -> None:
    lines = (store / "record.jsonl").read_bytes().splitlines(keepends=True)
    (store / "record.jsonl").write_bytes(b"".join(lines[:-1]))
    (store / "manifest.sha256").unlink()
    for look in (open_captures, verify, repair):
        with pytest.raises(InputError, match="manifest"):
            look(store)


def crc32c(content: bytes) -> bytes:
    import google_crc32c

    return int(google_crc32c.value(content)).to_bytes(4, "little")


def test_a_chunk_with_a_forged_checksum_is_detected(store: Path) -> None:
    """Another chunk, whose CRC-32C was made equal to the one in the manifest of version 1 by four bytes that nothing reads."""
    file = store / "truth_range" / "c.0.0.0"
    content = bytearray(file.read_bytes())
    content[20] ^= 1
    content[-4:] = crc32c(bytes(content[:-4]))
    file.write_bytes(content)
    assert [damage.problem for damage in verify(store)] == ["sha256 does not match"]
    with pytest.raises(InputError, match="sha256"):
        open_captures(store)[0]
    assert repair(store).dropped == (0,)


@pytest.mark.parametrize("what", ["notes.txt", "folder/", "link", "delay"])
def test_verify_sees_what_is_not_of_the_store(store: Path, what: str) -> None:
    if what == "delay":  # the same files by another way: they may change without the store
        shutil.move(store / "delay", store.parent / "outside")
        (store / "delay").symlink_to(store.parent / "outside")
    elif what == "link":
        (store / "link").symlink_to(store.parent)
    elif what.endswith("/"):
        (store / what).mkdir()
    else:
        (store / what).write_text("mine")
    (damage,) = verify(store)
    assert damage.file == what.strip("/")
    before = sorted(store.parent.rglob("*"))
    with pytest.raises(InputError, match=r"not its own|link"):
        repair(store)
    assert sorted(store.parent.rglob("*")) == before


def version_1(store: Path) -> None:
    """Make the store one of version 1: chunks with their CRC-32C, and no second manifest."""

    def older(body: dict[str, Any]) -> None:
        del body["record"]
        body["store_version"] = 1
        for array, marks in body["chunks"].items():
            for key, mark in marks.items():
                mark[1] = (store / array / key).read_bytes()[-4:].hex()

    forge(store, older)
    (store / "record.jsonl").unlink()


def test_a_store_of_version_1_is_read_verified_and_repaired(store: Path) -> None:
    version_1(store)
    assert len(open_captures(store)) == 3 and verify(store) == [] and repair(store).damage == ()
    before = tree(store)
    (store / "counts" / "zarr.json").write_bytes(b"{}")
    assert repair(store).restored == ("counts/zarr.json",) and tree(store) == before
    flip(store / "counts" / "c.1.0.0.0", 77)
    assert repair(store).dropped == (1,) and verify(store) == []
    assert (store / "record.jsonl").is_file(), "what is written is of version 2"
    version_1(store)
    flip(store / "zarr.json", 999)
    with pytest.raises(InputError, match="generate it anew"):
        repair(store)
