"""Rocks: star-shaped bodies with lumps and flat faces, lying on the ground."""

from __future__ import annotations

import numpy as np

from .ground import ground_of
from .solids import Pieces, Triangles, icosphere, random_turn
from .spec import BURIED, Rocks

__all__ = ["build_rocks", "rock"]

_WAVES, _CUTS = 10, 7
#: More rocks than this have a quarter of the faces each.
_FINE_ROCKS = 10


def build_rocks(shape: Rocks, rng: np.random.Generator, pieces: Pieces) -> None:
    """The ground is instance 0, each rock one more."""
    ground = ground_of(shape, rng)
    pieces.add(ground.mesh(), 0)
    sphere = icosphere(3 if shape.rocks <= _FINE_ROCKS else 2)
    for number in range(shape.rocks):
        vertices, faces = rock(sphere, shape.roughness, rng)
        diameter = rng.uniform(*shape.diameter_m)
        vertices = 0.5 * diameter * vertices
        room = 0.5 * np.asarray(shape.size_m[:2]) - 0.5 * diameter
        place = rng.uniform(-room, room)
        low = vertices[:, 2].max() - BURIED * np.ptp(vertices[:, 2])
        vertices += [*place, float(ground.at(place)) - low]
        # What would lie below the box is hidden by the ground.
        vertices[:, 2] = np.minimum(vertices[:, 2], 0.5 * shape.size_m[2])
        pieces.add((vertices, faces), number + 1)


def rock(sphere: Triangles, roughness: float, rng: np.random.Generator) -> Triangles:
    """A body within the unit ball: r(u) = min(1 + lumps, d_j/(n_j·u)), scaled, along each direction u of a sphere's corners.

    Each direction has one radius, so that the body is closed and does not cut itself, whatever is drawn.
    """
    direction, faces = sphere
    direction = direction @ random_turn(rng).T
    wave = rng.standard_normal((_WAVES, 3)) * np.linspace(1.5, 5.0, _WAVES)[:, None]
    weight = np.linspace(1.0, 0.4, _WAVES)
    lumps = np.cos(direction @ wave.T + rng.uniform(0.0, 2.0 * np.pi, _WAVES)) @ weight
    radius = 1.0 + roughness * lumps / np.sqrt(0.5 * np.sum(weight**2)) / 3.0
    normal = rng.standard_normal((_CUTS, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    facing = direction @ normal.T
    depth = rng.uniform(1.0 - roughness, 1.1, _CUTS)
    cut = np.where(facing > 1e-3, depth / np.maximum(facing, 1e-3), np.inf).min(axis=1)
    radius = np.maximum(np.minimum(radius, cut), 0.3)
    vertices = direction * radius[:, None] * rng.uniform([0.7, 0.7, 0.6], 1.0)
    return vertices / np.linalg.norm(vertices, axis=1).max(), faces
