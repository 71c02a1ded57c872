"""Exports that fail or are stopped: nothing half written under the final name, what is complete is kept and continued."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

import beambench
from beambench import cli
from beambench.captures import write
from beambench.captures.exports.place import EXPORT, JOURNAL
from beambench.captures.store.publish import partial_of
from beambench.scenes.errors import InputError

from ._exports import capture_of, data_set
from .test_captures_interruptions import small_disk

MODALITY = "amcw"


@pytest.fixture
def small(tmp_path: Path) -> Path:
    return data_set(tmp_path / "small", (MODALITY,))


def files(out: Path) -> dict[str, bytes]:
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()}


def shard_of(store: Path, name: str, number: int) -> Path:
    return next(path for path in (store / MODALITY / name).iterdir() if path.name.startswith(f"c.{number}."))


def test_a_damaged_shard_is_told_and_what_is_complete_is_continued(small: Path, tmp_path: Path) -> None:
    out, whole = tmp_path / "out", beambench.export(small, to="webdataset", out=tmp_path / "whole", per_file=1)
    shard = shard_of(small, "samples", 1)
    sound = shard.read_bytes()
    shard.write_bytes(sound[:10] + bytes([sound[10] ^ 1]) + sound[11:])
    with pytest.raises(InputError, match=r"damaged.*sha256") as caught:
        beambench.export(small, to="webdataset", out=out, per_file=1)
    assert "amcw/samples" in str(caught.value) and "data verify" in str(caught.value)
    assert not out.exists() and partial_of(out).is_dir() and "--resume" in caught.value.__notes__[0]
    kept = {name: content for name, content in files(partial_of(out)).items() if name.endswith(".tar")}
    assert 0 < len(kept) < 5 and kept.items() <= files(whole).items()
    times = {name: (partial_of(out) / name).stat().st_mtime_ns for name in kept}
    shard.write_bytes(sound)
    with pytest.raises(InputError, match="unfinished export is in the way"):
        beambench.export(small, to="webdataset", out=out, per_file=1)
    with pytest.raises(InputError, match="with other options"):
        beambench.export(small, to="webdataset", out=out, per_file=2, resume=True)
    beambench.export(small, to="webdataset", out=out, per_file=1, resume=True)
    assert files(out) == files(whole) and not partial_of(out).exists()
    assert times == {name: (out / name).stat().st_mtime_ns for name in kept}  # they were not written again


def test_a_kept_file_that_was_changed_is_written_again(small: Path, tmp_path: Path) -> None:
    out, whole = tmp_path / "out", beambench.export(small, to="webdataset", out=tmp_path / "whole", per_file=1)
    shutil.copytree(whole, partial_of(out))
    journal = stopped(small, out)
    name = next(iter(json.loads(journal[1].partition(" ")[2])["files"]))
    content = (partial_of(out) / name).read_bytes()
    (partial_of(out) / name).write_bytes(content[:-1] + b"x")
    beambench.export(small, to="webdataset", out=out, per_file=1, resume=True)
    assert files(out) == files(whole)


def stopped(store: Path, out: Path) -> list[str]:
    """An export that a damaged shard stopped, and that is sound again; its journal."""
    shutil.rmtree(partial_of(out), ignore_errors=True)
    shard = shard_of(store, "samples", 2)
    sound = shard.read_bytes()
    shard.write_bytes(sound[:10] + bytes([sound[10] ^ 1]) + sound[11:])
    with pytest.raises(InputError):
        beambench.export(store, to="webdataset", out=out, per_file=1)
    shard.write_bytes(sound)
    return (partial_of(out) / JOURNAL).read_text().splitlines()


def test_a_torn_journal_and_names_that_lead_out(small: Path, tmp_path: Path) -> None:
    from beambench.captures.store.journal import line_of

    out, whole = tmp_path / "out", beambench.export(small, to="webdataset", out=tmp_path / "whole", per_file=1)
    stopped(small, out)
    note = tmp_path / "note"
    note.write_text("mine")
    journal = partial_of(out) / JOURNAL
    evil = line_of({"files": {"../note": [4, "0" * 64]}, "count": 1, "facts": []})
    journal.write_bytes(journal.read_bytes() + evil + b"0123 {torn")
    beambench.export(small, to="webdataset", out=out, per_file=1, resume=True)
    assert files(out) == files(whole) and note.read_text() == "mine"
    manifest = json.loads((out / EXPORT).read_text())
    manifest["files"]["../note"] = [4, "0" * 64]
    (out / EXPORT).write_text(json.dumps(manifest))
    beambench.export(small, to="webdataset", out=out, per_file=2, overwrite=True)
    assert note.read_text() == "mine"


KILLED = """
import sys
from beambench import cli
sys.exit(cli.main(sys.argv[1:]))
"""


def test_a_killed_export_is_continued(small: Path, tmp_path: Path) -> None:
    out, whole = tmp_path / "out", beambench.export(small, to="exr", out=tmp_path / "whole")
    typed = [sys.executable, "-c", KILLED, "export", str(small), "--to", "exr", "-o", str(out)]
    process = subprocess.Popen(typed, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    while process.poll() is None and len(list(partial_of(out).rglob("*.exr"))) < 2:
        time.sleep(0.001)
    process.kill()
    process.wait()
    beambench.export(small, to="exr", out=out, resume=True)
    assert files(out) == files(whole)
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    beambench.export(small, to="exr", out=out, resume=True)  # a complete one is kept
    assert before == {path: path.stat().st_mtime_ns for path in out.rglob("*")}


def test_outputs_that_exist(small: Path, tmp_path: Path) -> None:
    out = beambench.export(small, to="webdataset", out=tmp_path / "out")
    with pytest.raises(InputError, match="output exists"):
        beambench.export(small, to="webdataset", out=out)
    with pytest.raises(InputError, match="with other options"):
        beambench.export(small, to="webdataset", out=out, truth=False, resume=True)
    beambench.export(small, to="exr", out=out, overwrite=True)
    assert not list(out.rglob("*.tar")) and len(list(out.rglob("*.exr"))) == 5
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "small"]
    (out / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="not its own"):
        beambench.export(small, to="webdataset", out=out, overwrite=True)
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "mine.txt").write_text("mine")
    for place in (tmp_path / "folder", tmp_path / "folder" / "mine.txt"):
        with pytest.raises(InputError, match="did not write the existing output"):
            beambench.export(small, to="webdataset", out=place, overwrite=True)
    for place in (small, small / "inside", tmp_path):
        for data in (small, small / MODALITY):
            with pytest.raises(InputError, match="overwrite an input"):
                beambench.export(data, to="webdataset", out=place, overwrite=True)
    assert (tmp_path / "folder" / "mine.txt").read_text() == "mine"


def test_a_replacement_that_was_stopped_is_finished(small: Path, tmp_path: Path) -> None:
    out = beambench.export(small, to="webdataset", out=tmp_path / "out")
    os.rename(out, tmp_path / "out.replaced")  # killed between the two renames
    with pytest.raises(InputError, match="output exists"):
        beambench.export(small, to="exr", out=out)
    assert (out / EXPORT).is_file() and not (tmp_path / "out.replaced").exists()


@pytest.mark.parametrize("to", ["webdataset", "netcdf", "exr", "tiff", "croissant"])
def test_a_full_disk_stops_cleanly_and_is_continued(tmp_path: Path, to: Any) -> None:
    from beambench.captures.example import example_capture

    if to == "netcdf":
        pytest.importorskip("h5netcdf", reason="needs the extra `netcdf`")
    sizes = {"slice": 6, "row": 40, "col": 40}
    store = write(tmp_path / "store", [example_capture("gated", seed=n, sizes=sizes, optional=False) for n in range(5)])
    several = {"per_file": 1} if to in ("webdataset", "netcdf", "croissant") else {}
    whole = beambench.export(store, to=to, out=tmp_path / "whole", **several)
    size = sum(path.stat().st_size for path in whole.rglob("*") if path.is_file())
    with small_disk(tmp_path / "disk", str(size // 2)) as disk:
        with pytest.raises(InputError, match=r"No space left|failed") as caught:
            beambench.export(store, to=to, out=disk / "out", **several)
        assert os.listdir(disk) == ["out.partial"] and "--resume continues" in caught.value.__notes__[0]
        kept = [path for path in (disk / "out.partial").rglob("gated-*") if path.is_file()]
        assert kept and not list(disk.rglob("unfinished.*"))
        subprocess.run(["mount", "-o", f"remount,size={4 * size + 2**20}", str(disk)], check=True)
        beambench.export(store, to=to, out=disk / "out", resume=True, **several)
        assert files(disk / "out") == files(whole)


def test_names_in_a_store_that_lead_elsewhere(tmp_path: Path) -> None:
    """A part of the split is a text in a receipt: it must not become a path."""
    from unittest.mock import patch

    with patch("tests._exports.PARTS", ("../../up",) * 5):
        store = data_set(tmp_path / "evil", (MODALITY,))
    with pytest.raises(InputError, match="cannot be that of a file") as caught:
        beambench.export(store, to="webdataset", out=tmp_path / "out")
    assert "../../up" in str(caught.value) and sorted(os.listdir(tmp_path)) == ["evil"]


def test_what_is_refused_before_any_work(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = write(tmp_path / "store", capture_of(MODALITY, 0))
    cases: list[tuple[list[str], str]] = [
        ([str(small), "--to", "webdataset", "--variables", "nothing"], "truth_electrons, truth_range"),
        ([str(small), "--to", "webdataset", "--part", "nothing"], "test, train, validation"),
        ([str(store), "--to", "webdataset", "--part", "train"], "Only a data set has parts"),
        ([str(small), "--to", "webdataset", "--no-truth", "--variables", "truth_range"], "is of the truth"),
        ([str(small), "--to", "exr", "--per-file", "3"], "holds one capture"),
        ([str(small), "--to", "webdataset", "--per-file", "0"], "at least one capture"),
        ([str(small), "--part", "train"], "holds all captures"),
        ([str(tmp_path / "none"), "--to", "exr"], "There is no such store"),
        ([str(small), "--to", "exr", "--resume", "--overwrite"], "exclude each other"),
    ]
    for typed, told in cases:
        assert cli.main(["export", *typed, "-o", str(tmp_path / "out")]) == 2
        assert told in capsys.readouterr().err, typed
    assert not (tmp_path / "out").exists() and not (tmp_path / "out.partial").exists()
    assert cli.main(["export", str(small), "--to", "nothing"]) == 2


def test_whole_numbers_that_a_format_cannot_hold(tmp_path: Path) -> None:
    import numpy as np

    capture = capture_of("gated", 0)
    capture["truth_material"] = capture["truth_material"].astype(np.int64) * 0 + 2**40
    store = write(tmp_path / "store", capture.assign_coords())
    for to, told in (("exr", "not exact"), ("tiff", "32 bits")):
        with pytest.raises(InputError, match=told):
            beambench.export(store, to=to, out=tmp_path / to)  # type: ignore[arg-type]
        assert not (tmp_path / to).exists() and not partial_of(tmp_path / to).exists()


def test_progress_tells_the_pace_and_no_time_of_its_own(small: Path, tmp_path: Path) -> None:
    steps: list[tuple[str, int, int, str]] = []
    beambench.export(
        small, to="webdataset", out=tmp_path / "out", per_file=1, progress=lambda *step: steps.append(step)
    )
    assert [step[:3] for step in steps] == [("export", n, 5) for n in range(1, 6)]
    # The time that is left is told once, by what shows the steps.
    assert all(step[3].endswith("captures/s") and "left" not in step[3] for step in steps)
