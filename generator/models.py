"""The table of forward models: one record per modality."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..scenes.records import record_of

if TYPE_CHECKING:
    from ..scenes.scene import Scene
    from .model import Model

__all__ = ["MODELS", "first_rung", "model_of"]

#: modality -> "module:object"
MODELS: dict[str, str] = {
    "gated": "beambench.generator.gated.model:MODEL",
    "waveform": "beambench.generator.ranger.waveform:MODEL",
    "amcw": "beambench.generator.ranger.amcw:MODEL",
    "laser_line": "beambench.generator.laser_line.model:MODEL",
    "wavefront": "beambench.generator.wavefront.model:MODEL",
}


def model_of(modality: str) -> Model[Any]:
    """The forward model of a modality. Raises InputError where none is built."""
    model: Model[Any] = record_of(MODELS, modality, "There is no forward model of this modality.", "rig.kind")
    return model


def first_rung(scene: Scene) -> Any:
    """The cheapest rung of a scene's modality: what is rendered where no rung is named."""
    return model_of(scene.modality).rungs[0]
