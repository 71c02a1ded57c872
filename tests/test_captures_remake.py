"""Damaged captures are made again with the bits that were written, and no damaged capture is published."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

import beambench
from beambench import cli
from beambench.captures import CaptureWriter, finalize, open_captures, verify, write
from beambench.captures.example import example_capture
from beambench.scenes.errors import InputError

SMALL = {"rig.camera.rows": 4, "rig.camera.cols": 4}


def tree(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


def flip(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("made") / "s.zarr"
    beambench.generate("flat-wall", seeds=[1, 2, 3], out=path, overrides=SMALL)
    return path


def test_captures_are_made_again_bit_by_bit(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = Path(shutil.copytree(made, tmp_path / "s.zarr"))
    before = tree(store)
    flip(store / "counts" / "c.1.0.0.0")
    (store / "truth_range" / "c.2.0.0").unlink()
    flip(store / "zarr.json")
    assert cli.main(["data", "repair", str(store), "--regenerate", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (
        told["remade"] == [1, 2] and told["kept"] == 3 and told["restored"] == ["zarr.json"] and told["aside"] is None
    )
    assert tree(store) == before and [path.name for path in tmp_path.iterdir()] == ["s.zarr"]


def test_what_differs_from_what_was_written_is_not_taken(made: Path, tmp_path: Path) -> None:
    """The chunk was written by another version, so to say: what is made again has other bits."""
    store = Path(shutil.copytree(made, tmp_path / "s.zarr"))
    captures = list(open_captures(store))
    captures[1] = captures[1].assign(counts=captures[1]["counts"] + captures[1]["counts"].dtype.type(1))
    write(store, captures, overwrite=True)
    flip(store / "counts" / "c.1.0.0.0")
    recovery = beambench.data_repair(store, regenerate=True)
    assert (
        recovery.remade == () and recovery.dropped == (1,) and "differs from what was written" in recovery.not_remade[0]
    )
    assert verify(store) == [] and len(open_captures(store)) == 2


def test_a_capture_without_its_arguments_is_dropped_with_the_reason(tmp_path: Path) -> None:
    store = write(tmp_path / "s.zarr", [example_capture("gated", seed=seed) for seed in range(2)])
    flip(store / "counts" / "c.0.0.0.0")
    recovery = beambench.data_repair(store, regenerate=True)
    assert recovery.dropped == (0,) and recovery.not_remade[0].startswith("capture 0: ")


def unfinished(path: Path, seeds: list[int]) -> Path:
    """A store whose writing stopped after the captures of these seeds."""
    whole = path.with_name("whole.zarr")
    beambench.generate("flat-wall", seeds=seeds, out=whole, overrides=SMALL)

    def some() -> Iterator[object]:
        yield from open_captures(whole)
        raise RuntimeError("stopped")

    with pytest.raises(RuntimeError):
        write(path, some())  # type: ignore[arg-type]
    shutil.rmtree(whole)
    return path.with_name(path.name + ".partial")


def test_resume_publishes_no_damaged_capture(tmp_path: Path) -> None:
    """`finalize` refused it, and `--resume` published it."""
    store = tmp_path / "s.zarr"
    partial = unfinished(store, [1, 2])
    flip(partial / "counts" / "c.0.0.0.0")
    for go in (
        lambda: finalize(store),
        lambda: CaptureWriter(store, resume=True),
        lambda: beambench.generate("flat-wall", seeds=[1, 2, 3], out=store, overrides=SMALL, resume=True),
    ):
        with pytest.raises(InputError, match="--regenerate"):
            go()
    assert not store.exists()
    recovery = beambench.data_repair(partial, regenerate=True)
    assert recovery.remade == (0,) and recovery.kept == 2 and verify(store) == []
