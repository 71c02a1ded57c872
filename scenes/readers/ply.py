"""PLY, text or binary of either byte order (G. Turk, The PLY Polygon File Format, 1994)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .surface import Fetch, Surface, triangles_of

__all__ = ["read_ply"]

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_UV = (("u", "v"), ("s", "t"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
_CORNERS = ("vertex_indices", "vertex_index")


@dataclass
class _Element:
    """An element of the header: its rows, and (name, type of the length or None, type) of each property."""

    name: str
    rows: int
    properties: list[tuple[str, str | None, str]] = field(default_factory=list)


def read_ply(content: bytes, fetch: Fetch) -> Surface:
    """The faces and strips of a PLY file. ValueError for a header that is not PLY's, and where the file ends early."""
    order, elements, start = _header(content)
    data = _Words(content[start:], elements) if order == "" else _Bytes(content, start, order)
    tables = {element.name: _table(data, element) for element in elements}
    vertex = tables.get("vertex")
    if vertex is None or any(axis not in vertex for axis in "xyz"):
        raise ValueError("it has no vertices with x, y and z")
    points = np.stack([np.asarray(vertex[axis], dtype=np.float64) for axis in "xyz"], axis=1)
    uv = next((np.stack([vertex[u], 1.0 - vertex[v]], axis=1) for u, v in _UV if u in vertex and v in vertex), None)
    face = tables.get("face", {})
    corners: Any = next((face[name] for name in _CORNERS if name in face), [])
    polygons = [list(map(int, row)) for row in corners] + list(_strips(tables.get("tristrips", {})))
    triangles, places = triangles_of(polygons, points)
    wedge = face.get("texcoord")
    if uv is None and wedge is not None and all(len(w) == 2 * len(c) for w, c in zip(wedge, corners, strict=True)):
        flat = np.concatenate([np.asarray(w, dtype=np.float64) for w in wedge]).reshape(-1, 2)[places.ravel()]
        each = np.arange(triangles.size, dtype=np.int64).reshape(-1, 3)
        return Surface(points[triangles.ravel()], each, np.stack([flat[:, 0], 1.0 - flat[:, 1]], axis=1))
    return Surface(points, triangles, None if uv is None else uv.astype(np.float64))


def _header(content: bytes) -> tuple[str, list[_Element], int]:
    if content[:3] != b"ply":
        raise ValueError("it does not begin with ply")
    end = content.find(b"end_header")
    if end < 0:
        raise ValueError("its header does not end")
    start = content.find(b"\n", end) + 1 or len(content)
    if content[end + 10 : end + 11] == b"\r" and content[end + 11 : end + 12] != b"\n":
        start = end + 11  # lines that end in a carriage return alone
    order: str | None = None
    elements: list[_Element] = []
    for line in content[:end].decode("latin-1").replace("\r", "\n").split("\n"):
        match line.split():
            case ["format", kind, *_] if kind in _ORDERS:
                order = _ORDERS[kind]
            case ["element", name, rows] if rows.isdigit():
                elements.append(_Element(name, int(rows)))
            case ["property", "list", length, kind, name] if elements and length in _TYPES and kind in _TYPES:
                elements[-1].properties.append((name, _TYPES[length], _TYPES[kind]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append((name, None, _TYPES[kind]))
            case [] | ["ply"] | ["comment", *_] | ["obj_info", *_]:
                pass
            case _:
                raise ValueError(f"its header says {line.strip()[:60]!r}")
    if order is None:
        raise ValueError("its header names no format")
    return order, elements, start


class _Words:
    """The numbers of a text body, one after the other."""

    def __init__(self, body: bytes, elements: list[_Element]) -> None:
        try:
            self.values = np.array(body.split(), dtype=np.float64)
        except ValueError as error:
            raise ValueError(f"its body holds what is no number: {error}") from None
        self.at = 0

    def take(self, kind: str, count: int) -> Any:
        """The next `count` numbers."""
        found = self.values[self.at : self.at + count]
        if len(found) < count:
            raise EOFError
        self.at += count
        return found

    def rows(self, kinds: list[str], count: int) -> Any:
        """`count` rows of plain numbers, (count, n)."""
        return self.take("", len(kinds) * count).reshape(count, len(kinds)).T


class _Bytes:
    """The numbers of a binary body."""

    def __init__(self, content: bytes, start: int, order: str) -> None:
        self.content, self.at, self.order = content, start, order

    def take(self, kind: str, count: int) -> Any:
        """The next `count` numbers of a type."""
        layout = np.dtype(self.order + kind)
        if self.at + layout.itemsize * count > len(self.content):
            raise EOFError
        found = np.frombuffer(self.content, layout, count, self.at)
        self.at += layout.itemsize * count
        return found

    def rows(self, kinds: list[str], count: int) -> Any:
        """`count` rows of plain numbers, one array for each column."""
        layout = np.dtype([(f"p{i}", self.order + kind) for i, kind in enumerate(kinds)])
        if self.at + layout.itemsize * count > len(self.content):
            raise EOFError
        found = np.frombuffer(self.content, layout, count, self.at)
        self.at += layout.itemsize * count
        return [found[f"p{i}"] for i in range(len(kinds))]


def _table(data: Any, element: _Element) -> dict[str, Any]:
    """Columns of an element: arrays of plain properties, lists of arrays of list properties."""
    names = [name for name, _, _ in element.properties]
    if not any(length for _, length, _ in element.properties):
        try:
            columns = data.rows([kind for _, _, kind in element.properties], element.rows)
        except EOFError:
            raise ValueError(f"it ends within its {element.rows} rows of {element.name!r}") from None
        return dict(zip(names, columns, strict=True))
    lists: list[list[Any]] = [[] for _ in names]
    for row in range(element.rows):
        try:
            for column, (_, length, kind) in zip(lists, element.properties, strict=True):
                size = 1 if length is None else int(data.take(length, 1)[0])
                if size < 0:
                    raise ValueError(f"a list of {element.name!r} has {size} items")
                found = data.take(kind, size)
                column.append(found[0] if length is None else found)
        except EOFError:
            raise ValueError(f"it ends after {row} of {element.rows} rows of {element.name!r}") from None
    return dict(zip(names, lists, strict=True))


def _strips(table: dict[str, Any]) -> Iterator[list[int]]:
    """Triangles of strips, in which −1 begins anew and every second triangle is turned."""
    for strip in next((table[name] for name in _CORNERS if name in table), []):
        last: list[int] = []
        turned = False
        for corner in map(int, strip):
            if corner < 0:
                last, turned = [], False
                continue
            last = [*last[-2:], corner]
            if len(last) == 3:
                a, b, c = last
                yield [b, a, c] if turned else [a, b, c]
                turned = not turned
