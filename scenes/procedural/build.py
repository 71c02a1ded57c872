"""The triangles of a procedural shape, and which piece each belongs to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics.rotation import rotation_matrix
from .pipes import build_pipes
from .rocks import build_rocks
from .solids import Pieces
from .spec import Pipes, Procedural, Rocks, Terraces, Vegetation, Wreck
from .terraces import build_terraces
from .vegetation import build_vegetation
from .wreck import build_wreck

__all__ = ["ProceduralMesh", "procedural_mesh", "recipe_versions"]

#: Each recipe and the number that names its random numbers; never renumbered.
_RECIPES: dict[type[Procedural], tuple[int, Callable[[Any, np.random.Generator, Pieces], None]]] = {
    Rocks: (1, build_rocks),
    Pipes: (2, build_pipes),
    Terraces: (3, build_terraces),
    Vegetation: (4, build_vegetation),
    Wreck: (5, build_wreck),
}


def recipe_versions() -> dict[str, int]:
    """{kind: version of the recipe}: equal parameters of one version give equal triangles."""
    return {str(one.model_fields["kind"].default): one.recipe_version for one in _RECIPES}


@dataclass(frozen=True, eq=False)
class ProceduralMesh:
    """`vertices` (n, 3) [m], camera frame; `faces` (m, 3), bodies outside out, the ground toward the camera; `instance` (m):
    number of the piece that a face belongs to, from 0, of `instances`. All are read-only."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    instance: NDArray[np.int32]
    instances: int


@lru_cache(maxsize=16)
def procedural_mesh(shape: Procedural) -> ProceduralMesh:
    """The triangles of a shape: drawn by PCG64 of SeedSequence(seed, recipe), in the frame of its box, then turned and placed.

    Of a `part`, the instances are numbered from 0 again.
    """
    recipe, build = _RECIPES[type(shape)]
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence((shape.seed, recipe))))
    pieces = Pieces()
    build(shape, rng, pieces)
    vertices, faces = np.concatenate(pieces.vertices), np.concatenate(pieces.faces)
    instance = np.concatenate(pieces.instance)
    grounds = shape.steps if isinstance(shape, Terraces) else 1
    if shape.part != "all":
        own = (instance < grounds) == (shape.part == "ground")
        used, index = np.unique(faces[own], return_inverse=True)
        vertices, faces = vertices[used], index.reshape(-1, 3)
        instance = instance[own] - np.int32(0 if shape.part == "ground" else grounds)
    vertices = vertices @ rotation_matrix(shape.rotation_deg).T + np.asarray(shape.center_m)
    for array in (vertices, faces, instance):
        array.flags.writeable = False
    return ProceduralMesh(vertices, faces, instance, int(instance.max(initial=-1)) + 1)
