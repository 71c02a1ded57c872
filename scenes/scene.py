"""A scene: target, medium, rig, and the values that the rig declares wrongly."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

from pydantic import (
    Discriminator,
    Field,
    SerializerFunctionWrapHandler,
    Tag,
    ValidationError,
    model_serializer,
    model_validator,
)
from pydantic_core import InitErrorDetails

from .base import Spec
from .materials import Material
from .medium import Medium
from .procedural.spec import Procedural
from .rigs import RIGS, rig_kind
from .rigs.kind import RigSpec
from .shapes import Box, Shape
from .textures import Texture

__all__ = ["Rig", "Scene", "TargetObject", "sizes_of"]


def _kind(rig: Any) -> str:
    """The kind of a rig, as data or as spec; one that does not say is of the table's first kind."""
    first = next(iter(RIGS))
    kind = rig.get("kind", first) if isinstance(rig, dict) else getattr(rig, "kind", first)
    return str(kind)


if TYPE_CHECKING:
    Rig = RigSpec
else:  # the union of the specs of all kinds, discriminated by `kind`
    Rig = Annotated[
        Union[tuple(Annotated[rig_kind(name).spec, Tag(name)] for name in RIGS)],  # noqa: UP007
        Discriminator(
            _kind, custom_error_type="rig_kind", custom_error_message=f"rig.kind should be one of {', '.join(RIGS)}"
        ),
    ]


class TargetObject(Spec):
    """One object: a shape of one material, whose diffuse part a `texture` may vary over the surface (not over a box or a
    procedural shape)."""

    name: str
    shape: Shape
    material: Material
    texture: Texture | None = None

    @model_validator(mode="after")
    def _shape_can_be_textured(self) -> TargetObject:
        if self.texture is not None and isinstance(self.shape, Box):
            raise ValueError("a box has no texture coordinates: make it of rectangles")
        if self.texture is not None and isinstance(self.shape, Procedural):
            raise ValueError("a procedural shape has no texture coordinates: give its parts materials of their own")
        return self

    @model_serializer(mode="wrap")
    def _without_absent_options(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        data: dict[str, Any] = handler(self)
        if data["texture"] is None:
            data.pop("texture")
        return data


class Scene(Spec):
    """All that a capture is generated from: objects, the medium around them, and the rig that records them.

    `declared` holds {path: value}, applied over rig and medium (paths such as "medium.index.group", "laser.pulse.fwhm_s",
    "t0_s"). The result is the instrument as estimators see it, so that a wrong calibration is a wrong value there.
    """

    schema_version: Literal[1] = 1
    name: Annotated[str, Field(min_length=1, max_length=120, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
    title: str
    target: tuple[TargetObject, ...]
    medium: Medium
    rig: Rig
    declared: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _names_differ(self) -> Scene:
        names = [o.name for o in self.target]
        if len(set(names)) != len(names):
            raise ValueError(f"target objects need different names, got {names}")
        return self

    @model_validator(mode="after")
    def _rig_has_a_target(self) -> Scene:
        if not self.target and rig_kind(self.modality).needs_target:
            short = {"field_type": "Tuple", "min_length": 1, "actual_length": 0}
            error: InitErrorDetails = {"type": "too_short", "loc": ("target",), "input": [], "ctx": short}
            raise ValidationError.from_exception_data("Scene", [error])
        return self

    @model_validator(mode="after")
    def _water_type_has_the_lasers_wavelength(self) -> Scene:
        water, laser = self.medium.water_type, self.rig.wavelength_m
        if water is not None and abs(water.wavelength_m - laser) > 5e-10:
            raise ValueError(
                f"medium.water_type.wavelength_m {water.wavelength_m:g} is not that of the laser, {laser:g}"
            )
        return self

    @property
    def modality(self) -> str:
        """The modality of the captures that this scene gives."""
        return self.rig.kind


def sizes_of(scene: Scene) -> tuple[int, int, int]:
    """Samples per element, rows and columns of elements of the scene's captures: slices of pixels of a stack; samples
    of a row of shots for waveforms, and frequencies × phases of them for amplitude modulation."""
    return rig_kind(scene.modality).sizes(scene.rig)
