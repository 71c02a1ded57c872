"""What a modality contributes to `design`: settings to choose from, and the bound of a scene under each."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ...scenes.scene import Scene
from ..folders.progress import Progress, silent

__all__ = ["Ask", "Curve", "Designs", "Knob", "Option", "Steps"]

Float = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Knob:
    """A setting that is chosen. `values`: those to choose from by default, in `unit`."""

    name: str
    unit: str
    what: str
    values: tuple[float, ...]


@dataclass(frozen=True)
class Ask:
    """What is asked.

    Main arguments:
        budget: light in all, as a multiple of the scene's own. margin_m: by how much the target may be nearer or farther than the
            scene says. values: setting -> values to choose from. fidelity: rung that gives the light; None: the cheapest.
            seed: of the captures that are generated. model: "direct" or "exact", what who reads knows of the light.
        progress: told after every step.
    """

    budget: float
    margin_m: float | None
    values: Mapping[str, tuple[float, ...]]
    fidelity: Any
    seed: int
    model: str = "exact"
    progress: Progress = silent


class Steps:
    """Tells progress, step by step of `total`, with what is done now."""

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress, self._total, self._done = progress, total, -1

    def __call__(self, text: str) -> None:
        """One more step begins."""
        self._done += 1
        self._progress("design", self._done, self._total, text)


@dataclass(frozen=True)
class Curve:
    """A curve beside the table: `y` against `x`, with their titles, and the places of marks by the name of their option."""

    x: Float
    y: Float
    x_title: str
    y_title: str
    marks: Mapping[str, Float] = field(default_factory=dict)


@dataclass(frozen=True)
class Option:
    """One design.

    Main arguments:
        name: in a few words. settings: setting -> value. overrides: {path: value} that turn the scene into it. bound: rms bound
            over the elements, in the unit of the quantity; infinite where some cannot be told. guard: how far the design is from
            an ambiguity (`Designs.guard`). why: what speaks against it, "" if nothing. bias: rms error of an estimator whose model
            lacks some of the light, of which `bound` then is the noise alone.
    """

    name: str
    settings: Mapping[str, float]
    overrides: Mapping[str, Any]
    bound: float
    guard: float
    why: str = ""
    bias: float = 0.0

    @property
    def error(self) -> float:
        """What is made least: √(bound² + bias²)."""
        return math.hypot(self.bound, self.bias)

    @property
    def allowed(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.why and math.isfinite(self.error)


@dataclass(frozen=True)
class Designs:
    """The record of a modality.

    Main arguments:
        knobs: scene -> its settings. options: (scene, what is asked) -> designs, the scene's own first; and the curve. quantity,
            unit, shown: what is bounded, and (factor, unit) of display. guard: what the column `guard` holds. models: of who reads,
            the default first.
    """

    knobs: Callable[[Scene], Sequence[Knob]]
    options: Callable[[Scene, Ask], tuple[list[Option], Curve]]
    quantity: str
    shown: tuple[float, str]
    guard: str
    models: tuple[str, ...] = ("exact",)
