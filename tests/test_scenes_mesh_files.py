"""Mesh files: read by their standard, or refused with the true reason.

Several hundred small files, of every feature that the readers claim, are held against the triangles that their writers know,
and against trimesh, a reader that shares nothing with ours. A reader that forgot an offset, a byte order, a transform, a strip's
turn or an index's base gives other triangles: they are compared one by one to 1e-6 of the extent (float32 positions).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.scenes.errors import InputError
from beambench.scenes.meshes import mesh_uv, shape_mesh
from beambench.scenes.shapes import MeshFile

from ._mesh_files import BOX, ELL, ELL_AREA, QUADS, TRIANGLES, corpus, gltf_document, packed

FLOAT32 = 1e-6


def shape(path: Path) -> MeshFile:
    return MeshFile(file=str(path), size_m=1.0, center_m=(0.0, 0.0, 0.0), rotation_deg=(0.0, 0.0, 0.0))


def placed(corners: np.ndarray) -> np.ndarray:
    """Triangles centred and scaled as a scene has them."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    return (corners - (low + high) / 2) / (high - low).max()


def listed(corners: np.ndarray) -> np.ndarray:
    """Triangles (m, 9) in an order that neither the first corner, nor the turn, nor the order of faces changes."""
    grain = np.round(corners, 4) + 0.0
    rows = []
    for triangle, fine in zip(grain, corners, strict=True):
        order = sorted(range(3), key=lambda k, t=triangle: tuple(t[k]))
        rows.append((tuple(triangle[order].ravel()), fine[order].ravel()))
    return np.array([fine for _, fine in sorted(rows, key=lambda row: row[0])])


def same(one: np.ndarray, two: np.ndarray) -> bool:
    return one.shape == two.shape and bool(np.abs(listed(one) - listed(two)).max() < FLOAT32)


def ours(path: Path) -> np.ndarray:
    vertices, faces = shape_mesh(shape(path), "test")
    return np.asarray(vertices[faces])


def write(folder: Path, files: dict[str, bytes]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return folder / next(iter(files))


def test_every_file_of_the_corpus_has_the_triangles_that_were_written(tmp_path: Path) -> None:
    cases = corpus()
    assert len({name for name, _, _ in cases}) == len(cases) >= 400
    wrong = []
    for number, (name, files, corners) in enumerate(cases):
        if not same(ours(write(tmp_path / str(number), files)), placed(corners)):
            wrong.append(name)
    assert not wrong


def test_an_independent_reader_agrees_wherever_it_reads_the_file(tmp_path: Path) -> None:
    """trimesh reads most of the corpus. Where it and the writers differ is known: sparse accessors, which it leaves out."""
    import trimesh

    agreed, differ = 0, []
    for number, (name, files, _) in enumerate(corpus()):
        path = write(tmp_path / str(number), files)
        try:
            read = trimesh.load(str(path), force="mesh", process=False)
            theirs = placed(np.asarray(read.vertices, dtype=np.float64)[np.asarray(read.faces)])
        except Exception:  # tabs, Latin-1, mixed polygons, percent signs, 3MF without lxml: theirs to refuse
            continue
        if same(ours(path), theirs):
            agreed += 1
        else:
            differ.append(name)
    assert agreed >= 200
    assert all(name.startswith("gltf-sparse") for name in differ)


def test_a_concave_face_covers_its_inside_only(tmp_path: Path) -> None:
    """A fan about the first corner of an L covers 4 of its 3 units of area, or less."""
    for turned in range(6):
        lines = [f"v {x} {y} {z}" for x, y, z in np.roll(ELL, turned, axis=0).tolist()] + ["f 1 2 3 4 5 6"]
        path = write(tmp_path / str(turned), {"m.obj": "\n".join(lines).encode()})
        corners = ours(path) * 2.0  # the L is 2 wide
        area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        assert len(corners) == 4 and area.sum() == pytest.approx(ELL_AREA, rel=1e-12)
        middle = corners.mean(axis=1)
        assert not ((middle[:, 0] > 0) & (middle[:, 1] > 0)).any()  # the quarter that the L lacks


def box_obj(vertices: np.ndarray, extra: str = "") -> bytes:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    return ("\n".join([*lines, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in TRIANGLES)]) + extra).encode()


def test_a_face_without_area_does_not_set_the_bounds(tmp_path: Path) -> None:
    whole = ours(write(tmp_path / "a", {"m.obj": box_obj(BOX)}))
    for number, extra in enumerate((
        "\nv 9 9 9\nf 9 9 9\n", "\nv 9 9 9\nf 1 9 1\n", "\nv 9 0 0\nv 8 0 0\nv 7 0 0\nf 9 10 11\n", "\nv 9 9 9\n",
    )):  # fmt: skip
        assert same(ours(write(tmp_path / str(number), {"m.obj": box_obj(BOX, extra)})), whole)


@pytest.mark.parametrize("unit", [1e-12, 1e-9, 1e-7, 1e-3, 1e6, 1e12])
def test_the_unit_of_a_file_does_not_matter(tmp_path: Path, unit: float) -> None:
    """Corners nearer than 1e-8 were merged before they were scaled: in nanometres a sphere was empty."""
    assert same(ours(write(tmp_path / "a", {"m.obj": box_obj(BOX * unit)})), placed(BOX[np.array(TRIANGLES)]))


def textured_glb(images: bool) -> bytes:
    """Two plates side by side with uv of their own, as one GLB: v counts down from the top in glTF."""
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype="<f4")
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], dtype="<f4")
    order = np.array([0, 1, 2, 0, 2, 3], dtype="<u2")
    blocks = [points.tobytes(), uv.tobytes(), (points + np.array([1, 0, 0], "<f4")).tobytes(), order.tobytes()]
    starts = np.cumsum([0, *map(len, blocks)])
    views = [{"buffer": 0, "byteOffset": int(s), "byteLength": len(b)} for s, b in zip(starts, blocks, strict=False)]
    spec = [(5126, 4, "VEC3"), (5126, 4, "VEC2"), (5126, 4, "VEC3"), (5123, 6, "SCALAR")]
    document: dict[str, Any] = {
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0, 1]}], "nodes": [{"mesh": 0}, {"mesh": 1}],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": p, "TEXCOORD_0": 1}, "indices": 3, "material": m}]}
            for m, p in enumerate((0, 2))
        ],
        "accessors": [
            {"bufferView": i, "componentType": c, "count": n, "type": t} for i, (c, n, t) in enumerate(spec)
        ],
        "bufferViews": views, "buffers": [{"byteLength": int(starts[-1])}], "materials": [{}, {}],
    }  # fmt: skip
    if images:
        dot = "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGNgAAAAAgABSK+kcQAAAABJRU5ErkJggg=="
        document["images"] = [{"uri": dot}, {"uri": dot}]
        document["textures"] = [{"source": 0}, {"source": 1}]
        document["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": i}}} for i in (0, 1)]
    return packed(document, b"".join(blocks), "glb")["m.glb"]


@pytest.mark.parametrize("images", [False, True])
@pytest.mark.parametrize("name", ["m.glb", "m.glb.gz"])
def test_texture_coordinates_are_those_of_the_file(tmp_path: Path, images: bool, name: str) -> None:
    """A GLB's were told to be missing, and those of two images were packed anew into an atlas."""
    import gzip

    content = textured_glb(images)
    path = write(tmp_path / "a", {name: gzip.compress(content) if name.endswith("gz") else content})
    vertices, _ = shape_mesh(shape(path), "test")
    uv = mesh_uv(shape(path), "test")
    x, y = vertices[:, 0] * 2 + 1, vertices[:, 1] * 2 + 0.5  # the pair is 2 wide, 1 high
    left = x < 0.5
    right = x > 1.5
    assert left.sum() == 2 and right.sum() == 2 and len(uv) == 8
    np.testing.assert_allclose(uv[left], np.stack([0 * y[left], 1 - y[left]], axis=1), atol=1e-6)
    np.testing.assert_allclose(uv[right], np.stack([0 * y[right] + 1, 1 - y[right]], axis=1), atol=1e-6)
    np.testing.assert_allclose(uv[:, 1], 1 - y, atol=1e-6)  # v downward, y of this file upward


def damaged_gltf(**changes: Any) -> bytes:
    document, buffer, _ = gltf_document(4, "u2", "plain", sparse=False, woven=False)
    for key, value in changes.items():
        if isinstance(document.get(key), list) and isinstance(value, dict):
            document[key][0] |= value
        else:
            document[key] = value
    return packed(document, buffer, "glb")["m.glb"]


OFF_BOX = "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
PLY_HEAD = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
PLY_FACE = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("m.glb", damaged_gltf(extensionsRequired=["KHR_draco_mesh_compression"]), "requires the extension KHR_draco"),
        ("m.glb", damaged_gltf(extensionsRequired=["EXT_mesh_gpu_instancing"]), "requires the extension EXT_mesh_gpu"),
        ("m.glb", damaged_gltf(nodes={"skin": 0}), "bent by a skin"),
        ("m.glb", damaged_gltf(nodes={"children": [0]}), "part of itself"),
        ("m.glb", damaged_gltf(asset={"version": "1.0"}), "version 1.0"),
        ("m.glb", damaged_gltf(accessors={"count": 99}), "too short"),
        ("m.glb", damaged_gltf(accessors={"bufferView": 9}), "bufferViews 9"),
        ("m.glb", damaged_gltf()[:-10], "tells of"),
        ("m.glb", damaged_gltf(buffers={"uri": "../secret.bin"}), "does not lie in its folder"),
        ("m.glb", damaged_gltf(buffers={"uri": "http://a.b/c.bin"}), "no file in its folder"),
        ("m.glb", damaged_gltf(buffers={"uri": "gone.bin"}), "'gone.bin', which is not there"),
        ("m.gltf", b"{", "no JSON"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "line 4"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "count from 1"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -4 1 2\n", "count from 1"),
        ("m.obj", b"v 0 0 zero\n", "'zero' is no number"),
        ("m.obj", b"v 0 0 0\ncstype bspline\n", "'cstype' is not read"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 inf\nf 1 2 3\n", "not a finite number"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no area"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\n", "empty"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 3 2 4\n", "crosses itself"),
        ("m.stl", b"x" * 80 + (5).to_bytes(4, "little") + bytes(120), "ends after 2"),
        ("m.stl", b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n", "before endsolid"),
        ("m.stl", b"short", "no STL"),
        ("m.off", OFF_BOX.replace("OFF", "4OFF").encode(), "4OFF is not read"),
        ("m.off", OFF_BOX.replace("3 1 0", "3 2 0").encode(), "ends after"),
        ("m.off", OFF_BOX.replace("3 0 1 2", "3 0 1 7").encode(), "vertex that the file does not have"),
        ("m.ply", (PLY_HEAD + PLY_FACE + "0 0 0\n1 0 0\n0 1 0\n").encode(), "ends after 0 of 1 rows of 'face'"),
        ("m.ply", (PLY_HEAD.replace("ascii", "morse") + PLY_FACE).encode(), "format morse"),
        ("m.ply", (PLY_HEAD + PLY_FACE + "0 0 0\n1 0 x\n").encode(), "no number"),
        ("m.ply", PLY_HEAD.encode(), "header does not end"),
        ("m.3mf", b"PK no package", "no 3MF package"),
        ("m.obj.gz", b"no gzip", "cannot be unpacked"),
        ("m.blend", b"BLENDER", "does not read this kind"),
    ],
)  # fmt: skip
def test_what_is_not_read_is_refused_with_the_reason(tmp_path: Path, name: str, content: bytes, says: str) -> None:
    with pytest.raises(InputError) as caught:
        ours(write(tmp_path / "a", {name: content}))
    assert says in str(caught.value)


def test_an_optional_extension_and_quantised_positions_are_read(tmp_path: Path) -> None:
    path = write(tmp_path / "a", {"m.glb": damaged_gltf(extensionsUsed=["KHR_draco_mesh_compression"])})
    assert same(ours(path), placed(BOX[np.array(TRIANGLES)]))
    whole = np.round(BOX * 80).astype("<i2")
    document, _, _ = gltf_document(4, "u2", "plain", sparse=False, woven=False)
    order = np.array(TRIANGLES, dtype="<u2").tobytes()
    document["accessors"][0] |= {"componentType": 5122}
    document["bufferViews"] = [
        {"buffer": 0, "byteOffset": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": len(order)},
    ]  # fmt: skip
    document["buffers"] = [{"byteLength": 48 + len(order)}]
    document["extensionsRequired"] = ["KHR_mesh_quantization"]
    files = packed(json.loads(json.dumps(document)), whole.tobytes() + order, "glb")
    assert same(ours(write(tmp_path / "b", files)), placed((BOX * 80)[np.array(TRIANGLES)]))


def test_ply_strips_and_corner_texture(tmp_path: Path) -> None:
    strip = (PLY_HEAD.replace("vertex 3", "vertex 4") + "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
             "0 0 0\n1 0 0\n0 1 0\n1 1 0\n6 0 1 2 3 -1 0\n")  # fmt: skip
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [0, 1, 0], [1, 1, 0]]], dtype=float)
    assert same(ours(write(tmp_path / "a", {"m.ply": strip.encode()})), placed(corners))
    face = PLY_FACE.replace("vertex_indices\n", "vertex_indices\nproperty list uchar float texcoord\n")
    text = PLY_HEAD + face + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2 6 0 0 1 0 0 1\n"
    path = write(tmp_path / "b", {"m.ply": text.encode()})
    vertices, _ = shape_mesh(shape(path), "test")
    np.testing.assert_allclose(
        mesh_uv(shape(path), "test"), np.stack([vertices[:, 0] + 0.5, 0.5 - vertices[:, 1]], axis=1)
    )


def test_quads_are_the_polygons_they_were(tmp_path: Path) -> None:
    """The corpus itself: six faces of a box close it, so that its volume is known."""
    import trimesh

    corners = BOX[np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])]
    solid = trimesh.Trimesh(corners.reshape(-1, 3), np.arange(36).reshape(-1, 3))
    assert solid.is_watertight and abs(solid.volume) == pytest.approx(1.0 * 0.75 * 0.5)
