"""Lambert's law for Mitsuba: Phong's law without a lobe."""

from __future__ import annotations

from ...scenes.materials import Lambert
from .phong import PhongLaw

__all__ = ["lambert_law"]


def lambert_law(material: Lambert) -> PhongLaw:
    """The law of a material."""
    return PhongLaw.of(material.albedo, 0.0, 0.0)
