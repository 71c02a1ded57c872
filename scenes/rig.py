"""The gated rig: camera, laser, gates, delays and detector. No physical value has a default."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from .base import Fraction, NonNegative, Positive, Spec, Vec3
from .waveforms import Gate, Pulse

__all__ = ["Camera", "Delays", "Detector", "GateMap", "GatedRig", "Illumination", "Intensifier", "Laser"]


class Camera(Spec):
    """A pinhole camera with the radiometry of a lens of `f_number`. The principal point is the array's centre."""

    rows: Annotated[int, Field(ge=1, le=16384)]
    cols: Annotated[int, Field(ge=1, le=16384)]
    pixel_pitch_m: Positive
    focal_length_m: Positive
    f_number: Positive
    transmission: Fraction
    quantum_efficiency: Fraction
    vignetting: Literal["none", "cos4"]


class Illumination(Spec):
    """Angular profile of the diverged beam. `half_angle_rad` is the 1/e² half angle of "gaussian", the edge of "flat-top".

    "measured": `radial_value` on an even grid of angles from 0 to `half_angle_rad`, linear between, zero beyond.
    `offset_rad` turns the beam's centre from the camera's axis, along x and y.
    """

    profile: Literal["gaussian", "flat-top", "measured"]
    half_angle_rad: Annotated[float, Field(gt=0, lt=1.5)]
    offset_rad: tuple[float, float]
    radial_value: tuple[NonNegative, ...] | None = None

    @model_validator(mode="after")
    def _measured_has_values(self) -> Illumination:
        if (self.profile == "measured") != (self.radial_value is not None):
            raise ValueError('radial_value is given with profile "measured", and only with it')
        if self.radial_value is not None and (len(self.radial_value) < 2 or sum(self.radial_value) <= 0):
            raise ValueError("radial_value needs at least two values, not all zero")
        return self


class Laser(Spec):
    """A pulsed laser. `jitter_shot_s` is drawn per pulse (broadens the response), `jitter_frame_s` per slice."""

    wavelength_m: Annotated[float, Field(gt=1e-7, lt=2e-5)]
    pulse_energy_j: Positive
    pulse: Pulse
    illumination: Illumination
    position_m: Vec3
    energy_fluctuation: Fraction
    jitter_shot_s: NonNegative
    jitter_frame_s: NonNegative


class GateMap(Spec):
    """Per-pixel gate timing of an intensifier: opening later by `iris_s`·ρ² (ρ: radius/corner radius) plus a skew
    of `skew_s` per half width along (x, y)."""

    iris_s: float
    skew_s: tuple[float, float]


class Delays(Spec):
    """Delays of the slices as set on the delay generator: start + step·k, each `repeats` times, then laser-off slices."""

    start_s: float
    step_s: Positive
    count: Annotated[int, Field(ge=1, le=65536)]
    repeats: Annotated[int, Field(ge=1, le=65536)] = 1
    laser_off: Annotated[int, Field(ge=0, le=65536)] = 0


class Intensifier(Spec):
    """Image intensifier: gain G and excess noise factor F² (≥ 1) of the gamma model; phosphor spread in pixels (1 σ)."""

    gain: Positive
    excess_noise_factor: Annotated[float, Field(ge=1)]
    phosphor_sigma_px: NonNegative


class Detector(Spec):
    """The sensor after the gate, in electrons and DN (EMVA 1288). `adc_bits` up to 16; counts clip at 2^bits − 1."""

    dark_current_e_per_s: NonNegative
    exposure_s: Positive
    read_noise_e: NonNegative
    prnu: Fraction
    dsnu_e: NonNegative
    gain_dn_per_e: Positive
    offset_dn: NonNegative
    full_well_e: Positive
    adc_bits: Annotated[int, Field(ge=1, le=16)]
    fixed_pattern_seed: Annotated[int, Field(ge=0)]
    intensifier: Intensifier | None = None


class GatedRig(Spec):
    """A range-gated camera with its pulsed laser."""

    kind: Literal["gated"] = "gated"
    camera: Camera
    laser: Laser
    gates: Annotated[tuple[Gate, ...], Field(min_length=1)]
    gate_map: GateMap | None = None
    delays: Delays
    pulses_per_slice: Annotated[int, Field(ge=1)]
    detector: Detector
    ambient_e_per_s: NonNegative
    t0_s: float
