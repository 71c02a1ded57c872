"""What waveform and AMCW captures share: their attributes, and the warnings of their generation."""

from __future__ import annotations

import warnings
from typing import Any

from ...scenes.scene import Scene

__all__ = ["ranger_attributes", "warn_about"]


def ranger_attributes(
    scene: Scene,
    declared: dict[str, Any],
    seed: int,
    key: int,
    rtol: float,
    rays: int,
    effects: list[dict[str, Any]],
    truth_electrons: bool,
    rung: str = "direct",
) -> dict[str, Any]:
    """Attributes of a generated capture, `provenance` enough to repeat it."""
    from ...captures.provenance import provenance

    arguments = {
        "seed": seed, "capture_key": key, "fidelity": rung, "rtol": rtol, "truth_electrons": truth_electrons,
    }  # fmt: skip
    return {
        "rig": declared,
        "truth_scene": scene.model_dump(mode="json"),
        "truth_kind": "rendered",
        "seed": seed,
        "capture_key": key,
        "fidelity": {"rung": rung, "rtol": rtol, "rays": rays, "effects": effects},
        "truth_materials": [item.name for item in scene.target],
        "provenance": provenance(arguments),
    }


def warn_about(scene: Scene, brightest: float, seen: str, effects: list[dict[str, Any]], rung: str = "direct") -> None:
    """Warn where no light reaches the record, and of effects left out that are predicted to exceed 10 %."""
    from ..generate import GenerationWarning

    if not brightest > 0:
        warnings.warn(
            f"{scene.name}: no light reaches any sample: the target is not hit, not lit, or outside {seen}.",
            GenerationWarning,
            stacklevel=4,
        )
    for effect in effects:
        size = effect["predicted_relative_size"] or 0.0
        if not effect["modelled"] and size > 0.1:
            warnings.warn(
                f"{scene.name}: {effect['name']} is left out by the rung '{rung}' and is predicted to change the "
                f"signal by {size:.0%}.",
                GenerationWarning,
                stacklevel=4,
            )
