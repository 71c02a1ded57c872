"""The full rung: the line and its curtain in closed form, and all other light by paths, so that the rungs nest.

The six numbers that place a path in its pixel and draw its first beam come from a lattice, shifted at random in every pixel:
unbiased, and more even than independent numbers. Two independent halves of the paths give the error of the image; rounds are added
until it meets the request.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..random import BLOCK_ROWS, Stage, sequence
from .device import LineWorld
from .setting import Pose, Setting
from .transport import Rays, trace_rest

__all__ = ["MOST_SAMPLES", "SAMPLING", "Rest", "Tracing", "rest_of"]

Float = NDArray[np.float64]

#: Rays and paths share the rung's relative error: each may have this part of it.
SAMPLING = 0.7
#: Paths of each pixel at most, in the first round, and in one round.
MOST_SAMPLES = 1 << 14
_FIRST, _ROUND = 16, 1 << 9
#: Steps of a lattice in six dimensions (Roberts 2018): powers of 1/φ₆, φ₆⁷ = φ₆ + 1.
_LATTICE = 1.1127756842787055 ** -np.arange(1.0, 7.0)
#: Paths that are traced at once, at most: about 300 bytes each.
_AT_ONCE = 1 << 20


@dataclass(frozen=True, eq=False)
class Rest:
    """What is left of the light beside the line and its curtain.

    `light`, `sigma` (n): photoelectrons of each pixel and their standard errors (an upper limit: of independent numbers);
    `halves` (2, n): two independent estimates whose mean is `light`; `epsilon`: standard error of the image relative to the image,
    sqrt(Σ σ²/Σ(known + light)²); `samples` per pixel; `reached`: whether it is below the request.
    """

    light: Float
    sigma: Float
    halves: Float
    epsilon: float
    samples: int
    reached: bool


@dataclass
class Tracing:
    """Pixels of one frame and their sums: `row`, `col` (n) in rising order of rows.

    Other arguments: `straight`: b of turns that are counted as none [1/m] -> light (n) of line and curtain that these add;
    `geometry`: of an earlier frame of the same scene. Raises InputError as `LineWorld.of`.
    """

    setting: Setting
    pose: Pose
    row: NDArray[np.intp]
    col: NDArray[np.intp]
    reached_m: float
    seed: int
    key: int
    frame: int
    straight: Callable[[float], Float] | None = None
    geometry: Any = None
    samples: int = 0
    number: int = 0
    sums: Float = field(init=False)
    squares: Float = field(init=False)
    lens: Float = field(init=False)

    def __post_init__(self) -> None:
        self.world = LineWorld.of(self.setting, self.pose, self.reached_m, self.geometry)
        self.added = np.zeros(self.row.size) if self.straight is None else self.straight(self.world.straight)
        self.sums, self.squares = np.zeros((2, self.row.size)), np.zeros((2, self.row.size))
        self.lens = np.asarray(self.setting.rig.lens_sigma_px)
        if self.setting.lens is not None:  # defocus by the depth that the pixel's middle sees, as of the line
            seen = self.setting.see(self.row.astype(float), self.col.astype(float), self.pose, lit=False)
            self.lens = np.where(seen.hit, self.setting.lens_px(self.col.astype(float), seen.point), self.lens)

    def add(self, samples: int) -> None:
        """One round: `samples` paths (even) in every pixel, half of them in each half."""
        per = samples // 2
        for half in range(2):
            for block in np.unique(self.row // BLOCK_ROWS):
                own = np.flatnonzero(self.row // BLOCK_ROWS == block)
                self._block(int(block), own, half, per)
        self.samples += 2 * per
        self.number += 1

    def _block(self, block: int, own: NDArray[np.intp], half: int, per: int) -> None:
        """Paths of the pixels `own` of one block of rows; their numbers depend on block, round and place in the block."""
        cols = self.setting.rig.camera.cols
        name = (self.key, int(Stage.PATHS), block, half, self.frame)
        shifts, draw = (
            np.random.Generator(np.random.SFC64(sequence(self.seed, (*name, part)))) for part in (0, self.number + 1)
        )
        place = (self.row[own] % BLOCK_ROWS) * cols + self.col[own]
        whole = BLOCK_ROWS * cols
        shift = shifts.random((len(_LATTICE), whole))[:, place]
        step = max(_AT_ONCE // whole, 1)
        for begin in range(0, per, step):
            number = self.samples // 2 + np.arange(begin, min(begin + step, per))
            even = (shift[:, None] + np.multiply.outer(_LATTICE, number)[..., None]) % 1.0
            shape = (number.size, whole)
            blur = draw.standard_normal(shape)[:, place] * (self.lens if np.ndim(self.lens) == 0 else self.lens[own])
            words = [draw.integers(1 << 63, size=shape, dtype=np.uint64)[:, place] for _ in range(2)]
            row, col = self.row[own] + even[0] - 0.5, self.col[own] + even[1] - 0.5 + blur
            value = self._traced(row, col, even[2:], words)
            self.sums[half, own] += value.sum(axis=0)
            self.squares[half, own] += (value**2).sum(axis=0)

    def _traced(self, row: Float, col: Float, even: Float, words: list[NDArray[np.uint64]]) -> Float:
        """Photoelectrons (count, n) of single paths through pixel coordinates (count, n)."""
        origin, direction = self.setting.camera.rays(row.ravel(), col.ravel())
        leaves = np.isfinite(direction).all(axis=0)
        origin, direction = np.where(leaves, origin, 0.0), np.where(leaves, direction, [[0.0], [0.0], [1.0]])
        rays = Rays(
            self.pose.of_point(origin),
            self.pose.turn @ direction,
            even.reshape(len(even), -1),
            *(w.ravel() for w in words),
        )
        light = trace_rest(self.world, rays).astype(np.float64) * self.setting.per_radiance(row.ravel(), col.ravel())
        return np.where(leaves, light, 0.0).reshape(row.shape)

    def result(self, known: Float, rtol: float) -> Rest:
        """What was found so far; `known` (n): the light of line and curtain."""
        per = self.samples / 2
        halves = self.sums / per + self.added
        light = halves.mean(axis=0)
        mean_square = self.squares.sum(axis=0) / self.samples
        variance = np.maximum(mean_square - (light - self.added) ** 2, 0.0)
        sigma = np.sqrt(variance / max(self.samples - 1, 1))
        whole = float(((known + light) ** 2).sum())
        between = float(((halves[0] - halves[1]) ** 2).sum()) / 4.0
        epsilon = float(np.sqrt(between / whole)) if whole > 0 else 0.0
        return Rest(light, sigma, halves, epsilon, self.samples, epsilon <= rtol)


def rest_of(tracing: Tracing, known: Float, rtol: float, most: int = MOST_SAMPLES) -> Rest:
    """Paths until the standard error of the image is below `rtol` of it, or `most` paths in every pixel are used up."""
    wanted = min(_FIRST, most)
    while True:
        while wanted > 0:
            round_ = min(wanted, _ROUND)
            tracing.add(round_)
            wanted -= round_
        rest = tracing.result(known, rtol)
        if rest.reached or tracing.samples >= most:
            return rest
        needed = tracing.samples * min(max(1.1 * (rest.epsilon / rtol) ** 2, 1.5), 8.0)
        wanted = max(2 * int((min(needed, most) - tracing.samples + 1) // 2), 2)
