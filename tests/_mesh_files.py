"""Writers of small mesh files, each of which knows the triangles that it wrote: what readers are held against."""

from __future__ import annotations

import base64
import gzip
import io
import itertools
import json
import struct
import zipfile
from collections.abc import Iterator
from typing import Any

import numpy as np

Corners = np.ndarray  # (m, 3, 3): the triangles of a file, in its unit
#: name → (files by their names, the first of which is the mesh; its triangles)
Case = tuple[str, dict[str, bytes], Corners]

BOX = np.array(list(itertools.product((-0.5, 0.5), (-0.375, 0.375), (-0.25, 0.25))))
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = [t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))]
#: An L-shaped plate (concave, seven corners of which the fan about the first covers what is outside), and its triangles.
ELL = np.add(
    np.array([(0, 0, 0), (2, 0, 0), (2, 1, 0), (1, 1, 0), (1, 2, 0), (0, 2, 0)], dtype=float), [0.5, 0.25, 1.0]
)
ELL_AREA = 3.0
MIXED = [*QUADS[:3], *(t for a, b, c, d in QUADS[3:] for t in ((a, b, c), (a, c, d)))]


def fans(polygons: Any) -> list[tuple[int, int, int]]:
    return [(p[0], p[k], p[k + 1]) for p in polygons for k in range(1, len(p) - 1)]


def obj_files() -> Iterator[Case]:
    shapes = {"triangles": TRIANGLES, "quads": QUADS, "mixed": MIXED}
    for (shape, faces), form, back, gap, end in itertools.product(
        shapes.items(), ("v", "v/t", "v//n", "v/t/n"), (False, True), (" ", "\t", "  "), ("\n", "\r\n")
    ):
        lines = ["# corners of a box, é" if gap == "\t" else "# box", "mtllib a.mtl", "o box", "s off"]
        lines += [gap.join(["v", *map(repr, v)]) for v in BOX.tolist()]
        lines += [gap.join(["vt", repr(x + 0.5), repr(y + 0.5)]) for x, y, _ in BOX.tolist()]
        lines += ["vn 0 0 1", "usemtl grey"]
        for face in faces:
            named = [(i - 8 if back else i + 1) for i in face]
            normal = -1 if back else 1
            words = {
                "v": [f"{i}" for i in named], "v/t": [f"{i}/{i}" for i in named],
                "v//n": [f"{i}//{normal}" for i in named], "v/t/n": [f"{i}/{i}/{normal}" for i in named],
            }[form]  # fmt: skip
            lines.append(gap.join(["f", *words]))
        name = f"obj-{shape}-{form.replace('/', '_')}-{'back' if back else 'on'}-{len(gap)}{ord(gap[0])}-{len(end)}"
        yield name, {"m.obj": (end.join(lines) + end).encode("latin-1")}, BOX[np.array(fans(faces))]
    text = "v 0 0 0\nv 1 0 0\nv 1 2 0\nv 0 2 \\\n0\nf 1 2 \\\n 3 4\nl 1 2\np 1\n"
    yield (
        "obj-continued",
        {"m.obj": text.encode("utf-8-sig")},
        np.array([[[0, 0, 0], [1, 0, 0], [1, 2, 0]], [[0, 0, 0], [1, 2, 0], [0, 2, 0]]], dtype=float),
    )


def ply_files() -> Iterator[Case]:
    shapes = {"triangles": TRIANGLES, "quads": QUADS, "mixed": MIXED}
    forms = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
    for (form, order), (shape, faces), real, count, more in itertools.product(
        forms.items(), shapes.items(), ("float", "double"), ("uchar", "int", "ushort"), ("", "colour", "edges")
    ):
        code = {"float": "f", "double": "d", "uchar": "B", "int": "i", "ushort": "H"}
        head = ["ply", f"format {form} 1.0", "comment é", "element vertex 8", *(f"property {real} {a}" for a in "xyz")]
        head += ["property uchar red"] * (more == "colour")
        head += [f"element face {len(faces)}", f"property list {count} int vertex_indices"]
        head += ["property uchar flags"] * (more == "colour")
        head += ["element edge 1", "property int vertex1", "property int vertex2"] * (more == "edges")
        body = b""
        if order:
            for v in BOX:
                body += struct.pack(f"{order}3{code[real]}", *v) + bytes([7]) * (more == "colour")
            for face in faces:
                body += struct.pack(f"{order}{code[count]}{len(face)}i", len(face), *face) + bytes([7]) * (
                    more == "colour"
                )
            body += struct.pack(f"{order}2i", 0, 1) * (more == "edges")
        else:
            tail = " 7" * (more == "colour")
            rows = [" ".join(map(repr, v)) + tail for v in BOX.tolist()]
            rows += [" ".join(map(str, (len(face), *face))) + tail for face in faces] + ["0 1"] * (more == "edges")
            body = ("\n".join(rows) + "\n").encode()
        content = ("\n".join([*head, "end_header"]) + "\n").encode() + body
        yield f"ply-{form}-{shape}-{real}-{count}-{more}", {"m.ply": content}, BOX[np.array(fans(faces))]


def stl_files() -> Iterator[Case]:
    corners = BOX[np.array(TRIANGLES)]
    facets = b"".join(struct.pack("<12fH", 0, 0, 0, *t.ravel(), 0) for t in corners)
    for start, tail in itertools.product((b"binary", b"solid of bits"), (b"", b"\n", b"made by a program, 2026")):
        content = start.ljust(80, b"\0") + struct.pack("<I", len(corners)) + facets + tail
        yield f"stl-binary-{start[:5].decode()}-{len(tail)}", {"m.stl": content}, corners
    for upper, end, name in itertools.product((False, True), ("\n", "\r\n"), ("", " a b")):
        lines = ["solid" + name]
        for t in corners.tolist():
            lines += ["facet normal 0 0 1", " outer loop", *("  vertex " + " ".join(map(repr, v)) for v in t)]
            lines += [" endloop", "endfacet"]
        text = end.join([*lines, "endsolid" + name]) + end
        yield f"stl-text-{upper}-{len(end)}-{len(name)}", {"m.stl": (text.upper() if upper else text).encode()}, corners


def off_files() -> Iterator[Case]:
    for (shape, faces), head, notes in itertools.product(
        {"triangles": TRIANGLES, "quads": QUADS, "mixed": MIXED}.items(), ("OFF", "COFF", "NOFF"), (False, True)
    ):
        more = {"OFF": "", "COFF": " 0.5 0.5 0.5 1", "NOFF": " 0 0 1"}[head]
        rows = [head, *["# note", ""] * notes, f"8 {len(faces)} 12"]
        rows += [" ".join(map(repr, v)) + more for v in BOX.tolist()]
        rows += [" ".join(map(str, (len(f), *f))) + (" 0.1 0.2 0.3  # face" if notes else "") for f in faces]
        yield f"off-{head}-{shape}-{notes}", {"m.off": ("\n".join(rows) + "\n").encode()}, BOX[np.array(fans(faces))]


def gltf_document(
    mode: int, index: str, place: str, sparse: bool, woven: bool
) -> tuple[dict[str, Any], bytes, Corners]:
    """A document whose one buffer follows apart, and the triangles of its scene."""
    points = BOX.astype("<f4")
    if mode == 4:
        order = np.array(TRIANGLES).ravel()
        triangles = order.reshape(-1, 3)
    elif mode == 5:
        order = np.array([0, 1, 2, 3, 6, 7, 4, 5])
        triangles = np.array([order[[i, i + 1 + i % 2, i + 2 - i % 2]] for i in range(6)])
    else:
        order = np.array([0, 1, 3, 2, 6, 4, 5])
        triangles = np.array([[order[0], order[i], order[i + 1]] for i in range(1, 6)])
    moved = points.astype(float)
    if index == "none":
        points, triangles = points[order], np.searchsorted(np.arange(len(order)), np.arange(len(order)))
        moved = points.astype(float)
        span = len(order)
        triangles = (
            np.arange(span).reshape(-1, 3) if mode == 4
            else np.array([[i, i + 1 + i % 2, i + 2 - i % 2] for i in range(span - 2)]) if mode == 5
            else np.array([[0, i, i + 1] for i in range(1, span - 1)])
        )  # fmt: skip
    parts: list[bytes] = []
    views: list[dict[str, Any]] = []

    def view(content: bytes, **more: Any) -> int:
        start = sum(map(len, parts))
        views.append({"buffer": 0, "byteOffset": start, "byteLength": len(content), **more})
        parts.append(content + b"\0" * (-len(content) % 4))
        return len(views) - 1

    if woven:
        rows = np.concatenate([points, np.zeros((len(points), 2), "<f4")], axis=1).astype("<f4").tobytes()
        position = {"bufferView": view(rows, byteStride=20)}
    else:
        position = {"bufferView": view(points.tobytes())}
    position |= {"componentType": 5126, "count": len(points), "type": "VEC3"}
    if sparse:
        moved[1] = [0.75, -0.5, 1.0]
        position["sparse"] = {
            "count": 1, "indices": {"bufferView": view(struct.pack("<H", 1)), "componentType": 5123},
            "values": {"bufferView": view(moved[1].astype("<f4").tobytes())},
        }  # fmt: skip
    accessors = [position]
    primitive: dict[str, Any] = {"attributes": {"POSITION": 0}, "mode": mode}
    if index != "none":
        kind = {"u1": 5121, "u2": 5123, "u4": 5125}[index]
        held = view(order.astype(f"<{index}").tobytes())
        accessors.append({"bufferView": held, "componentType": kind, "count": len(order), "type": "SCALAR"})
        primitive["indices"] = 1
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    nodes: list[dict[str, Any]] = {
        "plain": [{"mesh": 0}],
        "trs": [{"mesh": 0, "translation": [1, 2, 3], "rotation": [0, 0, 0.5**0.5, 0.5**0.5], "scale": [1, 2, 3]}],
        "matrix": [{"mesh": 0, "matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 5, 0, 0, 1]}],
        "nested": [{"children": [1], "translation": [0, 0, 2]}, {"mesh": 0, "scale": [-1, 1, 1]}, {"mesh": 0}],
    }[place]
    expected = {
        "plain": moved, "trs": (moved * [1, 2, 3]) @ turn.T + [1, 2, 3], "matrix": moved @ turn.T + [5, 0, 0],
        "nested": moved * [-1, 1, 1] + [0, 0, 2],
    }[place]  # fmt: skip
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": nodes,
        "meshes": [{"primitives": [primitive]}], "accessors": accessors, "bufferViews": views,
        "buffers": [{"byteLength": sum(map(len, parts))}],
    }  # fmt: skip
    return document, b"".join(parts), expected[triangles]


def packed(document: dict[str, Any], buffer: bytes, box: str) -> dict[str, bytes]:
    """The document as .gltf with its data inside or beside, or as .glb."""
    if box == "glb":
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + 8 + len(buffer)
        head = struct.pack("<4sII", b"glTF", 2, size) + struct.pack("<I4s", len(text), b"JSON") + text
        return {"m.glb": head + struct.pack("<I4s", len(buffer), b"BIN\0") + buffer}
    named = "data:application/octet-stream;base64," + base64.b64encode(buffer).decode()
    document["buffers"][0]["uri"] = named if box == "inside" else "a%20part.bin"
    return {"m.gltf": json.dumps(document).encode("utf-8-sig" if box == "inside" else "utf-8")} | (
        {} if box == "inside" else {"a part.bin": buffer}
    )


def gltf_files() -> Iterator[Case]:
    for box, mode, index, place in itertools.product(
        ("glb", "inside", "beside"), (4, 5, 6), ("none", "u1", "u2", "u4"), ("plain", "trs", "matrix", "nested")
    ):
        document, buffer, corners = gltf_document(mode, index, place, sparse=False, woven=mode == 5)
        yield f"gltf-{box}-{mode}-{index}-{place}", packed(document, buffer, box), corners
    for box, place in itertools.product(("glb", "inside", "beside"), ("plain", "trs")):
        document, buffer, corners = gltf_document(4, "u2", place, sparse=True, woven=False)
        yield f"gltf-sparse-{box}-{place}", packed(document, buffer, box), corners


def threemf_files() -> Iterator[Case]:
    space = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in BOX.tolist())
    faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in TRIANGLES)
    whole = f'<object id="1"><mesh><vertices>{vertices}</vertices><triangles>{faces}</triangles></mesh></object>'
    corners = BOX[np.array(TRIANGLES)]
    move = 'transform="0 1 0 -1 0 0 0 0 1 2 3 4"'  # rows times matrix: x → y, y → −x, then (2, 3, 4)
    turned = corners @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) + [2, 3, 4]
    builds = {
        "plain": ("", '<item objectid="1"/>', corners),
        "moved": ("", f'<item objectid="1" {move}/>', turned),
        "two": ("", f'<item objectid="1"/><item objectid="1" {move}/>', np.concatenate([corners, turned])),
        "parts": (
            f'<object id="2"><components><component objectid="1" {move}/></components></object>',
            '<item objectid="2" transform="2 0 0 0 2 0 0 0 2 0 0 1"/>', turned * 2 + [0, 0, 1],
        ),
    }  # fmt: skip
    for (name, (more, build, expected)), way in itertools.product(
        builds.items(), (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
    ):
        model = f'<?xml version="1.0"?><model unit="millimeter" xmlns="{space}"><resources>{whole}{more}</resources>'
        model += f"<build>{build}</build></model>"
        relation = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
        links = '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship '
        links += f'Target="/3D/part.model" Id="r" Type="{relation}"/></Relationships>'
        held = io.BytesIO()
        with zipfile.ZipFile(held, "w", way) as package:
            package.writestr("_rels/.rels", links)
            package.writestr("3D/part.model", model)
        yield f"3mf-{name}-{way}", {"m.3mf": held.getvalue()}, expected


def gzipped() -> Iterator[Case]:
    for source in (obj_files, ply_files, stl_files, off_files, gltf_files, threemf_files):
        name, files, corners = next(iter(source()))
        first = next(iter(files))
        yield f"{name}-gz", {f"{first}.gz": gzip.compress(files[first])}, corners


def corpus() -> list[Case]:
    """All files, every name once."""
    sources = (obj_files, ply_files, stl_files, off_files, gltf_files, threemf_files, gzipped)
    return [case for source in sources for case in source()]
