"""A run that is killed leaves nothing behind for good, one that is ended leaves nothing at all, and no reader stops a command."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from beambench.benchmarks.runner.scratch import LOCK, scratch_folder, sweep
from beambench.captures import open_captures

BEAMBENCH = [sys.executable, "-m", "beambench"]
HELD = """
import sys, time
from beambench.benchmarks.runner.scratch import scratch_folder
with scratch_folder("run") as folder:
    (folder / "truth.npz").write_bytes(b"0" * 1000)
    print(folder, flush=True)
    time.sleep(600)
"""


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    return folder


def test_what_a_killed_owner_left_is_removed_by_the_next(temporary: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", HELD], stdout=subprocess.PIPE, text=True) as owner:
        assert owner.stdout is not None
        held = Path(owner.stdout.readline().strip())
        assert sweep() == [] and (held / "truth.npz").is_file(), "its owner lives"
        owner.send_signal(signal.SIGKILL)
        owner.wait()
    assert held.is_dir()
    with scratch_folder("truth") as folder:
        assert sorted(temporary.iterdir()) == [folder]
    assert list(temporary.iterdir()) == []


def test_a_kill_as_a_folder_was_made_leaves_it_for_an_hour(temporary: Path) -> None:
    """Between mkdir and the lock it is empty; between the lock and its name it holds the file under another one."""
    empty, young, unnamed, full = (temporary / f"beambench-run-{letter * 8}" for letter in "abcd")
    for folder in (empty, young, unnamed, full):
        folder.mkdir()
    (unnamed / f"{LOCK}.new").touch()
    (full / "thesis.tex").write_text("dear to somebody")
    for folder in (empty, full):
        os.utime(folder, (time.time() - 4000,) * 2)
    assert sorted(sweep()) == [empty, unnamed]
    assert sorted(temporary.iterdir()) == [young, full] and (full / "thesis.tex").is_file()


def test_a_kill_as_a_folder_is_removed_leaves_it_to_the_next(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its file goes last."""
    folder = temporary / "beambench-run-aaaaaaaa"
    folder.mkdir()
    for name in ("a", LOCK, "z"):
        (folder / name).touch()
    real, left = os.unlink, []

    def killed(path: Any, **named: Any) -> None:
        real(path, **named)
        left.append(sorted(os.listdir(folder)))

    monkeypatch.setattr(os, "unlink", killed)
    assert sweep() == [folder] and not folder.exists()
    assert len(left) == 3 and all(LOCK in names for names in left[:2]) and left[2] == []


@pytest.mark.parametrize("call", ["mkdir", "rmdir"])
def test_a_signal_as_the_folder_is_made_or_removed_leaves_nothing(
    call: str, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder that is left without its lock would stay for good: one of 30 runs ended by SIGTERM left one."""
    real, hit = getattr(os, call), []

    def interrupted(path: Any, *more: Any, **named: Any) -> None:
        if hit:
            real(path, *more, **named)
            return
        hit.append(path)
        if call == "mkdir":
            real(path, *more, **named)
        raise KeyboardInterrupt

    monkeypatch.setattr(os, call, interrupted)
    with pytest.raises(KeyboardInterrupt), scratch_folder("run"):
        pass
    assert hit and list(temporary.iterdir()) == []


def test_folders_of_others_are_not_swept(temporary: Path, tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / LOCK).touch()
    (temporary / "beambench-run-aaaaaaaa").symlink_to(victim, target_is_directory=True)
    for name in ("beambench-run-bbbbbbbb", "beambench-runs", "beambench-run-cccccccc-mine"):
        (temporary / name).mkdir()
        (temporary / name / "thesis.tex").write_text("dear to somebody")
    (temporary / "beambench-runs" / LOCK).touch()
    (temporary / "beambench-run-bbbbbbbb" / LOCK).symlink_to(victim / LOCK)
    before = sorted(temporary.rglob("*"))
    assert sweep() == [] and sorted(temporary.rglob("*")) == before and (victim / LOCK).is_file()


@pytest.mark.parametrize("sign", [signal.SIGTERM, signal.SIGHUP])
def test_a_run_that_is_ended_removes_its_temporary_files(sign: signal.Signals, temporary: Path, tmp_path: Path) -> None:
    command = [*BEAMBENCH, "run", "quickstart", "-o", str(tmp_path / "out"), "--no-report"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as run:
        deadline = time.monotonic() + 120
        while not any(temporary.glob("beambench-truth-*")):
            assert time.monotonic() < deadline and run.poll() is None
            time.sleep(0.05)
        run.send_signal(sign)
        _, said = run.communicate(timeout=120)
    assert run.returncode == 130 and "interrupted" in said
    assert not list(temporary.glob("beambench-*"))


@pytest.mark.parametrize("streams", ["2>&1 | true", "2>&1 | head -1", "| true"])
def test_a_reader_that_leaves_does_not_stop_the_work(streams: str, tmp_path: Path) -> None:
    store = tmp_path / "s.zarr"
    command = f'set -o pipefail; "{sys.executable}" -m beambench generate flat-wall --seeds 1 --seeds 2 -o "{store}" {streams}'
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert len(open_captures(store)) == 2


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_output_that_cannot_be_written_ends_clearly(tmp_path: Path) -> None:
    command = f'"{sys.executable}" -m beambench scenes > /dev/full'
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2 and "No space left" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_errors_that_cannot_be_told_keep_their_exit_code() -> None:
    command = f'"{sys.executable}" -m beambench data status no-such-store 2> /dev/full'
    assert subprocess.run(["bash", "-c", command], capture_output=True, timeout=120, check=False).returncode == 2
