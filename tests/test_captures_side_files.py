"""All files that a capture was made from are recorded: the numbers of a .gltf lie in its .bin."""

from __future__ import annotations

import hashlib
import json
import struct
from pathlib import Path

import pytest

from beambench.captures.sources import bare_scene, find_sources, source_files
from beambench.cli import main
from beambench.scenes.errors import InputError

from ._mesh_files import gltf_document, packed


def written(folder: Path, far: float) -> bytes:
    document, buffer, _ = gltf_document(4, "u2", "plain", sparse=True, woven=False)
    changed = buffer.replace(struct.pack("<3f", 0.75, -0.5, 1.0), struct.pack("<3f", 0.75, -0.5, far))
    for name, content in packed(document, changed, "beside").items():
        (folder / name).write_bytes(content)
    return changed


def scene(folder: Path) -> dict[str, object]:
    shape = {
        "kind": "mesh",
        "file": str(folder / "m.gltf"),
        "size_m": 1.0,
        "center_m": [0, 0, 5],
        "rotation_deg": [0, 0, 0],
    }
    return {"target": [{"name": "box", "shape": shape}]}


def test_the_bin_is_recorded_and_a_change_of_it_told(tmp_path: Path) -> None:
    content = written(tmp_path, 1.0)
    files = source_files(scene(tmp_path))
    assert [(f["path"], f["name"]) for f in files] == [
        ("target.0.shape.file", "m.gltf"), ("target.0.shape.file/a part.bin", "a part.bin"),
    ]  # fmt: skip
    assert files[1]["sha256"] == hashlib.sha256(content).hexdigest() and files[1]["bytes"] == len(content)
    kept = bare_scene(scene(tmp_path))
    assert find_sources(kept, files, [tmp_path], {}, "store") == scene(tmp_path)
    # A store of before, which does not hold the .bin, is repeated as it was.
    assert find_sources(kept, files[:1], [tmp_path], {}, "store") == scene(tmp_path)
    written(tmp_path, 2.0)
    with pytest.raises(InputError, match="differs from the one") as caught:
        find_sources(kept, files, [tmp_path], {}, "store")
    assert "a part.bin" in str(caught.value)


def test_a_store_is_not_resumed_or_repeated_from_another_bin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """--like told of thousands of differing values but not the cause; --resume took the store for the one asked for."""
    monkeypatch.chdir(tmp_path)
    written(tmp_path, 1.0)
    shape = json.dumps(scene(tmp_path)["target"][0]["shape"])  # type: ignore[index]
    asked = ["generate", "flat-wall", "--set", f"target.0.shape={shape}", "--set", "rig.camera.rows=8", "-o", "s.zarr"]
    assert main(asked) == 0
    assert main([*asked, "--resume"]) == 0
    capsys.readouterr()
    written(tmp_path, 2.0)
    assert main(["generate", "--like", "s.zarr"]) == 2
    assert "a part.bin" in capsys.readouterr().err
    assert main([*asked, "--resume"]) == 2
