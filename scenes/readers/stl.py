"""STL, binary or ASCII (3D Systems, StereoLithography Interface Specification, 1989)."""

from __future__ import annotations

import re

import numpy as np

from .surface import Fetch, Surface
from .text import decoded, number_of

__all__ = ["read_stl"]

_HEADER, _RECORD = 84, 50


def read_stl(content: bytes, fetch: Fetch) -> Surface:
    """The triangles of an STL file. ValueError where it holds fewer than it tells. Bytes behind the last one are left."""
    count = int.from_bytes(content[80:_HEADER], "little") if len(content) >= _HEADER else -1
    exact = count >= 0 and len(content) == _HEADER + _RECORD * count
    if not exact and re.match(rb"\s*solid\b", content, re.IGNORECASE) and b"\0" not in content[:_HEADER]:
        return _ascii(decoded(content))
    if count < 0:
        raise ValueError(f"{len(content)} bytes are no STL file")
    if len(content) < _HEADER + _RECORD * count:
        raise ValueError(f"it tells of {count} triangles, and ends after {(len(content) - _HEADER) // _RECORD}")
    layout = np.dtype([("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("more", "<u2")])
    corner = np.frombuffer(content, layout, count, _HEADER)["corner"].astype(np.float64)
    return Surface(corner.reshape(-1, 3), np.arange(3 * count, dtype=np.int64).reshape(-1, 3))


def _ascii(text: str) -> Surface:
    points: list[tuple[float, ...]] = []
    inside, loop = False, -1
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        word = words[0].lower() if words else ""
        if word == "solid":
            inside = True
        elif word == "endsolid":
            inside = False
        elif word == "outer":
            loop = 0
        elif word == "vertex":
            if len(words) < 4 or loop < 0:
                raise ValueError(f"line {number}: a vertex needs three numbers, inside a loop")
            points.append(tuple(number_of(value, number) for value in words[1:4]))
            loop += 1
        elif word == "endloop":
            if loop != 3:
                raise ValueError(f"line {number}: a facet has {loop} corners, not 3")
            loop = -1
        elif word and word not in ("facet", "endfacet"):
            raise ValueError(f"line {number}: {words[0][:40]!r} is not part of STL")
    if inside:
        raise ValueError("it ends before endsolid")
    return Surface(
        np.array(points, dtype=np.float64).reshape(-1, 3), np.arange(len(points), dtype=np.int64).reshape(-1, 3)
    )
