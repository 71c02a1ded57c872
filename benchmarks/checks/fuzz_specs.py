"""Spec files, meshes, grids, pictures and words of the command line, for the campaign of fuzzed inputs."""

from __future__ import annotations

import gzip
import json
import shutil
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .mutations import json_mutated, mutated

__all__ = ["SPECS", "Subject", "all_tried", "any_file", "json_file"]


@dataclass(frozen=True)
class Subject:
    """One kind of input.

    Main arguments:
        make: writes a sound example into a folder. change: alters it. read: what a verb does with it.
    Other arguments:
        weight: share of the attempts, smaller where one takes long.
    """

    make: Callable[[Path], None]
    change: Callable[[Path, np.random.Generator], None]
    read: Callable[[Path], None]
    weight: float = 1.0


def any_file(folder: Path, rng: np.random.Generator) -> None:
    """Change one file of the folder, at its bytes."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    path = files[int(rng.integers(len(files)))]
    path.write_bytes(mutated(path.read_bytes(), rng))


def json_file(folder: Path, rng: np.random.Generator) -> None:
    """Change one file of the folder, at its values if it is JSON and chance so decides."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    path = files[int(rng.integers(len(files)))]
    if path.suffix in (".json", ".gltf") and rng.random() < 0.8:
        path.write_bytes(json_mutated(path.read_bytes(), rng))
    else:
        path.write_bytes(mutated(path.read_bytes(), rng))


# ---------------------------------------------------------------- specs


def _specs(folder: Path) -> None:
    from ...scenes.load import load_scene
    from ...scenes.spec_files import LIBRARY

    shutil.copy(LIBRARY / "tilted-wall.toml", folder / "scene.toml")
    (folder / "scene.json").write_text(load_scene("spotscan-wall").model_dump_json())


def _read_specs(folder: Path) -> None:
    from ...scenes.errors import InputError
    from ...scenes.load import load_scene

    refused: list[InputError] = []
    for name in ("scene.toml", "scene.json"):
        try:
            load_scene(folder / name)
        except InputError as error:
            refused.append(error)
    if refused:
        raise refused[0]


def _suites(folder: Path) -> None:
    text = """schema_version = 1
suite = "small"
version = 1
title = "A small suite"
scenes = ["flat-wall"]
conditions = ["matched"]
estimators = ["peak", "weighted-average[background=outside]"]
fidelity = "direct"
rtol = 1.0e-3
[seeds]
dev = [1]
test = [2]
[[stresses]]
axis = "photons"
values = [100.0, 1000.0]
"""
    (folder / "suite.toml").write_text(text)


def _read_suite(folder: Path) -> None:
    from ..suites.suite import cells_of, load_suite

    cells_of(load_suite(folder / "suite.toml"))


# ---------------------------------------------------------------- meshes, grids, pictures

_OBJ = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv .5 .5 1\nvt 0 0\nvt 1 1\nf 1/1 2/2 3/1 4/2\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n"
_PLY = b"""ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
element tristrips 1
property list int int vertex_indices
end_header
0 0 0
1 0 0
1 1 0
0 1 .5
4 0 1 2 3
5 0 1 2 -1 3
"""
_OFF = b"OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 .5\n3 0 1 2\n4 0 1 2 3\n"
_SPACE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"


def _meshes(folder: Path) -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0.5]], "<f4")
    for name, content in {"a.obj": _OBJ, "a.obj.gz": gzip.compress(_OBJ), "a.ply": _PLY, "a.off": _OFF}.items():
        (folder / name).write_bytes(content)
    head = b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    rows = b"element face 1\nproperty list uchar uint vertex_indices\nend_header\n" + corners.tobytes()
    (folder / "b.ply").write_bytes(head + rows + b"\x03" + np.array([0, 1, 2], "<u4").tobytes())
    triangle = struct.pack("<3f", 0, 0, 1) + corners.tobytes() + b"\0\0"
    (folder / "a.stl").write_bytes(b" " * 80 + struct.pack("<I", 2) + triangle * 2)
    (folder / "a.gltf").write_text(json.dumps(_gltf()))
    (folder / "a.bin").write_bytes(corners.tobytes())
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in corners)
    components = '<components><component objectid="1"/></components>'
    model = (
        f'<model xmlns="{_SPACE}"><resources><object id="1"><mesh><vertices>{vertices}</vertices><triangles>'
        '<triangle v1="0" v2="1" v3="2"/></triangles></mesh></object><object id="2">'
        f"{components}</object>"
        "</resources>"
        '<build><item objectid="2" transform="1 0 0 0 1 0 0 0 1 0 0 0"/></build></model>'
    )
    with zipfile.ZipFile(folder / "a.3mf", "w", zipfile.ZIP_STORED) as package:
        package.writestr("_rels/.rels", "<Relationships/>")
        package.writestr("3D/3dmodel.model", model)


def _gltf() -> dict[str, Any]:
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "children": [1]}, {"mesh": 0, "translation": [1, 0, 0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 4}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3}],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 36}],
        "buffers": [{"uri": "a.bin", "byteLength": 36}],
    }


def _read_meshes(folder: Path) -> None:
    from ...scenes.errors import InputError
    from ...scenes.meshes import shape_mesh
    from ...scenes.shapes import MeshFile

    refused: list[InputError] = []
    for path in sorted(folder.glob("*.*")):
        if path.suffix != ".bin":
            shape = MeshFile(
                kind="mesh", file=str(path), size_m=1.0, center_m=(0.0, 0.0, 3.0), rotation_deg=(0.0, 0.0, 0.0)
            )
            try:
                shape_mesh(shape, "target.0")
            except InputError as error:
                refused.append(error)
    if refused:
        raise refused[0]


def _grids(folder: Path) -> None:
    grid = np.linspace(0, 1, 20).reshape(4, 5)
    np.save(folder / "a.npy", grid)
    np.savez(folder / "a.npz", heights=grid)
    np.savez_compressed(folder / "b.npz", heights=grid.astype(np.float32))
    import OpenImageIO as oiio

    picture = oiio.ImageBuf(oiio.ImageSpec(5, 4, 1, oiio.UINT8))
    picture.set_pixels(oiio.ROI(), np.ascontiguousarray(grid[..., None], dtype=np.float32))
    picture.write(str(folder / "a.png"))


def _read_grids(folder: Path) -> None:
    from ...scenes.errors import InputError
    from ...scenes.meshes import load_grid
    from ...scenes.textures import Texture, load_texture

    refused: list[InputError] = []
    for path in sorted(folder.iterdir()):
        try:
            if path.suffix == ".png":
                load_texture(Texture(file=str(path), encoding="linear"), "texture")
            else:
                load_grid(str(path), "grid")
        except InputError as error:
            refused.append(error)
    if refused:
        raise refused[0]


# ---------------------------------------------------------------- words of the command line


def _words(folder: Path) -> None:
    (folder / "assignment").write_bytes(b"rig.camera.rows=8\ntarget.0.material.albedo=0.5\nrig.camera.cols=4")
    (folder / "label").write_bytes(b"weighted-average[background=outside]")


def _read_words(folder: Path) -> None:
    from ...estimators.labels import parse_label
    from ...scenes.errors import InputError
    from ...scenes.load import load_scene
    from ...scenes.overrides import parse_assignments

    refused: list[InputError] = []
    for line in (folder / "assignment").read_bytes().decode(errors="surrogateescape").split("\n"):
        try:
            load_scene("flat-wall", parse_assignments([line]))
        except InputError as error:
            refused.append(error)
    try:
        parse_label((folder / "label").read_bytes().decode(errors="surrogateescape"))
    except InputError as error:
        refused.append(error)
    if refused:
        str(refused[0]).encode(errors="replace")
        raise refused[0]


SPECS: dict[str, Subject] = {
    "scenes (TOML, JSON)": Subject(_specs, json_file, _read_specs),
    "suites": Subject(_suites, any_file, _read_suite),
    "meshes (seven kinds)": Subject(_meshes, json_file, _read_meshes),
    "grids and pictures": Subject(_grids, any_file, _read_grids),
    "overrides and labels": Subject(_words, any_file, _read_words),
}


def all_tried(*readings: Callable[[], object]) -> None:
    """Carry out every reading, whatever those before it refused. Raises the first InputError."""
    from ...scenes.errors import InputError

    refused: list[InputError] = []
    for reading in readings:
        try:
            reading()
        except InputError as error:
            refused.append(error)
    if refused:
        raise refused[0]
