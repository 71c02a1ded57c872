"""The uneven ground that objects stand on, in the frame of the box: x and y across it, z away from the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .solids import Triangles
from .spec import GROUND_SPAN, OnGround

__all__ = ["Ground", "ground_of"]

Float = NDArray[np.float64]

_WAVES = 24
_CELLS = 48


@dataclass(frozen=True, eq=False)
class Ground:
    """z [m] of the ground's surface at places (…, 2) by `at`, and its triangles by `mesh`."""

    half: tuple[float, float]
    middle: float
    rms: float
    wave: Float
    phase: Float

    def at(self, place: Float) -> Float:
        """z = z₀ − h, h = rms·√(2/n) Σ cos(k·x + φ), cut off at ±3 rms."""
        if self.rms == 0.0:
            return np.full(place.shape[:-1], self.middle)
        total = np.cos(place @ self.wave.T + self.phase).sum(axis=-1)
        high = GROUND_SPAN * self.rms
        return np.asarray(self.middle - np.clip(self.rms * np.sqrt(2.0 / _WAVES) * total, -high, high))

    def mesh(self) -> Triangles:
        """A grid over the whole box."""
        x, y = (np.linspace(-half, half, _CELLS + 1) for half in self.half)
        place = np.stack(np.meshgrid(x, y), axis=-1)
        vertices = np.concatenate([place, self.at(place)[..., None]], axis=-1).reshape(-1, 3)
        index = np.arange((_CELLS + 1) ** 2).reshape(_CELLS + 1, _CELLS + 1)
        a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
        return vertices, np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, c, b), (a, d, c))])


def ground_of(shape: OnGround, rng: np.random.Generator) -> Ground:
    """The ground of a draw: its waves have lengths of ⅔ to 1½ `ground_scale_m`, in all directions."""
    width, height, depth = shape.size_m
    length = shape.ground_scale_m * np.exp(rng.uniform(np.log(2.0 / 3.0), np.log(1.5), _WAVES))
    turn, phase = rng.uniform(0.0, 2.0 * np.pi, (2, _WAVES))
    wave = 2.0 * np.pi / length[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    middle = 0.5 * depth - GROUND_SPAN * shape.ground_rms_m
    return Ground((0.5 * width, 0.5 * height), middle, shape.ground_rms_m, wave, phase)
