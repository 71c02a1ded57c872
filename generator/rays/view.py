"""A view: the camera, the lamp and the light of one exposure, which is all that light transport needs of a rig."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...optics import ladar
from ...scenes.rigs.parts import Camera
from .lamp import Lamp

__all__ = ["View"]

Float = NDArray[np.float64]
LampT = TypeVar("LampT", bound=Lamp, covariant=True)


@dataclass(frozen=True)
class View(Generic[LampT]):
    """One exposure.

    Main arguments:
        camera: at the origin, looks along z. lamp: where the light comes from.
        energy_j: of one pulse [J]; `pulses` of them are collected in an exposure.
        wavelength_m: of the lamp's light in vacuum [m].
    """

    camera: Camera
    lamp: LampT
    energy_j: float
    pulses: int
    wavelength_m: float

    @property
    def coaxial(self) -> bool:
        """Whether lamp and camera are at one point."""
        return not any(self.lamp.position_m)

    def falloff(self, cos_field: Float) -> Float | float:
        """The cosine that the lens's cos⁴ falloff is taken of, at rays of direction cosine z; 1 without vignetting."""
        return cos_field if self.camera.vignetting == "cos4" else 1.0

    def electrons(
        self,
        *,
        intensity_per_sr: ArrayLike = 1.0,
        response_per_sr: ArrayLike = 1.0,
        lamp_range_m: ArrayLike = 1.0,
        camera_range_m: ArrayLike = 1.0,
        attenuation_per_m: float = 0.0,
        cos_field: ArrayLike = 1.0,
    ) -> Float:
        """Photoelectrons of a pixel in one exposure at an open gate, as `ladar.pixel_photoelectrons`.

        With its defaults: photoelectrons per radiance that a unit of emitted energy gives.
        """
        camera = self.camera
        return self.pulses * ladar.pixel_photoelectrons(
            pulse_energy_j=self.energy_j,
            intensity_per_sr=intensity_per_sr,
            lamp_range_m=lamp_range_m,
            camera_range_m=camera_range_m,
            attenuation_per_m=attenuation_per_m,
            response_per_sr=response_per_sr,
            pixel_area_m2=camera.pixel_pitch_m**2,
            f_number=camera.f_number,
            cos_field=cos_field,
            transmission=camera.transmission,
            quantum_efficiency=camera.quantum_efficiency,
            wavelength_m=self.wavelength_m,
        )
