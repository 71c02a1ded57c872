"""The medium between rig and target: refractive indices, attenuation and scattering."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, ValidationError, model_serializer, model_validator

from ..optics.water import phase_forms
from ..optics.water.phase_function import phase_from_spec
from ..optics.water.types import WaterOptics, water_optics
from .base import Index, NonNegative, Spec
from .phase import PhaseFunction

__all__ = ["AirIndex", "ExplicitIndex", "Medium", "WaterIndex", "WaterType"]


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


class WaterType(Spec):
    """A published water in place of numbers: `source` and `type` as `optics.water` lists them, at `wavelength_m`.

    Sources differ by up to 3.8 × in b for one type, so the source has no default.
    """

    source: Literal["williamson2022", "solonenko2015", "petzold1972", "pure"]
    type: str
    wavelength_m: Annotated[float, Field(gt=3e-7, lt=9e-7)]

    def optics(self) -> WaterOptics:
        """a, b, phase function and provenance. Raises ValueError where the source has no such water."""
        return water_optics(self.source, self.type, self.wavelength_m)


#: Filled in by a water type; giving them beside it is an error.
_FILLED = ("absorption_per_m", "scattering_per_m")


class Medium(Spec):
    """A homogeneous medium. Beam attenuation c = absorption + scattering, 1/m.

    Give a, b (and, for scattered light, `phase_function`), or a `water_type` that holds them. Jerlov's classes determine
    no phase function: with their sources it is given beside the type. Petzold and pure water bring their own.
    """

    name: str
    index: Annotated[ExplicitIndex | WaterIndex | AirIndex, Field(discriminator="kind")]
    absorption_per_m: NonNegative
    scattering_per_m: NonNegative
    phase_function: PhaseFunction | None = None
    water_type: WaterType | None = None

    @model_validator(mode="before")
    @classmethod
    def _fill_from_water_type(cls, data: Any) -> Any:
        given = data.get("water_type") if isinstance(data, dict) else None
        if given is None:
            return data
        both = [key for key in _FILLED if data.get(key) is not None]
        if both:
            raise ValueError(f"give either water_type or {' and '.join(both)}, not both")
        try:
            water = given if isinstance(given, WaterType) else WaterType.model_validate(given)
        except ValidationError:
            return data | dict.fromkeys(_FILLED, 0.0)  # the field itself reports, under its own path
        optics = water.optics()
        if optics.phase is not None and data.get("phase_function") is not None:
            raise ValueError(f"{water.source} has its own phase function: give either water_type or phase_function")
        return data | {"absorption_per_m": optics.absorption_per_m, "scattering_per_m": optics.scattering_per_m}

    @model_serializer(mode="wrap")
    def _without_filled_values(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """As it was given, so that it can be read again and overridden; absent options are left out."""
        data: dict[str, Any] = handler(self)
        if self.water_type is not None:
            for key in _FILLED:
                data.pop(key)
        for key in ("phase_function", "water_type"):
            if data[key] is None:
                data.pop(key)
        return data

    @property
    def attenuation_per_m(self) -> float:
        """Beam attenuation coefficient c = a + b, 1/m."""
        return self.absorption_per_m + self.scattering_per_m

    @property
    def phase(self) -> phase_forms.PhaseFunction | None:
        """The phase function: the one given, else that of the water type; None where neither says."""
        if self.phase_function is not None:
            return phase_from_spec(self.phase_function)
        return None if self.water_type is None else self.water_type.optics().phase
