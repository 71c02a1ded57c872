"""The catalogue of effects: how one is written down, what all modalities share, and the warnings that follow from it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

from ..scenes.scene import Scene
from ..scenes.shapes import Rectangle, Sphere
from .choice import Choice

__all__ = [
    "LEFT_OUT",
    "WORTH_A_WARNING",
    "Effect",
    "GenerationWarning",
    "effect",
    "interreflection",
    "no_light",
    "sized",
    "warn",
]

#: `name`, `modelled` by the rung, `predicted_relative_size` (or None), `basis` of the prediction.
Effect = dict[str, Any]

#: A neglected effect of more than this share of the signal is worth a warning.
WORTH_A_WARNING = 0.1
#: What the warning of such an effect says.
LEFT_OUT = "is left out by the rung"


class GenerationWarning(UserWarning):
    """The capture was made, but a user should look at the scene."""


def effect(name: str, modelled: bool, size: float | None, basis: str) -> Effect:
    """One catalogued effect; `size` relative to the signal, None where no bound is known."""
    return {"name": name, "modelled": modelled, "predicted_relative_size": size, "basis": basis}


def interreflection(scene: Scene) -> tuple[float | None, str]:
    """Size of second bounces: zero where no surface faces another, else unknown to closed forms, with an upper bound."""
    shapes = [item.shape for item in scene.target]
    flat = all(isinstance(s, Rectangle) and s.tilt_x_deg == 0 and s.tilt_y_deg == 0 for s in shapes)
    if flat or (len(shapes) == 1 and isinstance(shapes[0], Rectangle | Sphere)):
        return 0.0, "no surface faces another"
    brightest = max(item.material.albedo_at_normal() for item in scene.target)
    return None, f"unknown; at most the largest albedo, {brightest:.2g}"


def sized(effects: Sequence[Effect], choice: Choice | None) -> list[Effect]:
    """The effects, with the sizes that the choice of the rung predicted where these are the better ones."""
    if choice is None or not choice.supersedes:
        return list(effects)
    return [
        line | {"predicted_relative_size": choice.sizes[line["name"]], "basis": choice.basis}
        if line["name"] in choice.sizes
        else line
        for line in effects
    ]


def no_light(scene: Scene, sample: str, window: str) -> str:
    """The warning that no sample of this name receives light; `window`: what the target may be outside of."""
    return f"{scene.name}: no light reaches any {sample}: the target is not hit, not lit, or outside {window}."


def warn(scene: Scene, sentences: Sequence[str], effects: Sequence[Effect], rung: str) -> None:
    """Warn whoever called `generate` of `sentences`, and of effects that the rung leaves out and that are not small."""
    missing = [
        f"{scene.name}: {line['name']} {LEFT_OUT} '{rung}' and is predicted to change the signal by "
        f"{line['predicted_relative_size']:.0%}."
        for line in effects
        if not line["modelled"] and (line["predicted_relative_size"] or 0.0) > WORTH_A_WARNING
    ]
    for sentence in [*sentences, *missing]:
        warnings.warn(sentence, GenerationWarning, stacklevel=4)
