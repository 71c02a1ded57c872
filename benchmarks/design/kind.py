"""What a modality contributes to `design`: settings to choose from, and the bound of a scene under each."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ...scenes.scene import Scene

__all__ = ["Ask", "Curve", "Designs", "Knob", "Option"]

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
            seed: of the captures that are generated.
    """

    budget: float
    margin_m: float | None
    values: Mapping[str, tuple[float, ...]]
    fidelity: Any
    seed: int


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
            an ambiguity (`Designs.guard`). why: what speaks against it, "" if nothing.
    """

    name: str
    settings: Mapping[str, float]
    overrides: Mapping[str, Any]
    bound: float
    guard: float
    why: str = ""

    @property
    def allowed(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.why and math.isfinite(self.bound)


@dataclass(frozen=True)
class Designs:
    """The record of a modality.

    Main arguments:
        knobs: scene -> its settings. options: (scene, what is asked) -> designs, the scene's own first; and the curve. quantity,
            unit, shown: what is bounded, and (factor, unit) of display. guard: what the column `guard` holds.
    """

    knobs: Callable[[Scene], Sequence[Knob]]
    options: Callable[[Scene, Ask], tuple[list[Option], Curve]]
    quantity: str
    shown: tuple[float, str]
    guard: str
