"""The gated rig: camera, laser, gates, delays and detector. No physical value has a default."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from ..ambient import AmbientSpectrum, ambient_rate, without_computed
from ..base import Fraction, Spec
from ..quantities import (
    Counts,
    Distance,
    Electrons,
    Energy,
    ExcessNoise,
    FNumber,
    Gain,
    LensLength,
    LongTime,
    MomentTime,
    OffsetAngle,
    OptionalLength,
    OptionalTime,
    Place,
    Rate,
    SmallLength,
    StepTime,
    Velocity,
    Weight,
    Well,
)
from ..waveforms import Gate, Pulse

__all__ = ["Camera", "Delays", "Detector", "GateMap", "GatedRig", "Illumination", "Intensifier", "Laser", "Screen"]


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


class Laser(Spec):
    """A pulsed laser. `jitter_shot_s` is drawn per pulse (broadens the response), `jitter_frame_s` per slice.

    `source_radius_m` (0: a point): radius of an evenly bright disc across the beam, of which every point sends out the same
    profile; the `full` rung models it.
    """

    wavelength_m: Annotated[float, Field(gt=1e-7, lt=2e-5)]
    pulse_energy_j: Energy
    pulse: Pulse
    illumination: Illumination
    position_m: Place
    energy_fluctuation: Fraction
    jitter_shot_s: OptionalTime
    jitter_frame_s: OptionalTime
    source_radius_m: OptionalLength = 0.0

    @model_serializer(mode="wrap")
    def _without_absent_source(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        data: dict[str, Any] = handler(self)
        if data.get("source_radius_m") == 0.0:
            data.pop("source_radius_m", None)
        return data


class GateMap(Spec):
    """Per-pixel gate timing of an intensifier: opening later by `iris_s`·ρ² (ρ: radius/corner radius) plus a skew
    of `skew_s` per half width along (x, y)."""

    iris_s: MomentTime
    skew_s: tuple[MomentTime, MomentTime]


class Delays(Spec):
    """Delays of the slices as set on the delay generator: start + step·k, each `repeats` times, then laser-off slices."""

    start_s: MomentTime
    step_s: StepTime
    count: Annotated[int, Field(ge=1, le=65536)]
    repeats: Annotated[int, Field(ge=1, le=65536)] = 1
    laser_off: Annotated[int, Field(ge=0, le=65536)] = 0


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


class Screen(Spec):
    """A second surface in every pixel: a plane across the view at z = `distance_m` with holes too small to be resolved (a
    net, bubbles, a dirty port). The share `coverage` of each pixel sees Lambert matter of `albedo`, the rest sees past it."""

    distance_m: Distance
    coverage: Annotated[float, Field(ge=0, lt=1)]
    albedo: Fraction


#: Absent options are left out of the data, so that a rig without them reads as it always did.
_OPTIONAL = ("motion_m_per_s", "screen")


class GatedRig(Spec):
    """A range-gated camera with its pulsed laser.

    `motion_m_per_s`: the platform's velocity; the scene is as written at the middle of the capture's time, and each slice
    is taken at once. `screen`: unresolved matter before the target, of which estimators are not told. Ambient light is
    told as `ambient_e_per_s` (photoelectrons per pixel and second of open gate), or by its spectrum, `ambient`.
    """

    kind: Literal["gated"] = "gated"
    camera: Camera
    laser: Laser
    gates: Annotated[tuple[Gate, ...], Field(min_length=1)]
    gate_map: GateMap | None = None
    delays: Delays
    pulses_per_slice: Annotated[int, Field(ge=1, le=10**12)]
    detector: Detector
    ambient_e_per_s: Rate = 0.0
    ambient: AmbientSpectrum | None = None
    t0_s: MomentTime
    motion_m_per_s: Velocity | None = None
    screen: Screen | None = None

    @model_serializer(mode="wrap")
    def _without_absent_options(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        data: dict[str, Any] = handler(self)
        for key in _OPTIONAL:
            if data.get(key) is None:
                data.pop(key, None)
        return without_computed(data)

    @model_validator(mode="after")
    def _ambient_is_told_once(self) -> GatedRig:
        camera = self.camera
        pixel = camera.pixel_pitch_m**2 * math.pi / (4.0 * camera.f_number**2) * camera.transmission
        self.__dict__["ambient_e_per_s"] = ambient_rate(self, pixel, camera.quantum_efficiency)
        return self
