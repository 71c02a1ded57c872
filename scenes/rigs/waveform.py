"""The waveform rig: a pulsed laser and one photodetector whose signal is sampled against time. No physical value has a
default.

Laser and receiver are coaxial (a beam splitter), at the camera frame's origin, and look along z; a scan turns both.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from ..ambient import AmbientSpectrum, ambient_rate, without_computed
from ..base import Fraction, Spec
from ..quantities import (
    Counts,
    Electrons,
    Energy,
    ExcessNoise,
    Frequency,
    Gain,
    LensLength,
    MomentTime,
    OptionalTime,
    PulseTime,
    Rate,
    SmallLength,
    StepTime,
    Well,
)
from ..waveforms import Pulse
from .gated import Illumination

__all__ = [
    "AnalogReadout", "Avalanche", "ImpulseResponse", "Photodetector", "PulsedLaser", "Receiver", "Record",
    "SinglePhotonReadout", "WaveformRig", "collected_m2_sr",
]  # fmt: skip


class PulsedLaser(Spec):
    """A pulsed laser. `jitter_pulse_s` is drawn per pulse (broadens a shot of many pulses), `jitter_shot_s` moves the
    whole record of a shot; `energy_fluctuation` is the relative rms of a shot's energy."""

    wavelength_m: Annotated[float, Field(gt=1e-7, lt=2e-5)]
    pulse_energy_j: Energy
    pulse: Pulse
    illumination: Illumination
    energy_fluctuation: Fraction
    jitter_pulse_s: OptionalTime
    jitter_shot_s: OptionalTime


class Receiver(Spec):
    """The lens before the detector. The field's half angle is detector diameter/(2 focal length); the lens is taken as
    focused on the target (one focused far away would lose light nearer than aperture · focal length/detector)."""

    aperture_diameter_m: LensLength
    focal_length_m: LensLength
    transmission: Fraction


def collected_m2_sr(receiver: Receiver, detector_diameter_m: float) -> float:
    """Etendue of lens and detector, A · 2π(1 − cos θ) with tanθ = D/2f, times the lens's transmission, m² sr."""
    half = math.atan2(0.5 * detector_diameter_m, receiver.focal_length_m)
    solid = 4.0 * math.pi * math.sin(0.5 * half) ** 2
    return 0.25 * math.pi * receiver.aperture_diameter_m**2 * solid * receiver.transmission


class ImpulseResponse(Spec):
    """How the charge of one photoelectron is spread over time, by its 10-90 % rise time.

    "gaussian": σ = rise/2.5631, the mean charge undelayed; "single-pole": exp(−t/τ)/τ with τ = rise/ln 9, which delays
    the mean charge by τ.
    """

    shape: Literal["gaussian", "single-pole"]
    rise_time_s: PulseTime


class Avalanche(Spec):
    """Internal gain of an avalanche photodiode or photomultiplier, and its excess noise factor F² (≥ 1)."""

    gain: Gain
    excess_noise_factor: ExcessNoise


class AnalogReadout(Spec):
    """A sampling converter. Each sample is the charge of its interval: Poisson (and avalanche) noise, then Gaussian
    `read_noise_e` per sample, gain, offset and rounding; clipped at `full_well_e` and 2^bits − 1."""

    kind: Literal["analog"] = "analog"
    read_noise_e: Electrons
    gain_dn_per_e: Gain
    offset_dn: Counts
    full_well_e: Well
    adc_bits: Annotated[int, Field(ge=1, le=16)]
    avalanche: Avalanche | None = None


class SinglePhotonReadout(Spec):
    """Time-correlated single-photon counting: at most one count per pulse and bin, then blind for `dead_time_s`.

    The histogram of `pulses_per_shot` pulses piles up: early bins hide later ones.
    """

    kind: Literal["single-photon"] = "single-photon"
    dead_time_s: Annotated[float, Field(ge=0, le=1)]


class Photodetector(Spec):
    """A photodetector: its disc, quantum efficiency, speed, dark rate and readout."""

    active_diameter_m: SmallLength
    quantum_efficiency: Fraction
    response: ImpulseResponse
    dark_e_per_s: Rate
    readout: Annotated[AnalogReadout | SinglePhotonReadout, Field(discriminator="kind")]


class Record(Spec):
    """What is recorded: sample k covers start + k·step ± step/2 after the pulse's centroid leaves; `shots` records.

    `scan_half_angle_rad`: shots look along evenly spaced angles from −a to +a in the x-z plane; 0 stares along z.
    """

    start_s: MomentTime
    step_s: StepTime
    samples: Annotated[int, Field(ge=4, le=65536)]
    shots: Annotated[int, Field(ge=1, le=65536)]
    scan_half_angle_rad: Annotated[float, Field(ge=0, lt=1.5)]


class WaveformRig(Spec):
    """A pulsed ranger: laser, lens, photodetector, recorder. `counter_hz`: oscillator of the counter that times the
    pulse instead of sampling it (Kusters 1992, Figure 2.2), None where there is none."""

    kind: Literal["waveform"] = "waveform"
    laser: PulsedLaser
    receiver: Receiver
    detector: Photodetector
    record: Record
    pulses_per_shot: Annotated[int, Field(ge=1, le=65535)]
    ambient_e_per_s: Rate = 0.0
    ambient: AmbientSpectrum | None = None
    counter_hz: Frequency | None = None
    t0_s: MomentTime

    @model_validator(mode="after")
    def _window_is_bounded(self) -> WaveformRig:
        if self.record.samples * self.record.shots > 1 << 28:
            raise ValueError("samples × shots must not exceed 2^28")
        return self

    @model_serializer(mode="wrap")
    def _without_absent_options(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_computed(handler(self))

    @model_validator(mode="after")
    def _ambient_is_told_once(self) -> WaveformRig:
        collected = collected_m2_sr(self.receiver, self.detector.active_diameter_m)
        self.__dict__["ambient_e_per_s"] = ambient_rate(self, collected, self.detector.quantum_efficiency)
        return self
