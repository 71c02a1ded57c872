"""Pipes: tubes along S-bends across the ground, with flanges and a riser."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .ground import ground_of
from .solids import Pieces, cylinder, tube
from .spec import BURIED, Pipes

__all__ = ["build_pipes", "lateral"]

Float = NDArray[np.float64]

_POINTS, _SIDES = 64, 20
#: Largest second derivative of the quintic smooth step of unit height and width.
_CURVED = 10.0 / np.sqrt(3.0)
#: Diameter of a flange, relative to the pipe's; its length.
_FLANGE, _THICK = 1.5, 0.18


def build_pipes(shape: Pipes, rng: np.random.Generator, pieces: Pieces) -> None:
    """The ground is instance 0, each pipe with all that is on it one more."""
    ground = ground_of(shape, rng)
    pieces.add(ground.mesh(), 0)
    width, height, depth = shape.size_m
    strip = height / shape.pipes
    x = np.linspace(-0.5 * width, 0.5 * width, _POINTS)
    for number in range(shape.pipes):
        diameter = rng.uniform(*shape.diameter_m)
        room = max(0.5 * strip - 0.5 * _FLANGE * diameter, 0.0)
        y = -0.5 * height + (number + 0.5) * strip + lateral(x, shape, room, rng)
        # A pipe is stiff: it rests on the highest ground below it, a little sunk, and is level.
        top = float(ground.at(np.stack([x, y], axis=-1)).min())
        z = min(top - (0.5 - BURIED) * diameter, 0.5 * (depth - _FLANGE * diameter))
        path = np.stack([x, y, np.full(_POINTS, z)], axis=-1)
        # Upright ends, so that nothing reaches beyond the box.
        path[[1, -2], 1] = path[[0, -1], 1]
        pieces.add(
            tube(path, np.full(_POINTS, 0.5 * diameter), _SIDES, np.tile([0.0, 0.0, -1.0], (_POINTS, 1))), number + 1
        )
        _flanges(shape, path, diameter, rng, pieces, number + 1)
        _riser(shape, path, diameter, rng, pieces, number + 1)


def lateral(x: Float, shape: Pipes, room: float, rng: np.random.Generator) -> Float:
    """y [m] along x: level, with a smooth step to another level between −room and room in the middle of each of `bends` parts.

    A quintic step of height d and width w has a curvature of at most 5.77 d/w²: d is held below what `bend_radius_m` allows.
    """
    level = rng.uniform(-room, room)
    y = np.full(x.shape, level)
    length = (x[-1] - x[0]) / max(shape.bends, 1)
    most = length**2 / (_CURVED * shape.bend_radius_m)
    for bend in range(shape.bends):
        goal = rng.uniform(-room, room)
        change = float(np.clip(goal - level, -most, most))
        least = np.sqrt(_CURVED * abs(change) * shape.bend_radius_m) / length
        wide = length * rng.uniform(least, 1.0)
        begin = x[0] + bend * length + rng.uniform(0.0, 1.0) * (length - wide)
        t = np.clip((x - begin) / max(wide, 1e-12), 0.0, 1.0)
        y = y + change * t**3 * (t * (6.0 * t - 15.0) + 10.0)
        level += change
    return y


def _flanges(shape: Pipes, path: Float, diameter: float, rng: np.random.Generator, pieces: Pieces, number: int) -> None:
    spacing = shape.flange_spacing_m
    thick = _THICK * diameter
    ends = (path[0, 0] + diameter, path[-1, 0] - diameter)
    for at in np.arange(ends[0] + rng.uniform(0.0, 1.0) * spacing, ends[1], spacing)[:40]:
        near = int(np.clip(np.searchsorted(path[:, 0], at), 2, len(path) - 3))
        along = path[near + 1] - path[near - 1]
        along /= np.linalg.norm(along)
        pieces.add(
            cylinder(path[near] - thick * along, path[near] + thick * along, 0.5 * _FLANGE * diameter, _SIDES), number
        )


def _riser(shape: Pipes, path: Float, diameter: float, rng: np.random.Generator, pieces: Pieces, number: int) -> None:
    """An upright stub with a cap, as high as there is room."""
    base = path[int(rng.integers(_POINTS // 4, 3 * _POINTS // 4))]
    room = base[2] + 0.5 * shape.size_m[2]
    thick = 2.0 * _THICK * diameter
    high = min(room, diameter * rng.uniform(1.0, 3.0))
    if high - thick <= 0.6 * diameter:
        return  # its cap would lie in the pipe
    radius = 0.35 * diameter
    top, neck = base - [0.0, 0.0, high], base - [0.0, 0.0, high - thick]
    pieces.add(cylinder(base, neck, radius, _SIDES), number)
    pieces.add(cylinder(neck, top, 0.55 * diameter, _SIDES), number)
