"""Terraces: steps with upright risers, and blocks on their treads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .solids import Pieces, box, prism
from .spec import Terraces

__all__ = ["build_terraces"]

Float = NDArray[np.float64]


def build_terraces(shape: Terraces, rng: np.random.Generator, pieces: Pieces) -> None:
    """Each step is an instance, each block one more."""
    turned = bool(rng.integers(2))  # steps along y instead of x
    width, height, depth = shape.size_m
    long, wide = (height, width) if turned else (width, height)
    edges = _edges(shape.steps, long, rng)
    top = _tops(shape, rng)
    for number in range(shape.steps):
        low, high = edges[number], edges[number + 1]
        corners = np.array([[low[0], -0.5], [high[0], -0.5], [high[1], 0.5], [low[1], 0.5]]) * [1.0, wide]
        if turned:
            corners = corners[::-1, ::-1]  # both: the order of the corners stays counter-clockwise
        base = np.column_stack([corners, np.full(4, 0.5 * depth)])
        # Seen along z the corners turn the other way round: the top lies toward −z.
        pieces.add(prism(base[::-1], np.column_stack([corners, np.full(4, top[number])])[::-1]), number)
    for number in range(shape.blocks):
        _block(shape, edges, top, turned, wide, rng, pieces, shape.steps + number)


def _edges(steps: int, long: float, rng: np.random.Generator) -> Float:
    """Where treads begin and end (steps + 1, two sides) [m]: uneven, and askew by at most a fifth of the smallest."""
    share = rng.uniform(0.5, 1.5, steps)
    at = np.concatenate([[0.0], np.cumsum(share / share.sum())])
    skew = rng.uniform(-0.2, 0.2, (steps + 1, 2)) * float((share / share.sum()).min())
    skew[[0, -1]] = 0.0
    return (at[:, None] + skew - 0.5) * long


def _tops(shape: Terraces, rng: np.random.Generator) -> Float:
    """z [m] of the treads. A riser that would leave the room of the steps goes the other way; treads keep a share below them."""
    depth = shape.size_m[2]
    room = 0.5 * depth
    least = 0.02 * room
    level = rng.uniform(least, room)
    found = np.empty(shape.steps)
    for number in range(shape.steps):
        found[number] = level
        rise = rng.uniform(*shape.rise_m) * (1.0 if rng.random() < 0.6 else -1.0)
        level = level + rise if least <= level + rise <= room else level - rise
        level = float(np.clip(level, least, room))
    return 0.5 * depth - found


def _block(
    shape: Terraces, edges: Float, top: Float, turned: bool, wide: float, rng: np.random.Generator, pieces: Pieces, number: int
) -> None:  # fmt: skip
    step = int(rng.integers(shape.steps))
    size = rng.uniform(*shape.block_m) * rng.uniform(0.4, 1.0, 3)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    vertices, faces = box(size)
    c, s = np.cos(angle), np.sin(angle)
    vertices = vertices @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T
    reach = 0.5 * float(np.hypot(size[0], size[1]))
    low, high = edges[step].max() + reach, edges[step + 1].min() - reach
    # A block longer than its tread lies across its middle, over the edge.
    along = rng.uniform(low, high) if low < high else 0.5 * (low + high)
    along = float(np.clip(along, edges[0, 0] + reach, edges[-1, 0] - reach))
    across = rng.uniform(-0.5 * wide + reach, 0.5 * wide - reach)
    place = [across, along] if turned else [along, across]
    at = np.array([*place, top[step] - 0.5 * size[2]])
    pieces.add((vertices + at, faces), number)
