"""The table of reflection laws for Mitsuba: one file and one entry for each `kind` of `scenes.materials`."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ...scenes.materials import Material
    from .law import Law

__all__ = ["LAWS", "law_of"]

#: kind of material -> "module:function", the function of a material that returns its `Law`.
LAWS: dict[str, str] = {
    "lambert": "beambench.generator.bsdf.lambert:lambert_law",
    "phong": "beambench.generator.bsdf.phong:phong_law",
    "cook-torrance": "beambench.generator.bsdf.cook_torrance:cook_torrance_law",
    "chua": "beambench.generator.bsdf.chua:chua_law",
}


def law_of(material: Material) -> Law:
    """The law of a material."""
    module, _, name = LAWS[material.kind].partition(":")
    law: Law = getattr(import_module(module), name)(material)
    return law
