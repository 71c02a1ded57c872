"""OFF, the Object File Format of Geomview (its manual, "OFF Files"): text, in three dimensions."""

from __future__ import annotations

import re

import numpy as np

from .surface import Fetch, Surface, triangles_of
from .text import decoded, number_of

__all__ = ["read_off"]


def read_off(content: bytes, fetch: Fetch) -> Surface:
    """The faces of an OFF file; normals, colours and texture coordinates are left. ValueError for another form."""
    rows = [(n, line.split("#", 1)[0].split()) for n, line in enumerate(decoded(content).splitlines(), 1)]
    rows = [(number, words) for number, words in rows if words]
    head = re.fullmatch(r"(ST)?(C)?(N)?(4)?(n)?OFF", rows[0][1][0]) if rows else None
    if head is None:
        raise ValueError("it does not begin with OFF")
    if head[4] or head[5] or "BINARY" in rows[0][1]:
        raise ValueError(f"{' '.join(rows[0][1])[:40]} is not read: only text, in three dimensions, is")
    counts = rows[0][1][1:] or rows.pop(1)[1] if len(rows) > 1 else []
    body = rows[1:]
    if len(counts) < 2 or not all(word.isdigit() for word in counts[:2]):
        raise ValueError("it does not tell how many vertices and faces it has")
    vertices, faces = int(counts[0]), int(counts[1])
    if len(body) < vertices + faces:
        raise ValueError(f"it tells of {vertices} vertices and {faces} faces, and ends after {len(body)} of both")
    points = [[number_of(word, number) for word in words[:3]] for number, words in body[:vertices]]
    if any(len(point) < 3 for point in points):
        raise ValueError("a vertex has fewer than three numbers")
    polygons = []
    for number, words in body[vertices : vertices + faces]:
        size = int(words[0]) if words[0].isdigit() else -1
        corners = words[1 : size + 1]
        if size < 1 or len(corners) < size or not all(word.isdigit() for word in corners):
            raise ValueError(f"line {number}: no face: {' '.join(words)[:40]!r}")
        polygons.append([int(word) for word in corners])
    table = np.array(points, dtype=np.float64).reshape(-1, 3)
    return Surface(table, triangles_of(polygons, table)[0])
