"""Wreckage: boxes, plates, cylinders and frames of beams, turned at random, on the ground."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from .ground import ground_of
from .solids import Pieces, box, cylinder, random_turn
from .spec import BURIED, Wreck

__all__ = ["build_wreck"]

Float = NDArray[np.float64]
Bodies = list[tuple[Float, NDArray[np.int64]]]


def build_wreck(shape: Wreck, rng: np.random.Generator, pieces: Pieces) -> None:
    """The ground is instance 0, each piece one more."""
    ground = ground_of(shape, rng)
    pieces.add(ground.mesh(), 0)
    makers = (_box, _plate, _cylinder, _frame)
    for number in range(shape.pieces):
        bodies = makers[int(rng.integers(len(makers)))](rng)
        whole = np.concatenate([vertices for vertices, _ in bodies])
        diameter = rng.uniform(*shape.piece_m)
        turn = 0.5 * diameter / np.linalg.norm(whole, axis=1).max() * random_turn(rng)
        deep = (whole @ turn.T)[:, 2]
        low = float(deep.max() - BURIED * np.ptp(deep))
        room = 0.5 * np.asarray(shape.size_m[:2]) - 0.5 * diameter
        place = rng.uniform(-room, room)
        at = np.array([*place, float(ground.at(place)) - low])
        for vertices, faces in bodies:
            moved = vertices @ turn.T + at
            moved[:, 2] = np.minimum(
                moved[:, 2], 0.5 * shape.size_m[2]
            )  # what lies below the box is hidden by the ground
            pieces.add((moved, faces), number + 1)


def _box(rng: np.random.Generator) -> Bodies:
    return [box(rng.uniform(0.4, 1.0, 3))]


def _plate(rng: np.random.Generator) -> Bodies:
    return [box(rng.uniform([0.6, 0.6, 0.03], [1.0, 1.0, 0.08]))]


def _cylinder(rng: np.random.Generator) -> Bodies:
    end = np.array([0.5, 0.0, 0.0])
    return [cylinder(-end, end, rng.uniform(0.1, 0.35), 24)]


def _frame(rng: np.random.Generator) -> Bodies:
    """The twelve edges of a box as beams of a square section."""
    half = 0.5 * rng.uniform(0.5, 1.0, 3)
    thick = rng.uniform(0.05, 0.12)
    found = []
    for axis in range(3):
        size = np.full(3, thick)
        size[axis] = 2.0 * half[axis] + thick
        others = [k for k in range(3) if k != axis]
        for signs in product((-1.0, 1.0), repeat=2):
            centre = np.zeros(3)
            centre[others] = np.asarray(signs) * half[others]
            vertices, faces = box(size)
            found.append((vertices + centre, faces))
    return found
