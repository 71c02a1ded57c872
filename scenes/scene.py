"""A scene: target, medium, rig, and what the rig is *declared* to be."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from .base import Spec
from .materials import Material
from .medium import Medium
from .rig import GatedRig
from .shapes import Shape

__all__ = ["Scene", "TargetObject"]


class TargetObject(Spec):
    """One object: a shape of one material."""

    name: str
    shape: Shape
    material: Material


class Scene(Spec):
    """All that a capture is generated from.

    `declared` is applied over the rig (paths such as "medium.index.group", "laser.pulse.fwhm_s", "t0_s") to make the
    instrument that estimators are told about: that is how a wrong calibration is staged.
    """

    schema_version: Literal[1] = 1
    name: Annotated[str, Field(min_length=1, max_length=120, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
    title: str
    target: Annotated[tuple[TargetObject, ...], Field(min_length=1)]
    medium: Medium
    rig: GatedRig
    declared: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _names_differ(self) -> Scene:
        names = [o.name for o in self.target]
        if len(set(names)) != len(names):
            raise ValueError(f"target objects need different names, got {names}")
        return self

    @property
    def modality(self) -> str:
        """The modality of the captures that this scene gives."""
        return self.rig.kind
