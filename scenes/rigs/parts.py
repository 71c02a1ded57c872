"""Parts that several kinds of rig share: camera, detector, beam profile and receiver. No physical value has a default."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from ..base import Fraction, Spec
from ..quantities import (
    Counts,
    Distance,
    Electrons,
    ExcessNoise,
    FNumber,
    Gain,
    LensLength,
    LongTime,
    OffsetAngle,
    Rate,
    SmallLength,
    Weight,
    Well,
)

__all__ = [
    "Camera",
    "Detector",
    "Illumination",
    "Intensifier",
    "Receiver",
    "collected_m2_sr",
    "illumination_data",
    "pixel_collected_m2_sr",
]


class Camera(Spec):
    """A pinhole camera with the radiometry of a lens of `f_number`. The principal point is the array's centre.

    `focus_distance_m` (absent: all is sharp) is the plane z at which a thin lens of diameter f/N is focused; the `full` rung
    blurs what lies before and behind it.
    """

    rows: Annotated[int, Field(ge=1, le=16384)]
    cols: Annotated[int, Field(ge=1, le=16384)]
    pixel_pitch_m: SmallLength
    focal_length_m: LensLength
    f_number: FNumber
    transmission: Fraction
    quantum_efficiency: Fraction
    vignetting: Literal["none", "cos4"]
    focus_distance_m: Distance | None = None

    @model_serializer(mode="wrap")
    def _without_absent_focus(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        data: dict[str, Any] = handler(self)
        if data.get("focus_distance_m") is None:
            data.pop("focus_distance_m", None)
        return data


class Illumination(Spec):
    """Angular profile of the diverged beam. `half_angle_rad` is the 1/e² half angle of "gaussian", the edge of "flat-top".

    "measured": `radial_value` on an even grid of angles from 0 to `half_angle_rad`, linear between, zero beyond.
    `offset_rad` turns the beam's centre from the camera's axis, along x and y.
    """

    profile: Literal["gaussian", "flat-top", "measured"]
    half_angle_rad: Annotated[float, Field(ge=1e-9, lt=1.5)]
    offset_rad: tuple[OffsetAngle, OffsetAngle]
    radial_value: tuple[Weight, ...] | None = None

    @model_validator(mode="after")
    def _measured_has_values(self) -> Illumination:
        if (self.profile == "measured") != (self.radial_value is not None):
            raise ValueError('radial_value is given with profile "measured", and only with it')
        if self.radial_value is not None and (len(self.radial_value) < 2 or sum(self.radial_value) <= 0):
            raise ValueError("radial_value needs at least two values, not all zero")
        return self


def illumination_data(illumination: Illumination) -> dict[str, Any]:
    """The beam's profile as declared."""
    return {
        "profile": illumination.profile,
        "half_angle_rad": illumination.half_angle_rad,
        "offset_rad": list(illumination.offset_rad),
    }


class Intensifier(Spec):
    """Image intensifier: gain G and excess noise factor F² (≥ 1) of the gamma model; phosphor spread in pixels (1 σ)."""

    gain: Gain
    excess_noise_factor: ExcessNoise
    phosphor_sigma_px: Annotated[float, Field(ge=0, le=1e4)]


class Detector(Spec):
    """The sensor after the gate, in electrons and DN (EMVA 1288). `adc_bits` up to 16; counts clip at 2^bits − 1."""

    dark_current_e_per_s: Rate
    exposure_s: LongTime
    read_noise_e: Electrons
    prnu: Fraction
    dsnu_e: Electrons
    gain_dn_per_e: Gain
    offset_dn: Counts
    full_well_e: Well
    adc_bits: Annotated[int, Field(ge=1, le=16)]
    fixed_pattern_seed: Annotated[int, Field(ge=0)]
    intensifier: Intensifier | None = None


class Receiver(Spec):
    """The lens before the detector. The field's half angle is detector diameter/(2 focal length); the lens is taken as
    focused on the target (one focused far away would lose light nearer than aperture · focal length/detector)."""

    aperture_diameter_m: LensLength
    focal_length_m: LensLength
    transmission: Fraction


def pixel_collected_m2_sr(camera: Camera) -> float:
    """Etendue of a pixel on the axis, p² π/4F², times the lens's transmission, m² sr."""
    return camera.pixel_pitch_m**2 * math.pi / (4.0 * camera.f_number**2) * camera.transmission


def collected_m2_sr(receiver: Receiver, detector_diameter_m: float) -> float:
    """Etendue of lens and detector, A · 2π(1 − cos θ) with tanθ = D/2f, times the lens's transmission, m² sr."""
    half = math.atan2(0.5 * detector_diameter_m, receiver.focal_length_m)
    solid = 4.0 * math.pi * math.sin(0.5 * half) ** 2
    return 0.25 * math.pi * receiver.aperture_diameter_m**2 * solid * receiver.transmission
