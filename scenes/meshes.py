"""Shapes to triangle meshes: files by `readers`, turned outside out and measured by trimesh; grids become meshes here."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..optics.rotation import rotation_matrix
from .errors import InputError
from .mesh_surface import METRES, MeshSurface, check_unit, read_surface
from .nearest import did_you_mean
from .npz import read_npy, read_npz
from .procedural.build import procedural_mesh
from .procedural.spec import Procedural
from .relief import relief_heights
from .shapes import Box, HeightGrid, MeshFile, PowerLawRelief, Rectangle, Shape
from .spec_files import LIBRARY

__all__ = [
    "MeshArrays", "load_grid", "measure_shape", "mesh_uv", "read_array", "resolve_file", "shape_mesh",
]  # fmt: skip

#: Vertices (n, 3) in metres, camera frame; faces (m, 3), counter-clockwise seen from outside or from the camera.
MeshArrays = tuple[NDArray[np.float64], NDArray[np.int64]]

_MAX_FILE_BYTES = 2**31
#: Most numbers of a grid, and most of one that becomes a mesh: a node takes 150 bytes there.
_MAX_TEXELS, _MAX_NODES = 2**26, 2**24


def resolve_file(name: str, where: str) -> Path:
    """The file that a shape names: `library:NAME` lies in the library, all else is a path.

    Raises:
        InputError: a library name that is not a bare file name, or no such file.
    """
    if name.startswith("library:"):
        bare = name.removeprefix("library:")
        if Path(bare).name != bare:
            raise InputError("A library file should be named without folders.", where=where, value=name)
        path = LIBRARY / bare
    else:
        path = Path(name).expanduser()
    if not path.is_file():
        raise InputError(
            "There is no such file.", where=where, value=name, allowed="an existing mesh, grid or texture file",
            next_step=did_you_mean(path.name, _names_in(path.parent)),
        )  # fmt: skip
    if path.stat().st_size > _MAX_FILE_BYTES:
        raise InputError("The file is too large.", where=where, value=path.stat().st_size, allowed="up to 2 GiB")
    return path


def _names_in(folder: Path) -> list[str]:
    try:
        return [one.name for one in islice(folder.iterdir(), 1000) if one.is_file()]
    except OSError:
        return []


def shape_mesh(shape: Shape, where: str) -> MeshArrays:
    """Triangles of a shape (a sphere has none: it is intersected exactly).

    Raises:
        InputError: an unreadable or empty mesh or grid file.
    """
    if isinstance(shape, Rectangle):
        return _rectangle(shape)
    if isinstance(shape, Box):
        return _box(shape)
    if isinstance(shape, HeightGrid):
        return _height_grid(shape, where)
    if isinstance(shape, PowerLawRelief):
        drawn = {name: getattr(shape, name) for name in ("slope", "rms_m", "outer_m", "inner_m", "seed")}
        heights = relief_heights(shape.width_m, shape.height_m, shape.pitch_m, **drawn)
        return _grid_mesh(heights, shape.pitch_m, shape)
    if isinstance(shape, MeshFile):
        return _mesh_file(shape, where)
    if isinstance(shape, Procedural):
        drawn_mesh = procedural_mesh(shape)
        return drawn_mesh.vertices, drawn_mesh.faces
    raise TypeError(f"no mesh for {type(shape).__name__}")


def measure_shape(shape: Shape, where: str) -> dict[str, float | int | bool]:
    """Measures of a shape's triangles, by trimesh: `vertices`, `faces`, `area_m2`, `watertight`, `loose_edges` (not shared
    by exactly two faces: borders of holes, seams), and `volume_m3` where it is watertight.

    Raises:
        InputError: as `shape_mesh`.
    """
    import trimesh

    vertices, faces = shape_mesh(shape, where)
    mesh = trimesh.Trimesh(vertices, faces, process=True)
    edges = np.sort(mesh.edges, axis=1)
    _, times = np.unique(edges, axis=0, return_counts=True)
    measured: dict[str, float | int | bool] = {
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "area_m2": float(mesh.area),
        "watertight": bool(mesh.is_watertight),
        "loose_edges": int((times != 2).sum()),
    }
    if mesh.is_watertight:
        measured["volume_m3"] = float(mesh.volume)
    return measured


def _rectangle(shape: Rectangle) -> MeshArrays:
    w, h = shape.width_m / 2, shape.height_m / 2
    corners = np.array([[-w, -h, 0], [w, -h, 0], [w, h, 0], [-w, h, 0]], dtype=float)
    turned = corners @ rotation_matrix((shape.tilt_x_deg, shape.tilt_y_deg, 0.0)).T
    return turned + np.asarray(shape.center_m), np.array([[0, 2, 1], [0, 3, 2]])


def _box(shape: Box) -> MeshArrays:
    import trimesh

    box = trimesh.creation.box(extents=shape.size_m)
    vertices = np.asarray(box.vertices) @ rotation_matrix(shape.rotation_deg).T + np.asarray(shape.center_m)
    return vertices, np.asarray(box.faces, dtype=np.int64)


def read_array(name: str, where: str) -> NDArray[np.float64]:
    """Read a .npy, or a .npz with exactly one 2-D array. Pickled content is refused.

    Raises:
        InputError: not such a file, or smaller than 2 × 2.
    """
    path = resolve_file(name, where)
    grid: NDArray[Any] | None
    try:
        with open(path, "rb") as stream:
            zipped = stream.read(4) == b"PK\x03\x04"
    except OSError as error:
        raise InputError("The grid file cannot be read.", where=where, value=f"{name}: {error.strerror}") from error
    if zipped:
        arrays = [a for a in read_npz(path, "The grid file", where=where).values() if a.ndim == 2]
        grid = arrays[0] if len(arrays) == 1 else None
    else:
        grid = read_npy(path, "The grid file", where=where)
    if grid is None or grid.ndim != 2 or min(grid.shape) < 2 or not np.issubdtype(grid.dtype, np.number):
        raise InputError(
            "The file does not hold a grid of numbers.", where=where, value=name, allowed="one 2-D array, ≥ 2×2"
        )
    if grid.size > _MAX_TEXELS:
        raise InputError("The grid is too large.", where=where, value=grid.shape, allowed=f"{_MAX_TEXELS:,} numbers")
    return np.asarray(grid, dtype=np.float64)


def load_grid(name: str, where: str) -> NDArray[np.float64]:
    """Read a height grid, as `read_array`.

    Raises:
        InputError: not such a file, too small, not finite, or flat.
    """
    heights = read_array(name, where)
    if heights.size > _MAX_NODES:
        raise InputError(
            "The grid is too large for a mesh.", where=where, value=heights.shape, allowed=f"{_MAX_NODES:,} nodes"
        )
    if not np.isfinite(heights).all() or np.ptp(heights) <= 0:
        raise InputError("Heights should be finite and not all equal.", where=where, value=name)
    return heights


def _height_grid(shape: HeightGrid, where: str) -> MeshArrays:
    heights = load_grid(shape.file, where)
    relief = (heights - heights.min()) / np.ptp(heights) * shape.relief_m
    return _grid_mesh(relief, shape.width_m / (heights.shape[1] - 1), shape)


def _grid_mesh(heights: NDArray[np.float64], pitch: float, shape: HeightGrid | PowerLawRelief) -> MeshArrays:
    """Triangles of heights (row, col) [m] toward the camera at a spacing of `pitch` [m], tilted and placed as the shape says."""
    rows, cols = heights.shape
    x = (np.arange(cols) - (cols - 1) / 2) * pitch
    y = (np.arange(rows) - (rows - 1) / 2) * pitch
    vertices = np.stack([*np.meshgrid(x, y), -heights], axis=-1).reshape(-1, 3)
    vertices = vertices @ rotation_matrix((shape.tilt_x_deg, shape.tilt_y_deg, 0.0)).T + np.asarray(shape.center_m)
    index = np.arange(rows * cols).reshape(rows, cols)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, c, b), (a, d, c))])
    return vertices, faces


def mesh_uv(shape: MeshFile, where: str) -> NDArray[np.float64]:
    """Texture coordinates (vertex, 2) of a mesh file: u to the right, v downward.

    Raises:
        InputError: as `shape_mesh`, or a mesh without texture coordinates.
    """
    uv = _read_mesh(shape, where).uv
    if uv is None or not np.isfinite(uv).all():
        raise InputError("The mesh has no texture coordinates.", where=where, value=shape.file, allowed="uv per vertex")
    return uv


def _mesh_file(shape: MeshFile, where: str) -> MeshArrays:
    mesh = _read_mesh(shape, where)
    vertices = mesh.vertices * (shape.size_m or 1.0)
    if shape.unit is not None:
        scale = METRES[shape.unit]
        vertices = vertices * (mesh.extent * scale)
        check_unit(shape, mesh.extent, where)
        if shape.origin == "file":
            vertices = vertices + np.asarray(mesh.middle) * scale
    return vertices @ rotation_matrix(shape.rotation_deg).T + np.asarray(shape.center_m), mesh.faces


def _read_mesh(shape: MeshFile, where: str) -> MeshSurface:
    return read_surface(resolve_file(shape.file, where), shape.file, where)
