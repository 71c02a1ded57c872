"""Triangles of simple bodies, closed and outside out, and their collection into pieces that are told apart."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray

__all__ = ["Pieces", "Triangles", "box", "cylinder", "icosphere", "prism", "random_turn", "ribbons", "tube"]

Float = NDArray[np.float64]
Index = NDArray[np.int64]
#: Vertices (n, 3) [m]; faces (m, 3), counter-clockwise seen from outside.
Triangles = tuple[Float, Index]

_QUADS = np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])


@dataclass
class Pieces:
    """Bodies that become one mesh: `add` gives them the number of an instance, which every face keeps."""

    vertices: list[Float] = field(default_factory=list)
    faces: list[Index] = field(default_factory=list)
    instance: list[NDArray[np.int32]] = field(default_factory=list)
    count: int = 0

    def add(self, body: Triangles, number: int) -> None:
        """Add a body to instance `number`."""
        self.vertices.append(body[0])
        self.faces.append(body[1] + self.count)
        self.instance.append(np.full(len(body[1]), number, np.int32))
        self.count += len(body[0])


def prism(base: Float, top: Float) -> Triangles:
    """A hexahedron of four corners each (4, 3), counter-clockwise seen from the top, the side that `top` is on."""
    quads = _QUADS
    return np.concatenate([base, top]), np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def box(size: tuple[float, float, float] | Float) -> Triangles:
    """A cuboid about the origin, its sides along the axes."""
    x, y, z = 0.5 * np.asarray(size, dtype=np.float64)
    base = np.array([[-x, -y, -z], [x, -y, -z], [x, y, -z], [-x, y, -z]])
    return prism(base, base * [1.0, 1.0, -1.0])


def tube(path: Float, radius: Float, sides: int, across: Float) -> Triangles:
    """A closed tube around a path (n, 3), of a radius (n) at each point; `across` (n, 3) is nowhere along the path, and keeps
    the rings from twisting. Its ends are flat."""
    along = np.gradient(path, axis=0)
    first = _square(along, across)
    second = _square(along, first)
    cos, sin, faces = _round(len(path), sides)
    points = path[:, None] + np.asarray(radius)[:, None, None] * (cos * first[:, None] + sin * second[:, None])
    return np.concatenate([points.reshape(-1, 3), path[:1], path[-1:]]), faces


def _square(a: Float, b: Float) -> Float:
    """Unit vectors along a × b (n, 3)."""
    ax, ay, az = a.T
    bx, by, bz = b.T
    product = np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)
    return np.asarray(product / np.sqrt(np.einsum("ni,ni->n", product, product))[:, None])


@cache
def _round(n: int, sides: int) -> tuple[Float, Float, Index]:
    """Cosine and sine (1, sides, 1) around a tube of n rings, and its faces with both ends."""
    angle = 2.0 * np.pi * np.arange(sides)[None, :, None] / sides
    at = np.arange(n * sides).reshape(n, sides)
    a, b, c, d = at[:-1], np.roll(at, -1, axis=1)[:-1], np.roll(at, -1, axis=1)[1:], at[1:]
    walls = [np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    start, end = at[0], at[-1]
    caps = [
        np.stack([np.full(sides, n * sides), np.roll(start, -1), start], axis=-1),
        np.stack([np.full(sides, n * sides + 1), end, np.roll(end, -1)], axis=-1),
    ]
    return np.cos(angle), np.sin(angle), np.concatenate([*walls, *caps])


def cylinder(begin: Float, end: Float, radius: float, sides: int = 20) -> Triangles:
    """A closed cylinder between two points."""
    path = np.stack([begin, end])
    along = np.abs(end - begin)
    return tube(path, np.full(2, radius), sides, np.tile(np.eye(3)[int(np.argmin(along))], (2, 1)))


def ribbons(middle: Float, width: Float, across: Float) -> Triangles:
    """Open strips along `middle` (strip, n, 3), as wide as `width` (strip, n) along unit vectors `across` (strip, 3). They are seen
    from both sides."""
    half = 0.5 * width[..., None] * across[:, None]
    count, n = width.shape
    left = (np.arange(n - 1) + n * np.arange(count)[:, None]).ravel()
    right = left + count * n
    faces = [np.stack([left, right, right + 1], axis=-1), np.stack([left, right + 1, left + 1], axis=-1)]
    return np.concatenate([(middle - half).reshape(-1, 3), (middle + half).reshape(-1, 3)]), np.concatenate(faces)


def icosphere(level: int) -> Triangles:
    """The unit sphere: 20·4^level faces, each corner split from its neighbours' midpoints."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    corners = [(-1, golden, 0), (1, golden, 0), (-1, -golden, 0), (1, -golden, 0)]
    vertices = np.array(
        [*corners, *((z, x, y) for x, y, z in corners), *((y, z, x) for x, y, z in corners)], dtype=np.float64
    )
    faces = np.array([
        [0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4], [11, 10, 2], [10, 7, 6], [7, 1, 8],
        [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8], [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1],
    ])  # fmt: skip
    for _ in range(level):
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        pairs, place = np.unique(edges, axis=0, return_inverse=True)
        middle = place.reshape(3, -1) + len(vertices)
        vertices = np.concatenate([vertices, vertices[pairs].mean(axis=1)])
        a, b, c = faces.T
        ab, bc, ca = middle
        faces = np.concatenate([np.stack(t, axis=-1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return vertices / np.linalg.norm(vertices, axis=1)[:, None], faces


def random_turn(rng: np.random.Generator) -> Float:
    """A rotation (3, 3), uniform over all: of a unit quaternion of four normal numbers (K. Shoemake, Graphics Gems III, 1992)."""
    w, x, y, z = rng.standard_normal(4)
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return np.array([
        [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
        [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
        [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
    ])  # fmt: skip
