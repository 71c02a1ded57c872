"""What the campaign of fuzzed inputs reads: for each kind of file one sound example, and the readers that a verb uses on it."""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import shutil
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .mutations import json_mutated, mutated

__all__ = ["SUBJECTS", "Subject"]


@dataclass(frozen=True)
class Subject:
    """One kind of input.

    Main arguments:
        make: writes a sound example into a folder. change: alters it. read: what a verb does with it.
    """

    make: Callable[[Path], None]
    change: Callable[[Path, np.random.Generator], None]
    read: Callable[[Path], None]


def _any_file(folder: Path, rng: np.random.Generator) -> None:
    """Change one file of the folder, at its bytes."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    path = files[int(rng.integers(len(files)))]
    path.write_bytes(mutated(path.read_bytes(), rng))


def _json_file(folder: Path, rng: np.random.Generator) -> None:
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


# ---------------------------------------------------------------- stores and estimates


def _store(folder: Path) -> None:
    from ...captures import write
    from ...captures.example import example_capture

    write(folder / "s.zarr", [example_capture("amcw", seed=seed, optional=False) for seed in range(2)])


def reseal(store: Path) -> None:
    """Give altered metadata their checksums, as a hostile writer would."""
    manifest = json.loads((store / "manifest.json").read_bytes())
    for name in manifest["metadata"] if isinstance(manifest.get("metadata"), dict) else []:
        path = store / name
        if path.is_file():
            manifest["metadata"][name] = hashlib.sha256(path.read_bytes()).hexdigest()
    chunks = manifest.get("chunks")
    for array, marks in chunks.items() if isinstance(chunks, dict) else []:
        for key, mark in marks.items() if isinstance(marks, dict) else []:
            path = store / str(array) / str(key)
            if isinstance(mark, list) and len(mark) == 2 and ".." not in str(path) and path.is_file():
                mark[:] = [path.stat().st_size, hashlib.sha256(path.read_bytes()).hexdigest()]
    if (store / "record.jsonl").is_file():
        manifest["record"] = hashlib.sha256((store / "record.jsonl").read_bytes()).hexdigest()
    text = json.dumps(manifest).encode()
    (store / "manifest.json").write_bytes(text)
    (store / "manifest.sha256").write_text(hashlib.sha256(text).hexdigest() + "\n")


def _hostile_store(folder: Path, rng: np.random.Generator) -> None:
    """Change values of the metadata, the manifest or chunks, and seal the store again."""
    import google_crc32c

    store = folder / "s.zarr"
    names = ["zarr.json", "manifest.json", *(str(p.relative_to(store)) for p in sorted(store.glob("*/zarr.json")))]
    for _ in range(int(rng.integers(1, 3))):
        if rng.random() < 0.25:
            chunks = sorted(store.glob("*/c.*"))
            path = chunks[int(rng.integers(len(chunks)))]
            body = mutated(path.read_bytes()[:-4], rng)
            path.write_bytes(body + int(google_crc32c.value(body)).to_bytes(4, "little"))
        else:
            path = store / names[int(rng.integers(len(names)))]
            path.write_bytes(json_mutated(path.read_bytes(), rng))
    try:
        reseal(store)
    except (ValueError, TypeError, AttributeError):
        return  # the manifest itself is no object any more


def _read_store(folder: Path) -> None:
    from ...captures import open_captures, repair, verify
    from ...captures.contents import contents
    from ...captures.store.status import status
    from ...scenes.errors import InputError

    refused: list[InputError] = []

    def attempt(work: Callable[[], object]) -> None:
        try:
            work()
        except InputError as error:
            refused.append(error)

    store = folder / "s.zarr"
    attempt(lambda: [capture.load() for capture in open_captures(store)])
    attempt(lambda: contents(store))
    attempt(lambda: status(store))
    attempt(lambda: verify(store))
    attempt(lambda: repair(store))
    if refused:
        raise refused[0]


def _unfinished(folder: Path) -> None:
    from ...captures import CaptureWriter
    from ...captures.example import example_capture

    writer = CaptureWriter(folder / "s.zarr")
    for seed in range(2):
        writer.append(example_capture("amcw", seed=seed, optional=False))
    writer.abandon()


def _hostile_journal(folder: Path, rng: np.random.Generator) -> None:
    """Change one line of the journal; with its checksum, or the bytes alone."""
    path = folder / "s.zarr.partial" / "journal.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    number = int(rng.integers(len(lines)))
    if rng.random() < 0.7:
        text = json_mutated(lines[number].split(b" ", 1)[1], rng)
        lines[number] = hashlib.sha256(text).hexdigest().encode() + b" " + text + b"\n"
    else:
        lines[number] = mutated(lines[number], rng)
    path.write_bytes(b"".join(lines))


def _read_unfinished(folder: Path) -> None:
    from ...captures import finalize, repair
    from ...captures.store.status import status
    from ...scenes.errors import InputError

    partial = folder / "s.zarr.partial"
    status(folder / "s.zarr")
    try:
        finalize(partial)
    except InputError:
        repair(partial)


def _estimates(folder: Path) -> None:
    from ...captures.estimates import Estimates, write_estimates

    one: dict[str, Any] = {"range": np.full((3, 4), 5.0), "sigma": np.ones((3, 4)), "valid": np.ones((3, 4), bool)}
    write_estimates(
        folder / "peak.h5",
        Estimates("peak", "gated", [one, one], [0.1, 0.2], [0.1, 0.2], [1e6, 1e6], ["ok", "ok"], "ab" * 32),
    )


def _read_estimates(folder: Path) -> None:
    from ...captures.estimates import read_estimates

    read_estimates(folder / "peak.h5", 2, {"row": 3, "col": 4}, modality="gated", captures_sha256="ab" * 32)


# ---------------------------------------------------------------- folders of results


def _row(seed: int, estimator: str) -> dict[str, Any]:
    from ..scores.score import COLUMNS

    texts = {
        "suite": "s", "scene": "flat-wall", "stress": "", "stress2": "", "condition": "matched", "stage": "range",
        "estimator": estimator, "params": "", "modality": "gated", "quantity": "range", "unit": "m", "bound_kind": "exact",
        "status": "ok",
    }  # fmt: skip
    numbers = dict.fromkeys(COLUMNS, 0.5) | {"level": float("nan"), "level2": float("nan"), "seed": seed, "n": 48}
    return numbers | texts


def _results(folder: Path) -> None:
    from ..folders.files import write_json
    from ..folders.journal import Journal
    from ..scores.error_tiles import write_tiles
    from ..scores.tables import write_tables

    rows = [_row(seed, name) for seed in (1, 2) for name in ("peak", "parabola")]
    write_tables(folder, rows)
    journal = Journal(folder, "h", verb="run")
    for row in rows:
        journal.add(("flat-wall", str(row["seed"]), row["estimator"]), [row])
    write_json(folder / "run.json", {"verb": "run", "hash": "h", "tables_version": 3, "machine": {}, "failures": []})
    tiles = {
        ("flat-wall", "matched", seed, name): (np.ones(64), np.ones(64))
        for seed in (1, 2)
        for name in ("peak", "parabola")
    }
    write_tiles(folder, tiles)
    (folder / "pictures").mkdir()
    shape = (3, 4)
    np.savez_compressed(
        folder / "pictures" / "flat-wall__peak.npz", value=np.ones(shape), truth=np.ones(shape), error=np.zeros(shape),
        valid=np.ones(shape, bool), scene="flat-wall", estimator="peak", condition="matched", quantity="range", unit="m",
    )  # fmt: skip


def _read_results(folder: Path) -> None:
    from ...scenes.errors import InputError
    from ..folders.journal import Journal
    from ..folders.kinds import verb_in
    from ..report.compare import compare_tables
    from ..report.data import cells_of, read_run
    from ..report.pictures import read_pictures
    from ..scores.error_tiles import read_tiles
    from ..scores.tables import read_scores

    verb_in(folder)
    refused: list[InputError] = []

    def attempt(work: Callable[[], object]) -> None:
        try:
            work()
        except InputError as error:
            refused.append(error)

    attempt(lambda: Journal.check(folder, "h", verb="run"))
    attempt(lambda: Journal(folder, "h", verb="run"))
    attempt(lambda: read_run(folder))
    attempt(lambda: cells_of(read_scores(folder / "scores.csv")))
    attempt(lambda: cells_of(read_scores(folder / "scores.parquet")))
    attempt(lambda: compare_tables(folder, folder))
    attempt(lambda: read_tiles(folder))
    attempt(lambda: read_pictures(folder / "pictures"))
    if refused:
        raise refused[0]


def _cache(folder: Path) -> None:
    from ..runner.result_cache import ResultCache

    job, chosen = _job(folder)
    from ..runner.session import Outcome

    arrays: dict[str, Any] = {
        "range": np.full((3, 4), 5.0),
        "sigma": np.full((3, 4), 0.1),
        "valid": np.ones((3, 4), bool),
    }
    ResultCache(folder / "kept").put(Outcome(job, "ok", arrays, cpu_s=0.1, wall_s=0.2, peak_bytes=300.0), chosen)


def _job(folder: Path) -> tuple[Any, Any]:
    from ..runner.estimator_labels import check_estimators
    from ..runner.session import Job

    place = folder.parent / "capture-of-the-cache"
    if not place.is_dir():
        place.mkdir()
        np.save(place / "counts.npy", np.ones((2, 3, 4), np.uint16))
        (place / "meta-matched.json").write_text("{}")
    (chosen,) = check_estimators(["peak"])
    return Job(0, place, "matched", "gated", {"row": 3, "col": 4}), chosen


def _read_cache(folder: Path) -> None:
    from ..runner.result_cache import ResultCache

    job, chosen = _job(folder)
    found = ResultCache(folder / "kept").get(job, chosen)
    if found is not None:
        for name in ("range", "sigma"):
            if not np.isfinite(found.arrays[name][found.arrays["valid"]]).all():
                raise AssertionError(f"the cache took {name} that is not finite")


def _plans(folder: Path) -> None:
    from ..folders.exchange import EXCHANGE

    _results(folder)
    plan = {
        "verb": "run",
        "aside": "replaced",
        "old": [["run.json", "replaced/run.json"]],
        "new": [["unfinished/run.json", "run.json"]],
    }
    (folder / EXCHANGE).write_text(json.dumps(plan))
    (folder / "unfinished").mkdir()
    shutil.copy(folder / "run.json", folder / "unfinished" / "run.json")


def _change_plan(folder: Path, rng: np.random.Generator) -> None:
    path = folder / "exchange.json"
    content = path.read_bytes()
    path.write_bytes(json_mutated(content, rng) if rng.random() < 0.7 else mutated(content, rng))


def _read_plan(folder: Path) -> None:
    from ..folders.exchange import finish_exchange
    from ..folders.kinds import RUN

    guard = folder.parent / "guard"
    guard.write_text("mine")
    finish_exchange(folder, RUN)
    if guard.read_text() != "mine" or not os.path.lexists(guard):
        raise AssertionError("a file outside the folder was touched")


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


SUBJECTS: dict[str, Subject] = {
    "scenes (TOML, JSON)": Subject(_specs, _json_file, _read_specs),
    "suites": Subject(_suites, _any_file, _read_suite),
    "meshes (seven kinds)": Subject(_meshes, _json_file, _read_meshes),
    "grids and pictures": Subject(_grids, _any_file, _read_grids),
    "stores, bytes": Subject(_store, _any_file, _read_store),
    "stores, values under right checksums": Subject(_store, _hostile_store, _read_store),
    "unfinished stores": Subject(_unfinished, _hostile_journal, _read_unfinished),
    "estimates (HDF5)": Subject(_estimates, _any_file, _read_estimates),
    "folders of runs": Subject(_results, _json_file, _read_results),
    "caches": Subject(_cache, _any_file, _read_cache),
    "plans of exchanges": Subject(_plans, _change_plan, _read_plan),
    "overrides and labels": Subject(_words, _any_file, _read_words),
}
