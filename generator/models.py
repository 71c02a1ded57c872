"""The table of forward models: one record per modality."""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ..scenes.errors import InputError

if TYPE_CHECKING:
    from .model import Model

__all__ = ["MODELS", "model_of"]

#: modality -> "module:object"
MODELS: dict[str, str] = {
    "gated": "beambench.generator.gated.model:MODEL",
    "waveform": "beambench.generator.ranger.waveform:MODEL",
    "amcw": "beambench.generator.ranger.amcw:MODEL",
}


@lru_cache(maxsize=64)
def model_of(modality: str) -> Model[Any]:
    """The forward model of a modality. Raises InputError where none is built."""
    if modality not in MODELS:
        raise InputError(
            "There is no forward model of this modality.", where="rig.kind", value=modality, allowed=", ".join(MODELS)
        )
    module, _, name = MODELS[modality].partition(":")
    model: Model[Any] = getattr(import_module(module), name)
    return model
