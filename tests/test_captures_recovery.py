"""A repair removes damaged captures, never unreadable ones, and keeps the removed files."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from beambench import cli
from beambench.captures import CaptureWriter, finalize, open_captures, repair, verify, write
from beambench.captures.example import example_capture
from beambench.captures.store import verification
from beambench.captures.store.journal import write_file
from beambench.scenes.errors import InputError

CHUNK = "counts/c.1.0.0.0"


@pytest.fixture
def store(tmp_path: Path) -> Path:
    return write(tmp_path / "store", [example_capture("gated", seed=seed) for seed in range(3)])


def refuse(monkeypatch: pytest.MonkeyPatch, errno_: int) -> None:
    """Make reading of one chunk fail, as for a user without the right to (root may read everything)."""
    read = Path.read_bytes

    def refused(self: Path) -> bytes:
        if str(self).endswith(CHUNK):
            raise OSError(errno_, os.strerror(errno_), str(self))
        return read(self)

    monkeypatch.setattr(Path, "read_bytes", refused)


@pytest.mark.parametrize("name", ["EACCES", "EMFILE", "ESTALE", "ENOMEM"])
def test_what_cannot_be_read_is_not_dropped(
    store: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    import errno

    with monkeypatch.context() as patch:
        refuse(patch, getattr(errno, name))
        (damage,) = verify(store)
        assert damage.unreadable and damage.file == CHUNK
        assert cli.main(["data", "verify", str(store)]) == 1
        told = capsys.readouterr().out
        assert "cannot be read" in told and "repair" not in told
        assert cli.main(["data", "repair", str(store)]) == 2
        assert "get permission to read it" in capsys.readouterr().err
    assert verify(store) == [] and os.listdir(store.parent) == ["store"]


def test_content_that_the_disk_lost_is_damage(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import errno

    refuse(monkeypatch, errno.EIO)
    (damage,) = verify(store)
    assert not damage.unreadable and damage.capture == 1
    assert repair(store).dropped == (1,)


def test_an_unfinished_store_that_cannot_be_read_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import errno

    def captures():  # type: ignore[no-untyped-def]
        yield from (example_capture("gated", seed=seed) for seed in range(3))
        raise RuntimeError

    with pytest.raises(RuntimeError):
        write(tmp_path / "store", captures())
    with monkeypatch.context() as patch:
        refuse(patch, errno.EACCES)
        for recover in (finalize, repair):
            with pytest.raises(InputError, match="cannot be read"):
                recover(tmp_path / "store.partial")
    assert finalize(tmp_path / "store").kept == 3


def test_a_store_that_is_being_written_is_left_alone(tmp_path: Path) -> None:
    """Locks belong to an open file, so that a second writer of this process stands for one of another."""
    path = tmp_path / "store"
    with CaptureWriter(path) as writer:
        writer.append(example_capture("gated", seed=0))
        for other in (
            lambda: CaptureWriter(path, resume=True),
            lambda: CaptureWriter(path, overwrite=True),
            lambda: finalize(path),
            lambda: repair(path.with_name("store.partial")),
        ):
            with pytest.raises(InputError, match="Another process is writing"):
                other()
        writer.append(example_capture("gated", seed=1))
    assert [capture.attrs["seed"] for capture in open_captures(path)] == [0, 1] and verify(path) == []


def test_what_is_dropped_is_kept_aside(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for round_, index in enumerate((1, 0)):
        chunk = store / "counts" / f"c.{index}.0.0.0"
        content = bytearray(chunk.read_bytes())
        content[10] ^= 1
        chunk.write_bytes(content)
        others = (store / "truth_range" / f"c.{index}.0.0").read_bytes()
        recovery = repair(store)
        aside = store.with_name("store.dropped" + ("" if round_ == 0 else "-2"))
        assert recovery.aside == aside and recovery.dropped == (index,)
        # The damaged chunk, and all else of its capture; nothing of those that the store holds.
        assert (aside / "counts" / f"c.{index}.0.0.0").read_bytes() == bytes(content)
        assert (aside / "truth_range" / f"c.{index}.0.0").read_bytes() == others
        chunks = [file.name for file in aside.rglob("c.*")]
        assert chunks and all(name.startswith(f"c.{index}.") for name in chunks)
    assert [capture.attrs["seed"] for capture in open_captures(store)] == [2] and verify(store) == []
    assert repair(store).aside is None


def test_a_chunk_that_the_manifest_does_not_know_is_kept_aside(store: Path) -> None:
    (store / "counts" / "c.7.0.0.0").write_bytes(b"mine")
    recovery = repair(store)
    assert recovery.kept == 3 and recovery.aside is not None
    assert (recovery.aside / "counts" / "c.7.0.0.0").read_bytes() == b"mine" and verify(store) == []


def test_damaged_metadata_are_sent_to_repair_where_there_is_a_second_manifest(
    store: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = store / "counts" / "zarr.json"
    file.write_bytes(file.read_bytes() + b" ")
    for second in (True, False):
        if not second:
            (store / "record.jsonl").unlink()
        assert cli.main(["data", "verify", str(store)]) == 1
        told = capsys.readouterr().out
        with pytest.raises(InputError) as caught:
            open_captures(store)
        for text in (told, str(caught.value)):
            assert ("data repair" in text) == second and ("generate it anew" in text) != second
    assert cli.main(["data", "repair", str(store)]) == 0 and "written again" in capsys.readouterr().out


def test_reading_tells_a_missing_right_from_damage(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import errno

    from beambench.captures.store import reader

    captures = open_captures(store)

    def refused(path: Path) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))

    with monkeypatch.context() as patch:
        patch.setattr(verification, "regular_size", refused)
        with pytest.raises(InputError, match="cannot be read") as caught:
            captures.load(0)
    assert "data repair" not in str(caught.value) and "Permission denied" in str(caught.value)
    monkeypatch.setattr(reader, "regular_size", refused)
    with pytest.raises(InputError, match="cannot be read"):
        open_captures(store)


def test_no_advice_names_a_verb_that_is_not_there(store: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    for wrong in ("file", "folder"):
        with pytest.raises(InputError) as caught:
            open_captures(tmp_path / wrong)
        assert "import" not in str(caught.value)
    assert verification.chunk_problem(tmp_path / "none", (1, "00")) == "missing"


def test_a_stop_between_the_writing_and_the_naming_of_metadata_is_in_no_repairs_way(store: Path) -> None:
    """A killed repair left zarr.json.new, and every later one refused the store for a file that was not its own."""
    for name in ("zarr.json", "counts/zarr.json"):
        (store / name).write_bytes(b"{}")
        (store / f"{name}.new").write_bytes(b'{"half')
    (store / "mine.new").write_bytes(b"mine")
    with pytest.raises(InputError, match=r"mine\.new"):
        repair(store)
    (store / "mine.new").unlink()
    assert set(repair(store).restored) >= {"zarr.json", "counts/zarr.json"}
    assert verify(store) == []


def test_metadata_that_cannot_be_written_leave_no_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_file(tmp_path / "zarr.json", b"{}")
    assert not list(tmp_path.iterdir())


def test_what_is_no_store_is_not_called_complete(tmp_path: Path) -> None:
    """A folder of others with a manifest.json was called "already complete"."""
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    (theirs / "manifest.json").write_text("{}")
    with pytest.raises(InputError, match="no unfinished store"):
        finalize(theirs)


def test_a_linked_folder_is_named_by_repair(tmp_path: Path) -> None:
    """The advice was of an output that is "not overwritten"; nothing outside is touched."""
    write(tmp_path / "a.zarr", [example_capture("gated", seed=0)])
    os.rename(tmp_path / "a.zarr" / "counts", tmp_path / "counts")
    os.symlink(tmp_path / "counts", tmp_path / "a.zarr" / "counts")
    before = sorted((path.name, path.read_bytes()) for path in (tmp_path / "counts").iterdir())
    with pytest.raises(InputError, match="not its own: counts"):
        repair(tmp_path / "a.zarr")
    assert sorted((path.name, path.read_bytes()) for path in (tmp_path / "counts").iterdir()) == before
