"""The outcome of a design."""

from __future__ import annotations

from dataclasses import dataclass

from .kind import Curve, Knob, Option

__all__ = ["Designed"]


@dataclass(frozen=True)
class Designed:
    """A design.

    Main arguments:
        scene: its name. quantity, unit, factor: what is bounded, and the unit of display over that of `bound`. options: the
            scene's own design first, then all others. best: the allowed one of least bound; the own one where none is better.
            guard: what the column `guard` holds. curve: for the picture. knobs: what was chosen among.
            model: what who reads knows of the light.
    """

    scene: str
    quantity: str
    unit: str
    factor: float
    options: tuple[Option, ...]
    best: Option
    guard: str
    curve: Curve
    knobs: tuple[Knob, ...]
    model: str

    @property
    def own(self) -> Option:
        """The scene's own design."""
        return self.options[0]

    @property
    def gain(self) -> float:
        """Error of the scene's own design over that of the best."""
        return self.own.error / self.best.error
