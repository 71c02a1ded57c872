"""The waveform rig as declared: the detected pulse as samples, the record, the readout."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...optics.correlation import waveforms
from ...optics.correlation.detector_response import detected_pulse
from ..errors import InputError
from ..sampling import sample_step_s
from ..scene import Scene
from .declare import as_declared, medium_data, optics_pulse, rounded
from .gated import Illumination
from .waveform import WaveformRig

__all__ = ["declared_waveform", "illumination_data", "shown_pulse"]

#: Samples per standard deviation of the detected pulse in the declared rig.
_SAMPLES_PER_SIGMA = 32


def shown_pulse(rig: WaveformRig) -> tuple[waveforms.Pulse, float]:
    """(the pulse as detector and jitter show it, centroid 0; its mean delay behind the light, s)."""
    laser, response = rig.laser, rig.detector.response
    pulse = waveforms.broadened(optics_pulse(laser.pulse), laser.jitter_pulse_s)
    return detected_pulse(pulse, response.shape, response.rise_time_s)


def declared_waveform(scene: Scene) -> dict[str, Any]:
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


def illumination_data(illumination: Illumination) -> dict[str, Any]:
    """The beam's profile as declared."""
    return {
        "profile": illumination.profile,
        "half_angle_rad": illumination.half_angle_rad,
        "offset_rad": list(illumination.offset_rad),
    }
