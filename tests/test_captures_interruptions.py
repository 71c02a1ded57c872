"""Interrupted writers, full disks and refused folders leave nothing half-written under a final name."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from beambench.captures import CaptureWriter, finalize, open_captures, repair, verify, write
from beambench.captures.example import example_capture
from beambench.captures.store.journal import MARK_LINE
from beambench.scenes.errors import InputError


def flip(file: Path, bit: int) -> None:
    content = bytearray(file.read_bytes())
    content[bit // 8] ^= 1 << bit % 8
    file.write_bytes(bytes(content))


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
        while not (journal.exists() and journal.read_bytes().count(b"\n") > at_least + 1):
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


@pytest.mark.parametrize("state", ["absent", "empty", "torn mark", "mark only"])
def test_resume_begins_where_nothing_is_complete(tmp_path: Path, state: str) -> None:
    partial = tmp_path / "store.partial"
    if state != "absent":
        partial.mkdir()
        length = {"empty": 0, "torn mark": 40, "mark only": len(MARK_LINE)}[state]
        (partial / "journal.jsonl").write_bytes(MARK_LINE[:length])
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
    assert sorted(os.listdir(tmp_path)) == ["store", "store.dropped"]


def test_finalize_where_nothing_is_unfinished(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="There is no unfinished store"):
        finalize(tmp_path / "x")
    unfinished(tmp_path / "y", 1)
    write(tmp_path / "z", example_capture("amcw"))
    (tmp_path / "y.partial").rename(tmp_path / "z.partial")
    with pytest.raises(InputError, match="The output exists"):
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
    with pytest.raises(InputError, match="Creating the store failed"):
        write(tmp_path / "file" / "store", example_capture("amcw"))


UNPRIVILEGED = """
import sys
from beambench.captures import open_captures, write
from beambench.captures.example import example_capture
from beambench.captures.store.manifest import load_manifest
from beambench.captures.store.verification import chunk_problem
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
    usable = subprocess.run([*command, "import beambench.captures.store.writer, zarr"], capture_output=True, cwd="/")
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
