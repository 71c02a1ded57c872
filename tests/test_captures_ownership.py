"""Nothing but a store of our own is replaced or deleted, and no name in a store leads out of it.

Each test plants files beside or within a store and would see a single one that is lost or written.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from beambench.captures import CaptureWriter, open_captures, verify, write
from beambench.captures.example import example_capture
from beambench.captures.store.journal import JOURNAL
from beambench.captures.store.ownership import foreign_entries, is_ours, remove_store
from beambench.captures.store.recovery import finalize, repair
from beambench.scenes.errors import InputError


def _line(payload: object) -> bytes:
    text = json.dumps(payload).encode()
    return hashlib.sha256(text).hexdigest().encode() + b" " + text + b"\n"


def _files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def _is_whole(folder: Path) -> bool:
    try:
        return is_ours(folder) and not verify(folder)
    except InputError:
        return False


def _unfinished(folder: Path, change: Callable[[list[Any]], None] = lambda lines: None) -> Path:
    """An unfinished store of one capture, the lines of its journal changed."""
    writer = CaptureWriter(folder / "s")
    writer.append(example_capture("amcw"))
    writer._release()
    journal = writer.partial / JOURNAL
    lines = [json.loads(line.partition(b" ")[2]) for line in journal.read_bytes().splitlines()]
    change(lines)
    journal.write_bytes(b"".join(_line(line) for line in lines))
    return writer.partial


@pytest.mark.parametrize("name", ["../victim", "..", "/VICTIM", "a/../../victim", ".", "", "a\\..\\b", "~"])
@pytest.mark.parametrize("recover", [finalize, repair])
def test_an_array_of_a_journal_cannot_lead_out_of_the_store(
    name: str, recover: Callable[[Path], object], tmp_path: Path
) -> None:
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "c.0.0").write_bytes(b"dear to somebody")
    name = name.replace("VICTIM", str(victim).lstrip("/"))

    def rename(lines: list[Any]) -> None:
        lines[1]["structure"][name] = lines[1]["structure"].pop("samples")
        lines[2]["chunks"][name] = lines[2]["chunks"].pop("samples")

    partial = _unfinished(tmp_path, rename)
    before = _files(victim)
    with pytest.raises(InputError, match="leads out of the store"):
        recover(partial)
    assert _files(victim) == before and partial.is_dir() and not (tmp_path / "s").exists()


@pytest.mark.parametrize("key", ["../../victim/c.0.0", "c.0/../../../victim/c.0.0", "/etc/hostname", "c", "zarr.json"])
def test_a_chunk_of_a_journal_cannot_lead_out_of_the_store(key: str, tmp_path: Path) -> None:
    def rename(lines: list[Any]) -> None:
        marks = lines[2]["chunks"]["samples"]
        marks[key] = marks.pop(next(iter(marks)))

    partial = _unfinished(tmp_path, rename)
    for recover in (finalize, repair):
        with pytest.raises(InputError, match="leads out of the store"):
            recover(partial)


@pytest.mark.parametrize("payload", [[], {"modality": 1, "structure": {}}, {"modality": "amcw", "structure": {"a": {}}},
                                     {"modality": "amcw", "structure": {"a": {"dims": ["shot"], "shape": [10**15], "dtype": "int8",
                                                                              "coord": False, "attrs": {}}}}])  # fmt: skip
def test_a_journal_of_other_types_is_refused(payload: object, tmp_path: Path) -> None:
    partial = tmp_path / "s.partial"
    partial.mkdir()
    (partial / JOURNAL).write_bytes(_line(payload))
    with pytest.raises(InputError):
        finalize(partial)


def test_a_linked_folder_of_an_array_is_refused_and_its_files_stay(tmp_path: Path) -> None:
    partial = _unfinished(tmp_path)
    victim = tmp_path / "victim"
    (partial / "samples").rename(victim)
    (victim / "c.7.0.0").write_bytes(b"unlisted")
    (partial / "samples").symlink_to(victim, target_is_directory=True)
    before = _files(victim)
    for recover in (finalize, repair):
        with pytest.raises(InputError, match="a link"):
            recover(partial)
    assert _files(victim) == before


def test_unlisted_files_of_other_names_are_not_deleted(tmp_path: Path) -> None:
    partial = _unfinished(tmp_path)
    (partial / "samples" / "c.1.0.0").write_bytes(b"half a capture")
    (partial / "samples" / "notes.txt").write_bytes(b"dear to somebody")
    finalize(partial)
    kept = sorted(os.listdir(tmp_path / "s" / "samples"))
    assert "notes.txt" in kept and "c.1.0.0" not in kept


def test_a_new_file_is_not_written_through_a_planted_link(tmp_path: Path) -> None:
    partial = _unfinished(tmp_path)
    victim = tmp_path / "victim.txt"
    victim.write_text("dear to somebody")
    for name in ("zarr.json.new", "manifest.json.new", "samples/zarr.json.new"):
        (partial / name).symlink_to(victim)
    finalize(partial)
    assert victim.read_text() == "dear to somebody" and verify(tmp_path / "s") == []


@pytest.mark.parametrize("content", [
    {"manifest.json": b'{"name": "a web application", "icons": []}'}, {"manifest.json": b""}, {"manifest.json": b"[" * 60_000},
    {"journal.jsonl": b'{"event": "start"}\n'}, {"journal.jsonl": b""}, {"journal.jsonl": _line({"event": 1})},
])  # fmt: skip
@pytest.mark.parametrize("name", ["s", "s.partial"])
def test_a_foreign_folder_is_never_replaced(name: str, content: dict[str, bytes], tmp_path: Path) -> None:
    folder = tmp_path / name
    folder.mkdir()
    for file, data in content.items():
        (folder / file).write_bytes(data)
    (folder / "thesis.tex").write_text("dear to somebody")
    before = _files(folder)
    for options in ({"overwrite": True}, {"resume": True}, {"overwrite": True, "resume": True}):
        with pytest.raises(InputError):
            write(tmp_path / "s", example_capture("amcw"), **options)
        assert _files(folder) == before


def test_a_store_with_files_of_others_is_not_replaced(tmp_path: Path) -> None:
    path = write(tmp_path / "s", example_capture("amcw"))
    for name in ("README.md", "samples/notes.txt"):
        (path / name).write_text("dear to somebody")
        with pytest.raises(InputError, match="not its own"):
            write(path, example_capture("amcw", seed=2), overwrite=True)
        assert foreign_entries(path) == [name]
        with pytest.raises(InputError, match="not its own"):
            remove_store(path)
        (path / name).unlink()
    chunk = next(file for file in (path / "samples").iterdir() if file.name != "zarr.json")
    chunk.unlink()
    chunk.symlink_to(tmp_path / "elsewhere")
    assert foreign_entries(path) == [f"samples/{chunk.name}"]
    assert os.listdir(tmp_path) == ["s"]


def test_what_a_stop_before_the_mark_left_is_begun_again(tmp_path: Path) -> None:
    for leave in (lambda p: None, lambda p: (p / JOURNAL).touch()):
        partial = tmp_path / "s.partial"
        partial.mkdir()
        leave(partial)
        path = write(tmp_path / "s", example_capture("amcw"), resume=True, overwrite=True)
        assert len(open_captures(path)) == 1 and os.listdir(tmp_path) == ["s"]


def test_a_store_that_the_user_called_replaced_is_left_alone(tmp_path: Path) -> None:
    for name in ("a", "a.replaced", "b.replaced"):
        write(tmp_path / name, example_capture("amcw", seed=ord(name[0])))
    before = _files(tmp_path)
    for options in ({}, {"overwrite": True}):
        with pytest.raises(InputError, match=r"output exists|is taken"):
            write(tmp_path / "a", example_capture("amcw", seed=2), **options)
        assert {k: v for k, v in _files(tmp_path).items() if "partial" not in k} == before
    write(tmp_path / "b", example_capture("amcw", seed=2))
    assert len(open_captures(tmp_path / "b.replaced")) == 1 and len(open_captures(tmp_path / "b")) == 1


@pytest.mark.parametrize("stop", range(0, 60, 3))
def test_a_replacement_that_stops_anywhere_is_finished_or_undone(
    stop: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stop before the stop-th call that renames or removes; then the same command again."""
    old, new = example_capture("amcw", seed=1), example_capture("amcw", seed=2)
    path = write(tmp_path / "s", old)
    calls = {"left": stop, "stopped": False}

    class Killed(BaseException):
        pass

    def guarded(real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **options: Any) -> Any:
            if calls["stopped"] or calls["left"] == 0:
                calls["stopped"] = True
                raise Killed
            calls["left"] -= 1
            return real(*args, **options)

        return call

    with monkeypatch.context() as patch:
        for name in ("rename", "unlink", "rmdir"):
            patch.setattr(os, name, guarded(getattr(os, name)))
        try:
            write(path, new, overwrite=True)
        except Killed:
            pass
        else:
            assert not calls["stopped"]
    # At any moment one whole store, old or new, is there under one of its names.
    assert any(_is_whole(p) for p in tmp_path.iterdir())
    write(path, new, overwrite=True)
    assert sorted(os.listdir(tmp_path)) == ["s"] and verify(path) == []
    assert open_captures(path)[0].equals(new)
