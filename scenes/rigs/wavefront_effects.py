"""Effects that a wavefront rig may have: speckle of a diffuse target, and a platform that turns. Absent, each is left out."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from ..base import Spec

__all__ = ["WavefrontEffects"]


class WavefrontEffects(Spec):
    """`speckle_looks`: M independent, fully developed speckle patterns in the light of a frame; contrast 1/√M at a point of the
    array. Each is the field of a rough, evenly lit disc, the beam on the target. `pointing_jitter_rad`: rms angle, along each axis,
    by which the wave at the lenslets is tilted from frame to frame, since the platform turns; it is part of the truth."""

    speckle_looks: Annotated[int, Field(ge=1, le=4096)] | None = None
    pointing_jitter_rad: Annotated[float, Field(ge=0, le=0.1)] | None = None

    @model_serializer(mode="wrap")
    def _without_absent_options(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {name: value for name, value in handler(self).items() if value is not None}
