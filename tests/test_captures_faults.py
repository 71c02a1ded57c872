"""Whatever breaks a store is told: flipped bits, lost files, full disks, refused folders, killed writers."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.captures import CaptureWriter, finalize, open_captures, repair, verify, write
from beambench.captures.example import example_capture
from beambench.captures.manifest import load_manifest
from beambench.captures.verification import chunk_problem
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
        read_too = turn % 4 == 0 or turn >= len(files)
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
    assert first.stat().st_size == second.stat().st_size  # so that only its mark tells
    first.write_bytes(second.read_bytes())
    open_captures(store)
    assert detected_by_verify(store) and detected_on_reading(store)


def test_a_chunk_lost_after_opening_is_not_read_as_zeros(store: Path) -> None:
    opened = open_captures(store)
    (store / "counts" / "c.1.0.0.0").unlink()
    opened[0]
    with pytest.raises(InputError, match="a chunk is damaged"):
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
        (lambda body: body.pop("chunks"), "not one of captures"),
        (lambda body: body.update(chunks=[1]), "not one of captures"),
        (lambda body: body["chunks"]["delay"].update({"c.9.0": [3, "00"]}), "not one of captures"),
        (lambda body: body["chunks"]["delay"].update({"../../x": [3, "00"]}), "not one of captures"),
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
    assert os.listdir(store.parent) == ["store"]


def test_repair_does_not_cost_an_unfinished_neighbour(store: Path) -> None:
    flip(store / "counts" / "c.1.0.0.0", 77)
    neighbour = store.with_name("store.partial")
    neighbour.mkdir()
    with pytest.raises(InputError, match="unfinished store is beside"):
        repair(store)
    assert neighbour.exists() and len(open_captures(store)) == 3


def test_repair_that_leaves_no_capture_is_refused(store: Path) -> None:
    for index in range(3):
        flip(store / "counts" / f"c.{index}.0.0.0", 77)
    with pytest.raises(InputError, match="no capture is sound"):
        repair(store)


def test_repair_refuses_what_it_cannot_trust(store: Path) -> None:
    flip(store / "zarr.json", 999)
    with pytest.raises(InputError, match="metadata are damaged"):
        repair(store)
    with pytest.raises(InputError, match="complete already"):
        finalize(store)


# ---------------------------------------------------------------- interrupted writers

LONG_WRITE = """
import sys, time
from beambench.captures import write
from beambench.captures.example import example_capture
def captures():
    for seed in range(10**6):
        yield example_capture("gated", seed=seed)
write(sys.argv[1], captures())
"""


def killed_writer(path: Path, at_least: int) -> None:
    process = subprocess.Popen([sys.executable, "-c", LONG_WRITE, str(path)])
    journal = path.with_name(path.name + ".partial") / "journal.jsonl"
    deadline = time.monotonic() + 60
    try:
        while not (journal.exists() and journal.read_bytes().count(b"\n") > at_least):
            assert time.monotonic() < deadline and process.poll() is None
            time.sleep(0.01)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()


def test_a_killed_writer_leaves_a_partial_that_finalize_completes(tmp_path: Path) -> None:
    path = tmp_path / "store"
    killed_writer(path, 5)
    assert os.listdir(tmp_path) == ["store.partial"]
    with pytest.raises(InputError, match="no such store") as caught:
        open_captures(path)
    assert "finalize" in str(caught.value)
    with (path.with_name("store.partial") / "journal.jsonl").open("ab") as file:
        file.write(b"0123 a torn li")
    recovery = finalize(path)
    opened = open_captures(path)
    assert recovery.kept == len(opened) >= 5 and verify(path) == []
    for seed, capture in enumerate(opened):
        assert capture.identical(example_capture("gated", seed=seed))
    assert os.listdir(tmp_path) == ["store"] and not (path / "journal.jsonl").exists()


def test_resume_continues_after_a_kill(tmp_path: Path) -> None:
    path = tmp_path / "store"
    killed_writer(path, 3)
    with CaptureWriter(path, resume=True) as writer:
        start = writer.count
        assert start >= 3
        for seed in range(start, start + 2):
            writer.append(example_capture("gated", seed=seed))
    assert [c.attrs["seed"] for c in open_captures(path)] == list(range(start + 2)) and verify(path) == []


@pytest.mark.parametrize("state", ["absent", "empty", "torn header"])
def test_resume_begins_where_nothing_is_complete(tmp_path: Path, state: str) -> None:
    partial = tmp_path / "store.partial"
    if state != "absent":
        partial.mkdir()
        (partial / "journal.jsonl").write_text("" if state == "empty" else "0123 {")
    write(tmp_path / "store", example_capture("amcw"), resume=True)
    assert len(open_captures(tmp_path / "store")) == 1 and os.listdir(tmp_path) == ["store"]


def unfinished(path: Path, count: int) -> Path:
    def captures() -> Iterator[object]:
        for seed in range(count):
            yield example_capture("amcw", seed=seed)
        raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        write(path, captures())  # type: ignore[arg-type]
    return path.with_name(path.name + ".partial")


def test_finalize_is_possible_after_a_crash_while_publishing(tmp_path: Path) -> None:
    # Metadata already have their final form, or are cut short: they follow from the journal, and are written again.
    partial = unfinished(tmp_path / "store", 3)
    body = json.loads((partial / "samples" / "zarr.json").read_text())
    body["shape"][0] = 3
    (partial / "samples" / "zarr.json").write_text(json.dumps(body))
    (partial / "truth_range" / "zarr.json").write_text("{")
    (partial / "manifest.json").write_text("{}")
    assert finalize(partial).kept == 3
    assert verify(tmp_path / "store") == [] and len(list(open_captures(tmp_path / "store"))) == 3


def test_a_damaged_partial_is_refused_by_finalize_and_kept_by_repair(tmp_path: Path) -> None:
    partial = unfinished(tmp_path / "store", 4)
    flip(partial / "samples" / "c.2.0.0.0", 50)
    with pytest.raises(InputError, match="unfinished store is damaged"):
        finalize(partial)
    recovery = repair(partial)
    assert (recovery.kept, recovery.dropped) == (3, (2,))
    assert [c.attrs["seed"] for c in open_captures(tmp_path / "store")] == [0, 1, 3]
    assert os.listdir(tmp_path) == ["store"]


def test_finalize_where_nothing_is_unfinished(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing unfinished"):
        finalize(tmp_path / "x")
    unfinished(tmp_path / "y", 1)
    write(tmp_path / "z", example_capture("amcw"))
    (tmp_path / "y.partial").rename(tmp_path / "z.partial")
    with pytest.raises(InputError, match="the output exists"):
        finalize(tmp_path / "z")
    assert finalize(tmp_path / "z", overwrite=True).kept == 1


# ---------------------------------------------------------------- disks and permissions


@contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path]:
    folder.mkdir()
    mount = shutil.which("mount")
    if mount is None or os.geteuid() != 0:
        pytest.skip("mounting a small file system needs root")
    made = subprocess.run([mount, "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)], capture_output=True)
    if made.returncode:
        pytest.skip(f"mounting a small file system is not permitted: {made.stderr.decode().strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk_leaves_nothing_under_the_final_name(tmp_path: Path) -> None:
    large = example_capture("gated", sizes={"slice": 40, "row": 256, "col": 256}, optional=False)
    with small_disk(tmp_path / "disk", "1m") as disk:
        with pytest.raises(InputError, match="No space left") as caught:
            write(disk / "store", large)
        assert "free space" in str(caught.value)
        assert os.listdir(disk) == []


def test_a_disk_that_fills_keeps_the_complete_captures(tmp_path: Path) -> None:
    def captures() -> Iterator[object]:
        for seed in range(1000):
            yield example_capture("gated", seed=seed, sizes={"row": 64, "col": 64}, optional=False)

    with small_disk(tmp_path / "disk", "2m") as disk:
        with pytest.raises(InputError, match="No space left") as caught:
            write(disk / "store", captures())  # type: ignore[arg-type]
        assert "finalize" in str(caught.value) and os.listdir(disk) == ["store.partial"]
        subprocess.run(["mount", "-o", "remount,size=8m", str(disk)], check=True)
        recovery = finalize(disk / "store")
        assert recovery.kept >= 1 and verify(disk / "store") == []


def test_an_output_below_a_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="creating the store failed"):
        write(tmp_path / "file" / "store", example_capture("amcw"))


UNPRIVILEGED = """
import sys
from beambench.captures import open_captures, write
from beambench.captures.example import example_capture
from beambench.captures.manifest import load_manifest
from beambench.captures.verification import chunk_problem
from beambench.scenes.errors import InputError
try:
    write(sys.argv[1], example_capture("amcw"))
except InputError as error:
    print(error)
else:
    sys.exit("written")
"""


def test_a_folder_that_may_not_be_written(tmp_path: Path) -> None:
    setpriv = shutil.which("setpriv")
    if setpriv is None or os.geteuid() != 0:
        pytest.skip("taking another user's identity needs setpriv and root")
    command = [setpriv, "--reuid=65534", "--clear-groups", sys.executable, "-c"]
    usable = subprocess.run([*command, "import beambench.captures.writer, zarr"], capture_output=True, cwd="/")
    if usable.returncode:
        pytest.skip("another user may not read this installation")
    with_rights = Path("/tmp") / f"beambench-refused-{os.getpid()}"
    with_rights.mkdir(mode=0o755)
    try:
        done = subprocess.run(
            [*command, UNPRIVILEGED, str(with_rights / "store")], capture_output=True, text=True, cwd="/"
        )
        assert done.returncode == 0, done.stderr
        assert "Permission denied" in done.stdout and "choose another --out" in done.stdout
        assert os.listdir(with_rights) == []
    finally:
        shutil.rmtree(with_rights)
