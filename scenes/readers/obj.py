"""Wavefront OBJ: polygons of vertices with texture coordinates (Wavefront Advanced Visualizer, appendix B1)."""

from __future__ import annotations

import numpy as np

from .surface import Fetch, Surface, triangles_of
from .text import decoded, number_of

__all__ = ["read_obj"]

#: Statements that change nothing of the triangles: names, normals, looks, lines and points.
_NO_AREA = {
    "vn", "vp", "g", "o", "s", "mg", "usemtl", "mtllib", "l", "p", "lod", "usemap", "maplib", "bevel", "c_interp", "d_interp",
    "shadow_obj", "trace_obj",
}  # fmt: skip


def read_obj(content: bytes, fetch: Fetch) -> Surface:
    """The faces of an OBJ file. ValueError for what is not in its standard, and for free-form surfaces and other files."""
    vertices: list[tuple[float, float, float]] = []
    uvs: list[tuple[float, float]] = []
    faces: list[list[int]] = []
    face_uvs: list[list[int]] = []
    for number, text in _lines(decoded(content)):
        word, *rest = text.split()
        if word == "v":
            if len(rest) < 3:
                raise ValueError(f"line {number}: a vertex needs three numbers")
            vertices.append((number_of(rest[0], number), number_of(rest[1], number), number_of(rest[2], number)))
        elif word == "vt":
            if not rest:
                raise ValueError(f"line {number}: a texture coordinate needs a number")
            uvs.append((number_of(rest[0], number), number_of(rest[1], number) if len(rest) > 1 else 0.0))
        elif word in ("f", "fo"):
            if len(rest) < 3:
                raise ValueError(f"line {number}: a face needs three corners")
            corners = [_corner(part, len(vertices), len(uvs), number) for part in rest]
            faces.append([v for v, _ in corners])
            face_uvs.append([t for _, t in corners])
        elif word not in _NO_AREA:
            raise ValueError(f"line {number}: {word[:40]!r} is not read; polygons (v, vt, f) are")
    points = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    triangles, places = triangles_of(faces, points)
    texture = np.array([t for face in face_uvs for t in face], dtype=np.int64)
    if not uvs or not (texture >= 0).any():
        return Surface(points, triangles)
    return _with_uv(points, triangles, texture[places], np.array(uvs, dtype=np.float64))


def _with_uv(points: np.ndarray, triangles: np.ndarray, texture: np.ndarray, uvs: np.ndarray) -> Surface:
    """One vertex for each pair of vertex and texture coordinate."""
    pairs = np.stack([triangles.ravel(), texture.ravel()], axis=1)
    kept, index = np.unique(pairs, axis=0, return_inverse=True)
    table = np.concatenate([np.stack([uvs[:, 0], 1.0 - uvs[:, 1]], axis=1), [[np.nan, np.nan]]])  # −1: none
    return Surface(points[kept[:, 0]], index.reshape(-1, 3).astype(np.int64), table[kept[:, 1]])


def _lines(text: str) -> list[tuple[int, str]]:
    """(number, statement) of each line that says something; a backslash at its end continues it."""
    found = []
    held, start = "", 0
    for number, line in enumerate(text.splitlines(), 1):
        plain = line.split("#", 1)[0].rstrip()
        start = start or number
        if plain.endswith("\\"):
            held += plain[:-1] + " "
            continue
        whole = (held + plain).strip()
        if whole:
            found.append((start, whole))
        held, start = "", 0
    if held.strip():
        found.append((start, held.strip()))
    return found


def _corner(part: str, vertices: int, uvs: int, line: int) -> tuple[int, int]:
    """(vertex, texture coordinate or −1) from 0 of `v`, `v/vt`, `v//vn` or `v/vt/vn`; negative ones count back."""
    words = part.split("/")
    vertex = _index(words[0], vertices, part, line)
    texture = _index(words[1], uvs, part, line) if len(words) > 1 and words[1] else -1
    return vertex, texture


def _index(word: str, count: int, part: str, line: int) -> int:
    try:
        value = int(word)
    except ValueError:
        raise ValueError(f"line {line}: {part[:40]!r} is no corner of a face") from None
    place = value - 1 if value > 0 else count + value
    if value == 0 or not place >= 0:
        raise ValueError(f"line {line}: {part[:40]!r} names what the file does not have; indices count from 1")
    if place >= count:
        raise ValueError(f"line {line}: {part[:40]!r} names what stands further down, or nowhere")
    return place
