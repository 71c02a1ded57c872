"""The waveform rig: a pulsed laser and one photodetector whose signal is sampled against time. No physical value has a
default.

Laser and receiver are coaxial (a beam splitter), at the camera frame's origin, and look along z; a scan turns both.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from ...optics.correlation import waveforms
from ...optics.correlation.detector_response import detected_pulse
from ..ambient import AmbientSpectrum, ambient_rate, without_computed
from ..base import Fraction, Spec, Vec3
from ..errors import InputError
from ..medium_index import medium_data
from ..quantities import (
    Counts,
    Electrons,
    Energy,
    ExcessNoise,
    Frequency,
    Gain,
    MomentTime,
    OptionalTime,
    PulseTime,
    Rate,
    SmallLength,
    StepTime,
    Well,
)
from ..sampling import optics_pulse, rounded, sample_step_s
from ..waveforms import Pulse
from .declaring import as_declared
from .kind import RigKind, RigScene, RigSpec, RigView, rig_of
from .parts import Illumination, Receiver, collected_m2_sr, illumination_data
from .roles import Steps

__all__ = [
    "KIND", "AnalogReadout", "Avalanche", "ImpulseResponse", "Photodetector", "PulsedLaser", "Record",
    "SinglePhotonReadout", "WaveformRig", "shared_jitter_s", "shown_pulse", "waveform_rig",
]  # fmt: skip

#: Samples per standard deviation of the detected pulse in the declared rig.
_SAMPLES_PER_SIGMA = 32
#: Standard deviations by which two photons of an echo lie apart in 1 of 200 pairs (a Gaussian one): erfc(4/2).
_APART_SIGMAS = 4.0


class PulsedLaser(Spec):
    """A pulsed laser. `jitter_pulse_s` is the rms delay of single pulses: it broadens a record, and the mean of the M pulses of a
    shot scatters by 1/√M of it (`shared_jitter_s`; a gated rig calls this `jitter_shot_s`). `jitter_shot_s` is that of whole
    *records* (a gated rig's `jitter_frame_s`). Both are drawn per shot. `energy_fluctuation` is the relative rms of a shot's
    energy."""

    wavelength_m: Annotated[float, Field(gt=1e-7, lt=2e-5)]
    pulse_energy_j: Energy
    pulse: Pulse
    illumination: Illumination
    energy_fluctuation: Fraction
    jitter_pulse_s: OptionalTime
    jitter_shot_s: OptionalTime


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


class WaveformRig(RigSpec):
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
    def _ambient_is_given_once(self) -> WaveformRig:
        collected = collected_m2_sr(self.receiver, self.detector.active_diameter_m)
        self.__dict__["ambient_e_per_s"] = ambient_rate(self, collected, self.detector.quantum_efficiency)
        return self

    @property
    def wavelength_m(self) -> float:
        """Vacuum wavelength of the laser, m."""
        return self.laser.wavelength_m


def waveform_rig(scene: RigScene) -> WaveformRig:
    """The scene's rig, which must be a waveform rig. Raises InputError for a scene of another modality."""
    return rig_of(scene, WaveformRig)


def shown_pulse(rig: WaveformRig) -> tuple[waveforms.Pulse, float]:
    """(the pulse as detector and jitter show it, centroid 0; its mean delay behind the light, s)."""
    laser, response = rig.laser, rig.detector.response
    pulse = waveforms.broadened(optics_pulse(laser.pulse), laser.jitter_pulse_s)
    return detected_pulse(pulse, response.shape, response.rise_time_s)


def shared_jitter_s(rig: WaveformRig) -> float:
    """Rms of the mean delay of a shot's pulses, s, which all that the shot shows has in common: σ/√M.

    It is 0 where the photons of one pulse's echo cannot be counted twice: a single-photon detector that is blind for longer
    than two photons lie apart takes each count from another pulse, with a delay of its own. The counts are then independent draws
    from a response broadened by all of σ, however many they are.
    """
    readout = rig.detector.readout
    if isinstance(readout, SinglePhotonReadout):
        pulse, _ = shown_pulse(rig)
        if readout.dead_time_s >= _APART_SIGMAS * math.sqrt(waveforms.pulse_variance(pulse)):
            return 0.0
    return rig.laser.jitter_pulse_s / math.sqrt(rig.pulses_per_shot)


def _declare(scene: RigScene) -> dict[str, Any]:
    """Plain data of a waveform rig as declared (attribute `rig` of a capture).

    `response` is the signal of one photoelectron, 1/s: the pulse as the detector shows it, unit area, time 0 at the
    emitted pulse's centroid; linear between samples. Raises InputError as `declared_rig`.
    """
    rig, medium = as_declared(scene, WaveformRig)
    laser, detector, record = rig.laser, rig.detector, rig.record
    pulse, delay = shown_pulse(rig)
    sigma = float(np.sqrt(waveforms.pulse_variance(pulse)))
    span = float(np.ptp(waveforms.pulse_support(pulse)))
    step = sample_step_s(sigma / _SAMPLES_PER_SIGMA, pulse, span, 1e-13)
    try:
        start, value = waveforms.sample_pulse(pulse, step)
    except ValueError as error:
        raise InputError(
            "The detected pulse cannot be declared as samples.",
            where=f"{scene.name}: rig.laser.pulse",
            value=str(error),
            allowed="a detected pulse of 1 ps or more",
            next_step="lengthen the pulse, or rig.detector.response.rise_time_s",
        ) from error
    # Tails below 1e-9 of the peak carry nothing that a laboratory could record.
    kept = np.flatnonzero(value > 1e-9 * value.max())
    first, last = max(int(kept[0]) - 1, 0), int(kept[-1]) + 2
    return {
        "schema": 1,
        "kind": rig.kind,
        "record": record.model_dump(mode="json"),
        "laser": {
            "wavelength_m": laser.wavelength_m,
            "pulse_energy_j": laser.pulse_energy_j,
            **illumination_data(laser.illumination),
            "energy_fluctuation": laser.energy_fluctuation,
            "jitter_pulse_s": laser.jitter_pulse_s,
            "jitter_shot_s": laser.jitter_shot_s,
        },
        "receiver": rig.receiver.model_dump(mode="json"),
        "response": {
            "start_s": float(start + delay + first * step),
            "step_s": step,
            "value": rounded(value[first:last]),
        },
        "medium": medium_data(medium, laser.wavelength_m),
        "detector": {
            "active_diameter_m": detector.active_diameter_m,
            "quantum_efficiency": detector.quantum_efficiency,
            "rise_time_s": detector.response.rise_time_s,
            "dark_e_per_s": detector.dark_e_per_s,
            "readout": detector.readout.model_dump(mode="json"),
        },
        "ambient_e_per_s": rig.ambient_e_per_s,
        "pulses_per_shot": rig.pulses_per_shot,
        "counter_hz": rig.counter_hz,
        "t0_s": rig.t0_s,
    }


def _check(scene: RigScene) -> None:
    """Every waveform rig whose values are allowed can be built."""


def _sizes(rig: WaveformRig) -> tuple[int, int, int]:
    return rig.record.samples, 1, rig.record.shots


def _places(rig: WaveformRig) -> dict[str, Vec3]:
    return {"camera": (0.0, 0.0, 0.0)}


def _view(rig: WaveformRig) -> RigView:
    return RigView(None, rig.laser.illumination, rig.record.shots, rig.record.scan_half_angle_rad)


def _resize(side: int) -> dict[str, Any]:
    return {"rig.record.shots": side * side}


KIND = RigKind(
    "waveform",
    WaveformRig,
    declare=_declare,
    check=_check,
    sizes=_sizes,
    places=_places,
    view=_view,
    resize=_resize,
    roles={
        "ambient": "rig.ambient_e_per_s",
        "fluctuation": "rig.laser.energy_fluctuation",
        "gain": "rig.detector.readout.gain_dn_per_e",
        "jitter": "rig.laser.jitter_shot_s",
        "light": "rig.laser.pulse_energy_j",
        "pulse": "rig.laser.pulse",
        "pulse-width": "rig.laser.pulse.fwhm_s",
        "read-noise": "rig.detector.readout.read_noise_e",
        "sampling": Steps("rig.record.step_s", "rig.record.samples", least=4),
        "shot-jitter": "rig.laser.jitter_pulse_s",
        "start": "rig.record.start_s",
    },
)
