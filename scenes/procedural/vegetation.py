"""Vegetation: tufts of blades and branched plants that lean with the current."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .ground import ground_of
from .solids import Pieces, Triangles, ribbons, tube
from .spec import Vegetation

__all__ = ["build_vegetation"]

Float = NDArray[np.float64]

_BLADES, _PARTS = 14, 8
_LEVELS, _SIDES, _RINGS = 3, 6, 4


def build_vegetation(shape: Vegetation, rng: np.random.Generator, pieces: Pieces) -> None:
    """The ground is instance 0, each plant one more."""
    ground = ground_of(shape, rng)
    pieces.add(ground.mesh(), 0)
    current = rng.uniform(0.0, 2.0 * np.pi)
    for number in range(shape.plants):
        height = rng.uniform(*shape.height_m)
        room = 0.5 * np.asarray(shape.size_m[:2])
        place = rng.uniform(-0.95 * room, 0.95 * room)
        foot = np.array([*place, float(ground.at(place))])
        add = _tuft if rng.random() < 0.5 else _branched
        for vertices, faces in add(shape, height, current + rng.normal(0.0, 0.3), rng):
            moved = vertices + foot
            # The outermost plants are bent back into the box, what hangs into the ground is hidden by it.
            limit = 0.5 * np.asarray(shape.size_m)
            pieces.add((np.clip(moved, -limit, limit), faces), number + 1)


def _stems(height: Float, lean: Float, azimuth: Float, parts: int) -> Float:
    """Middle lines (stem, parts + 1, 3) of stems of given lengths from the origin toward −z, bent evenly by `lean` [rad]."""
    step = (np.arange(parts) + 0.5) / parts
    path = np.zeros((len(height), parts + 1, 3))
    angle = lean[:, None] * step
    out = np.cumsum(np.sin(angle), axis=1) * height[:, None] / parts
    path[:, 1:, 0], path[:, 1:, 1] = out * np.cos(azimuth)[:, None], out * np.sin(azimuth)[:, None]
    path[:, 1:, 2] = -np.cumsum(np.cos(angle), axis=1) * height[:, None] / parts
    return path


def _tuft(shape: Vegetation, height: float, azimuth: float, rng: np.random.Generator) -> list[Triangles]:
    lean = np.radians(shape.lean_deg) * rng.uniform(0.5, 1.0, _BLADES) + rng.normal(0.0, 0.1, _BLADES)
    direction = azimuth + rng.normal(0.0, 0.6, _BLADES)
    middle = _stems(height * rng.uniform(0.6, 1.0, _BLADES), lean, direction, _PARTS)
    middle[..., :2] += rng.uniform(-0.06, 0.06, (_BLADES, 1, 2)) * height
    t = np.linspace(0.0, 1.0, _PARTS + 1)
    width = shape.blade_width_m * (1.0 - 0.9 * t**2) * rng.uniform(0.7, 1.0, (_BLADES, 1))
    return [ribbons(middle, width, np.stack([-np.sin(direction), np.cos(direction), np.zeros(_BLADES)], axis=-1))]


def _branched(shape: Vegetation, height: float, azimuth: float, rng: np.random.Generator) -> list[Triangles]:
    """A stem that forks in two or three, `_LEVELS` deep; each level is shorter and thinner, the whole as high as `height`."""
    found = []
    lean = np.radians(shape.lean_deg)
    share = 0.7 ** np.arange(_LEVELS)
    lengths = height * share / share.sum()
    foot, tilt, turn = np.zeros((1, 3)), lean * rng.uniform(0.1, 0.4, 1), np.array([azimuth])
    for level in range(_LEVELS):
        lines = foot[:, None] + _stems(np.full(len(foot), lengths[level]), 2.0 * np.minimum(tilt, 1.4), turn, _RINGS)
        radius = 0.5 * shape.blade_width_m * 0.7**level * np.linspace(1.0, 0.7, _RINGS + 1)
        for line, angle in zip(lines, turn, strict=True):
            across = np.tile([-np.sin(angle), np.cos(angle), 0.0], (_RINGS + 1, 1))
            found.append(tube(line, radius, _SIDES, across))
        forks = rng.integers(2, 4, len(foot))
        foot, turn = np.repeat(lines[:, -1], forks, axis=0), np.repeat(turn, forks)
        tilt, turn = lean * rng.uniform(0.3, 1.0, len(foot)), turn + rng.normal(0.0, 1.0, len(foot))
    return found
