"""A mesh file's triangles: checked, merged, turned alike and scaled to one; and the unit of its coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import InputError
from .kept import Kept
from .readers.mesh_file import read_mesh_file
from .readers.surface import Surface
from .shapes import MeshFile

__all__ = ["METRES", "MeshSurface", "check_unit", "read_surface"]

#: Metres of each unit.
METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
#: A mesh is this many times larger than its distance at most, and smaller at most, unless its unit is wrong.
_FAR_TOO_LARGE, _FAR_TOO_SMALL = 50.0, 1e-3
#: A face has an area if its height is more than this share of its longest edge.
_FLAT = 1e-12
#: Corners nearer than this share of the mesh's largest extent are one.
_SAME = 1e-8


@dataclass(frozen=True)
class MeshSurface(Surface):
    """A surface centred on the bounds of what has an area, with a largest extent of 1. `extent`, `middle` (3): its largest
    extent and the middle of its bounds, in the file's unit."""

    extent: float = 1.0
    middle: NDArray[np.float64] | tuple[float, float, float] = (0.0, 0.0, 0.0)


def check_unit(shape: MeshFile, extent: float, where: str) -> None:
    """Refuse a mesh whose unit makes it far larger or smaller than its distance from the camera. Raises InputError."""
    if shape.unit is None:
        return
    size, distance = extent * METRES[shape.unit], float(np.linalg.norm(shape.center_m))
    if distance <= 0 or _FAR_TOO_SMALL <= size / distance <= _FAR_TOO_LARGE:
        return
    large = size > distance
    raise InputError(
        f"The mesh is far {'larger' if large else 'smaller'} than its distance.", where=f"{where.removesuffix('.file')}.unit",
        value=f"{shape.unit}: {size:.4g} m large, {distance:.4g} m away",
        allowed=f"{_FAR_TOO_SMALL:g} to {_FAR_TOO_LARGE:g} times its distance",
        next_step=f"{_likely(shape.unit, extent, distance)}or give its largest extent, size_m, instead of unit",
    )  # fmt: skip


def _likely(unit: str, extent: float, distance: float) -> str:
    """A hint at the usual unit that makes the mesh as large as what is seen from its distance."""
    for other in ("mm", "m", "cm", "in", "um", "ft"):
        if 0.02 <= extent * METRES[other] / distance <= 5.0:
            times = METRES[unit] / METRES[other]
            wrong = f"{times:.4g} times too large" if times > 1 else f"{1 / times:.4g} times too small"
            return f'{wrong}: unit = "{other}"? '
    return ""


#: Meshes are read before a capture, to be checked, and again for their triangles and texture coordinates.
_READ: Kept[MeshSurface] = Kept()


def read_surface(path: Path, name: str, where: str) -> MeshSurface:
    """The triangles of a file, with equal corners merged and all faces of one body turned alike.

    Main arguments:
        path: the file. name: it as the scene names it, for messages.

    Raises:
        InputError: not such a file, without triangles or area, or with corners that are not there or not finite.
    """
    return _READ.of(path, lambda: _checked(path, name, where))


def _checked(path: Path, name: str, where: str) -> MeshSurface:
    found = read_mesh_file(path, where)
    if len(found.faces) == 0:
        raise InputError("The mesh is empty.", where=where, value=name, allowed="at least one triangle")
    if found.faces.min() < 0 or found.faces.max() >= len(found.vertices):
        raise InputError("A face of the mesh names a vertex that it does not have.", where=where, value=name)
    if not np.isfinite(found.vertices[found.faces]).all():
        raise InputError("A corner of the mesh is not a finite number.", where=where, value=name)
    faces = _with_area(found)
    if len(faces) == 0:
        raise InputError("The mesh has no area.", where=where, value=name, allowed="a triangle with an area")
    used, index = np.unique(faces, return_inverse=True)
    corners = found.vertices[used]
    low, high = corners.min(axis=0), corners.max(axis=0)
    extent, middle = float((high - low).max()), (low + high) / 2
    # Scale before anything is compared or merged: the unit of the file must not matter.
    uv = None if found.uv is None else found.uv[used]
    made = _merged((corners - middle) / extent, index.reshape(-1, 3).astype(np.int64), uv)
    for array in (made.vertices, made.faces, *(() if made.uv is None else (made.uv,))):
        array.flags.writeable = False  # it is kept for the next reader
    return MeshSurface(made.vertices, made.faces, made.uv, extent, middle)


def _with_area(found: Surface) -> NDArray[np.int64]:
    """The faces that have an area: others cannot be hit, and must not count for the bounds."""
    a, b, c = (found.vertices[found.faces[:, i]] for i in range(3))
    longest = np.max([np.linalg.norm(e, axis=1) for e in (b - a, c - b, a - c)], axis=0)
    scale = np.where(longest > 0, longest, 1.0)[:, None]
    area = np.linalg.norm(np.cross((b - a) / scale, (c - a) / scale), axis=1)
    return np.asarray(found.faces[(longest > 0) & (area > _FLAT)])


def _merged(unit: NDArray[np.float64], faces: NDArray[np.int64], uv: NDArray[np.float64] | None) -> Surface:
    import trimesh

    places = np.round(unit / _SAME)
    _, position = np.unique(places, axis=0, return_inverse=True)
    joint = position.reshape(-1)[faces]
    body = trimesh.Trimesh(np.zeros((int(joint.max()) + 1, 3)), joint, process=False)
    body.vertices[joint.ravel()] = unit[faces.ravel()]
    trimesh.repair.fix_normals(body)  # type: ignore[no-untyped-call]
    turned = np.asarray(body.faces)[:, 0] != joint[:, 0]
    faces = np.where(turned[:, None], faces[:, ::-1], faces)
    keys = places if uv is None else np.concatenate([places, uv], axis=1)
    _, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return Surface(unit[first], index.reshape(-1)[faces], None if uv is None else uv[first])
