"""The medium between rig and target: refractive indices and attenuation."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from .base import Index, NonNegative, Spec

__all__ = ["AirIndex", "ExplicitIndex", "Medium", "WaterIndex"]


class ExplicitIndex(Spec):
    """Phase and group index as numbers."""

    kind: Literal["explicit"] = "explicit"
    phase: Index
    group: Index


class WaterIndex(Spec):
    """Indices of water from temperature and salinity (Quan and Fry 1995) at the laser's wavelength."""

    kind: Literal["water"] = "water"
    temperature_c: Annotated[float, Field(ge=0, le=30)]
    salinity_psu: Annotated[float, Field(ge=0, le=35)]


class AirIndex(Spec):
    """Indices of dry air (Ciddor 1996, 450 ppm CO2) at the laser's wavelength."""

    kind: Literal["air"] = "air"
    temperature_c: Annotated[float, Field(ge=-40, le=60)]
    pressure_pa: Annotated[float, Field(ge=8e4, le=1.2e5)]


class Medium(Spec):
    """A homogeneous medium. Beam attenuation c = absorption + scattering, 1/m."""

    name: str
    index: Annotated[ExplicitIndex | WaterIndex | AirIndex, Field(discriminator="kind")]
    absorption_per_m: NonNegative
    scattering_per_m: NonNegative

    @property
    def attenuation_per_m(self) -> float:
        """Beam attenuation coefficient c = a + b, 1/m."""
        return self.absorption_per_m + self.scattering_per_m
