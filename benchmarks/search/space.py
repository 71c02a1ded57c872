"""The search space of `beambench break`: scenes under the named stresses, each between two levels.

A candidate is a scene and the levels of some axes; on all other axes the scene is unchanged. Stresses that affect
every estimator equally (a wrong index, a wrong zero of time) are left out: they test the calibration, not an estimator.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...scenes.errors import InputError
from ...scenes.scene import Scene
from ..suites.stress import stressed

__all__ = ["Candidate", "Dimension", "SPACE", "dimensions_of", "draw", "ends", "mutate", "rounded"]


@dataclass(frozen=True)
class Dimension:
    """One axis of the space.

    Main arguments:
        axis: a named stress. low, high: levels, in the unit of the stress. log: whether the logarithm is drawn uniformly.
        neutral: the benign level, towards which a failure is shrunk.
    Other arguments:
        coarse: whether only the levels 1, 2, 5, 10 … are drawn, because each needs a new table of the exact likelihood.
    """

    axis: str
    low: float
    high: float
    log: bool
    neutral: float
    coarse: bool = False

    def level(self, position: float) -> float:
        """The level at a position from 0 to 1, rounded to few digits."""
        position = min(max(position, 0.0), 1.0)
        span, ratio = self.high - self.low, self.high / self.low if self.log else 1.0
        exact = self.low * ratio**position if self.log else self.low + span * position
        return min(max(_series(exact) if self.coarse else rounded(exact, 2), self.low), self.high)

    def position(self, level: float) -> float:
        """The inverse of `level`, without rounding."""
        level = min(max(level, self.low), self.high)
        if self.log:
            return math.log(level / self.low) / math.log(self.high / self.low)
        return (level - self.low) / (self.high - self.low)


#: The documented search space; levels in the units of `stress.AXES`.
SPACE: tuple[Dimension, ...] = (
    Dimension("photons", 1e-3, 30.0, True, 1.0),
    Dimension("background", 1e3, 1e10, True, 1e3),
    Dimension("incidence", -75.0, 75.0, False, 0.0),
    Dimension("delay-step", 0.5, 8.0, True, 1.0),
    Dimension("window-start", -2e-9, 4e-9, False, 0.0),
    Dimension("pulse-width", 0.3, 4.0, True, 1.0),
    Dimension("jitter", 1e-12, 1e-9, True, 1e-12),
    Dimension("shot-jitter", 1e-12, 1e-9, True, 1e-12),
    Dimension("fluctuation", 0.0, 0.5, False, 0.0),
    Dimension("read-noise", 0.5, 100.0, True, 0.5, coarse=True),
    Dimension("gain", 0.01, 10.0, True, 1.0, coarse=True),
    Dimension("wrong-pulse", -0.5, 0.5, False, 0.0),
)


@dataclass(frozen=True)
class Candidate:
    """A point of the space: a scene and the levels of some axes, sorted by axis."""

    scene: str
    levels: tuple[tuple[str, float], ...]

    def without(self, axes: Sequence[str]) -> Candidate:
        """The candidate without the given axes, on which the scene is then unchanged."""
        return Candidate(self.scene, tuple(pair for pair in self.levels if pair[0] not in axes))

    def at(self, axis: str, level: float) -> Candidate:
        """The candidate with one axis set to a level."""
        return Candidate(self.scene, tuple(sorted({**dict(self.levels), axis: level}.items())))

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes of the candidate."""
        return tuple(axis for axis, _ in self.levels)


def rounded(value: float, digits: int) -> float:
    """The number, rounded to that many significant digits."""
    return float(f"{value:.{digits}g}")


def _series(value: float) -> float:
    """The number of … 1, 2, 5, 10 … that is nearest by ratio."""
    decade = 10.0 ** math.floor(math.log10(value))
    return rounded(min((decade, 2 * decade, 5 * decade, 10 * decade), key=lambda v: abs(math.log(v / value))), 1)


def dimensions_of(scenes: Sequence[Scene], space: Sequence[Dimension] = SPACE) -> list[Dimension]:
    """The dimensions that apply to at least one of the scenes."""
    fitting = []
    for dimension in space:
        for scene in scenes:
            try:
                stressed(scene, [(dimension.axis, dimension.neutral)])
            except InputError:
                continue
            fitting.append(dimension)
            break
    return fitting


def draw(rng: np.random.Generator, scenes: Sequence[str], space: Sequence[Dimension]) -> Candidate:
    """A random candidate with at least one axis changed, often many: shrinking removes those that do not matter."""
    count = int(max(rng.integers(1, len(space) + 1, size=2)))
    chosen = rng.choice(len(space), size=count, replace=False)
    # A little beyond both ends, so that the ends themselves, where failures are frequent, are drawn sometimes.
    levels = {space[i].axis: space[i].level(float(rng.uniform(-0.06, 1.06))) for i in chosen}
    return Candidate(str(rng.choice(list(scenes))), tuple(sorted(levels.items())))


def ends(scene: str, space: Sequence[Dimension]) -> list[Candidate]:
    """Each axis alone, at either end. These are tried first, as such failures are the easiest to understand."""
    return [Candidate(scene, ((d.axis, d.level(x)),)) for d in space for x in (0.0, 1.0) if d.level(x) != d.neutral]


def mutate(
    rng: np.random.Generator, parent: Candidate, scenes: Sequence[str], space: Sequence[Dimension], width: float
) -> Candidate:
    """A similar candidate: some levels moved by about `width` of their span; sometimes another axis or scene."""
    by_axis: dict[str, Any] = {dimension.axis: dimension for dimension in space}
    levels = dict(parent.levels)
    if levels and rng.random() < 0.25:
        levels.pop(str(rng.choice(list(levels))))
    if not levels or rng.random() < 0.25:
        extra = space[int(rng.integers(len(space)))]
        levels[extra.axis] = extra.level(float(rng.random()))
    for axis in list(levels):
        if rng.random() < 0.6:
            dimension = by_axis[axis]
            levels[axis] = dimension.level(dimension.position(levels[axis]) + float(rng.normal(0.0, width)))
    scene = str(rng.choice(list(scenes))) if rng.random() < 0.1 else parent.scene
    return Candidate(scene, tuple(sorted(levels.items())))
