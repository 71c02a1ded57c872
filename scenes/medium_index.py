"""Refractive indices of the medium at a wavelength, and the medium as a rig declares it."""

from __future__ import annotations

from typing import Any, Literal

from ..optics.water import refraction
from .errors import InputError
from .medium import AirIndex, ExplicitIndex, Medium, WaterIndex

__all__ = ["group_index", "medium_data", "phase_index"]


def phase_index(medium: Medium, wavelength_m: float) -> float:
    """Phase refractive index of the medium at the vacuum wavelength."""
    return _index(medium, wavelength_m, "phase")


def group_index(medium: Medium, wavelength_m: float) -> float:
    """Group refractive index of the medium at the vacuum wavelength: pulses travel at c/n_g."""
    return _index(medium, wavelength_m, "group")


def _index(medium: Medium, wavelength_m: float, which: Literal["phase", "group"]) -> float:
    index = medium.index
    try:
        if isinstance(index, ExplicitIndex):
            return index.phase if which == "phase" else index.group
        if isinstance(index, WaterIndex):
            water = refraction.water_phase_index if which == "phase" else refraction.water_group_index
            return float(water(wavelength_m, index.temperature_c, index.salinity_psu))
        assert isinstance(index, AirIndex)
        air = refraction.air_phase_index if which == "phase" else refraction.air_group_index
        return float(air(wavelength_m, index.temperature_c, index.pressure_pa))
    except ValueError as error:
        raise InputError(
            "The formula of the medium's index does not hold at this wavelength.",
            where="medium.index",
            value=wavelength_m,
            allowed=str(error),
            next_step='give it as numbers: index = { kind = "explicit", phase = ..., group = ... }',
        ) from error


def medium_data(medium: Medium, wavelength_m: float) -> dict[str, Any]:
    """The medium as declared: indices as numbers at the laser's wavelength, attenuation in 1/m."""
    return {
        "name": medium.name,
        "phase_index": phase_index(medium, wavelength_m),
        "group_index": group_index(medium, wavelength_m),
        "absorption_per_m": medium.absorption_per_m,
        "scattering_per_m": medium.scattering_per_m,
    }
