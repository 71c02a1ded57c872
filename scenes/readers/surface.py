"""What every reader gives: corners, triangles and texture coordinates, just as the file has them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["EACH_PART", "Budget", "Fetch", "Surface", "joined", "triangles_of"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

#: The content of a file that a mesh file names, by its name as it stands there. ValueError where there is none.
Fetch = Callable[[str], bytes]

#: Corners that are tried as ears, times the corners that are left: ten seconds. Each costs as much as some hundred corners.
_MOST_CUTS, _EACH = 10**8, 500
_CROSSED = "a face crosses itself, so that its inside is not defined"


@dataclass(frozen=True)
class Surface:
    """`vertices` (n, 3) in the file's unit, `faces` (m, 3) indices into them, `uv` (n, 2): u to the right, v downward; None
    where the file has none, NaN at vertices that have none."""

    vertices: Float
    faces: Int
    uv: Float | None = None


#: What a part costs of a `Budget` beside its corners: it takes some hundred times the time of a corner.
EACH_PART = 500


class Budget:
    """A bound on what a small file can ask for: parts that are used many times over, polygons that take long to cut."""

    def __init__(self, most: int = 2**24, what: str = "its parts, used again and again, have too many corners") -> None:
        self._left, self._what = most, what

    def spend(self, amount: int) -> None:
        """Take `amount` of it. Raises ValueError where nothing is left."""
        self._left -= amount
        if self._left < 0:
            raise ValueError(self._what)


def joined(parts: Sequence[Surface]) -> Surface:
    """One surface of several. Texture coordinates are kept where any part has some."""
    if not parts:
        return Surface(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    uv = None
    if any(part.uv is not None for part in parts):
        uv = np.concatenate([np.full((len(p.vertices), 2), np.nan) if p.uv is None else p.uv for p in parts])
    return Surface(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)]),
        uv,
    )


def triangles_of(polygons: Sequence[Sequence[int]], vertices: Float) -> tuple[Int, Int]:
    """Triangles of polygons, and the places of their corners: (m, 3) vertex indices; (m, 3) indices into the concatenated
    corners of all polygons.

    A convex polygon is a fan about its first corner; another is cut ear by ear (Meisters, American Mathematical Monthly 82:648,
    1975) in the plane of its mean normal (Newell's). Polygons of one or two corners have no area, and give nothing.
    """
    sizes = np.array([len(p) for p in polygons], dtype=np.int64)
    flat = np.array([i for p in polygons for i in p], dtype=np.int64)
    if flat.size and (flat.min() < 0 or flat.max() >= len(vertices)):
        raise ValueError("a face names a vertex that the file does not have")
    starts = np.cumsum(sizes) - sizes
    found = []
    budget = Budget(_MOST_CUTS, "its concave polygons have too many corners to be cut; cut them into triangles first")
    for size in np.unique(sizes[sizes >= 3]):
        first = starts[sizes == size]
        corner = first[:, None] + np.arange(size)
        fan = np.stack(
            [np.stack([corner[:, 0], corner[:, k], corner[:, k + 1]], axis=1) for k in range(1, size - 1)], axis=1
        )
        convex = np.ones(len(first), dtype=bool) if size == 3 else _convex(vertices[flat[corner]])
        rows = [fan[convex].reshape(-1, 3)]
        rows += [_ears(vertices[flat[c]], budget) + c[0] for c in corner[~convex]]
        order = np.concatenate([np.repeat(first[convex], size - 2), *(np.full(len(r), r.min()) for r in rows[1:])])
        found.append((order, np.concatenate(rows)))
    if not found:
        return np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3), dtype=np.int64)
    order = np.concatenate([o for o, _ in found])
    places = np.concatenate([p for _, p in found])[np.argsort(order, kind="stable")]
    return flat[places], places


def _flattened(points: Float) -> Float:
    """Polygons (..., k, 3) in their own planes (..., k, 2): along the two axes that their mean normal is furthest from."""
    after = np.roll(points, -1, axis=-2)
    normal = np.cross(points, after).sum(axis=-2)
    size = np.ptp(points, axis=-2)
    # A polygon that crosses itself may have no mean normal: then the axis along which it is thinnest.
    flat = np.abs(normal).max(axis=-1) <= 1e-12 * size.max(axis=-1) ** 2
    axis = np.where(flat, size.argmin(axis=-1), np.abs(normal).argmax(axis=-1))
    sign = np.where(np.take_along_axis(normal, axis[..., None], axis=-1) < 0, -1.0, 1.0)
    x = np.take_along_axis(
        points, ((axis + 1) % 3)[..., None, None] * np.ones_like(points[..., :1], dtype=int), axis=-1
    )
    y = np.take_along_axis(
        points, ((axis + 2) % 3)[..., None, None] * np.ones_like(points[..., :1], dtype=int), axis=-1
    )
    return np.concatenate([x * sign[..., None], y], axis=-1)


def _convex(points: Float) -> NDArray[np.bool_]:
    """Whether polygons (n, k, 3) turn to one side only."""
    flat = _flattened(points)
    step = np.roll(flat, -1, axis=1) - flat
    after = np.roll(step, -1, axis=1)
    turn = step[..., 0] * after[..., 1] - step[..., 1] * after[..., 0]
    return np.asarray((turn >= -1e-12 * np.abs(turn).max(axis=1, keepdims=True)).all(axis=1))


def _ears(points: Float, budget: Budget) -> Int:
    """Triangles (k − 2, 3) of one polygon (k, 3), by its corners' numbers."""
    flat = _flattened(points)
    left = np.arange(len(flat))
    out = []
    while len(left) > 3:
        best = next((i for i in range(len(left)) if _is_ear(flat, left, i, budget)), None)
        if best is None:
            raise ValueError(_CROSSED)
        out.append((left[best - 1], left[best], left[(best + 1) % len(left)]))
        left = np.delete(left, best)
    a, b, c = (flat[k] for k in left)
    if (
        _cross(b - a, c - a) < -1e-12 * np.ptp(flat, axis=0).max() ** 2
    ):  # what is left of a polygon turns as the whole does
        raise ValueError(_CROSSED)
    return np.array([*out, tuple(left)], dtype=np.int64)


def _is_ear(flat: Float, left: Int, i: int, budget: Budget) -> bool:
    budget.spend(_EACH + len(left))
    a, b, c = flat[left[i - 1]], flat[left[i]], flat[left[(i + 1) % len(left)]]
    if _cross(b - a, c - a) <= 0:
        return False
    p = flat[left]
    p = p[~np.any([(p == corner).all(axis=1) for corner in (a, b, c)], axis=0)]
    inside = (_cross(b - a, p - a) >= 0) & (_cross(c - b, p - b) >= 0) & (_cross(a - c, p - c) >= 0)
    return not bool(np.any(inside))


def _cross(a: Float, b: Float) -> Float:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
