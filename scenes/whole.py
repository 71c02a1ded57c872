"""The one check of what a scene names: meshes, grids and textures in files. `scenes show` and `generate` both call it."""

from __future__ import annotations

from .meshes import MeshArrays, load_grid, mesh_uv, shape_mesh
from .possible import check_possible, check_solid
from .scene import Scene, TargetObject
from .shapes import HeightGrid, MeshFile
from .textures import load_texture

__all__ = ["check_whole", "object_mesh", "place_of"]


def place_of(scene: Scene, item: TargetObject) -> str:
    """What messages call an object of a scene."""
    return f"{scene.name}: target.{item.name}"


def object_mesh(scene: Scene, item: TargetObject) -> MeshArrays:
    """Triangles of an object that is no sphere. Raises InputError: as `shape_mesh`, or camera or laser inside of it."""
    named = ".file" if isinstance(item.shape, HeightGrid | MeshFile) else ""
    vertices, faces = shape_mesh(item.shape, f"{place_of(scene, item)}.shape{named}")
    check_solid(scene, item, vertices, faces)
    return vertices, faces


def check_whole(scene: Scene) -> None:
    """Refuse a scene whose files are absent, damaged or empty, or put a solid around the camera.

    Raises:
        InputError: as `check_possible`, `object_mesh` and `load_texture`.
    """
    check_possible(scene)
    for item in scene.target:
        where = place_of(scene, item)
        if isinstance(item.shape, MeshFile):
            object_mesh(scene, item)
        elif isinstance(item.shape, HeightGrid):
            load_grid(item.shape.file, f"{where}.shape.file")
        if item.texture is not None:
            load_texture(item.texture, f"{where}.texture")
            if isinstance(item.shape, MeshFile):
                mesh_uv(item.shape, f"{where}.shape.file")
