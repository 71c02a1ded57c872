"""The spec of a wavefront rig: a gated Shack-Hartmann sensor. No physical value has a default."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import SerializerFunctionWrapHandler, model_serializer

from ..quantities import MomentTime, Rate
from ..waveforms import Gate
from .kind import RigSpec
from .parts import Detector
from .wavefront_effects import WavefrontEffects
from .wavefront_parts import ArrayCamera, BeamLaser, Bench, Imager, Lenslets, Pupil, Series
from .wavefront_turbulence import Aberration, Turbulence

__all__ = ["WavefrontRig"]

#: Absent options are left out of the data.
_OPTIONAL = ("aberration", "imager", "propagation", "effects")


class WavefrontRig(RigSpec):
    """A collimated pulsed beam, a reflector in the water, and lenslets before a gated camera (Guo et al. 2017, section 6).

    The reflectors are the scene's target, flat and square to the beam; `reflection` says what they return: "mirror", the beam
    itself, so that the phase of the way out doubles on the way back, or "diffuse", light from a spot on the target, whose phase
    is that of the way back. Its speckle is one of the `effects`; without it, it is taken as averaged away.
    `turbulence` lies in the water and is not declared. `propagation`: "phase-screens" adds the phases of all layers in the pupil,
    and lenslets are lit evenly; "split-step" propagates the field between layers, and light scintillates. Files of before this
    choice do not have it and mean phase screens. `imager`: a camera beside the array, if there is one.
    `ambient_e_per_s`: photoelectrons per pixel and second of open gate.
    """

    kind: Literal["wavefront"] = "wavefront"
    laser: BeamLaser
    bench: Bench
    lenslets: Lenslets
    pupil: Pupil
    camera: ArrayCamera
    gate: Gate
    frames: Series
    detector: Detector
    reflection: Literal["mirror", "diffuse"]
    turbulence: Turbulence
    aberration: Aberration | None = None
    imager: Imager | None = None
    propagation: Literal["phase-screens", "split-step"] | None = None
    effects: WavefrontEffects | None = None
    ambient_e_per_s: Rate
    t0_s: MomentTime

    @model_serializer(mode="wrap")
    def _without_absent_options(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        data: dict[str, Any] = handler(self)
        for name in _OPTIONAL:
            if data.get(name) is None:
                data.pop(name, None)
        return data

    @property
    def wavelength_m(self) -> float:
        """Vacuum wavelength of the laser, m."""
        return self.laser.wavelength_m
