"""Sizes of what the rungs leave out of a waveform, for the choice between them."""

from __future__ import annotations

import numpy as np

from ...optics.constants import C_M_PER_S
from ...optics.correlation.waveforms import pulse_variance
from ...optics.water.phase_forms import PhaseFunction
from ...scenes.medium_index import group_index
from ...scenes.rigs.waveform import shown_pulse, waveform_rig
from ...scenes.scene import Scene
from .choose import Instrument, Stack, nearest_water_m, turned_back_and_matt
from .footprint import Footprint
from .waveform_signal import expected_waveform, waveform_ranger

__all__ = ["waveform_instrument"]


def waveform_instrument(scene: Scene) -> Instrument:
    """The ranger, its backscatter and its samples."""
    rig, medium = waveform_rig(scene), scene.medium
    ranger = waveform_ranger(scene)

    def backscatter(phase: PhaseFunction, range_m: float) -> float:
        """Brightest moment of the record against the echo's peak: b β̃(π) w e^{2c(r − r₀)} (r/r₀)²/(ρ/π), w = ½ c/n_g √(2π)σ
        of the pulse, r₀ where the record begins."""
        turned, matt = turned_back_and_matt(scene, phase)
        half_speed = 0.5 * C_M_PER_S / group_index(medium, ranger.wavelength_m)
        width = half_speed * float(np.sqrt(2.0 * np.pi * pulse_variance(shown_pulse(rig)[0])))
        first = min(max(rig.record.start_s * half_speed, nearest_water_m(ranger)), range_m)
        loss = np.exp(2.0 * medium.attenuation_per_m * (range_m - first))
        return float(turned * width / matt * loss * (range_m / first) ** 2)

    def samples(beam: Footprint) -> tuple[Stack, float, float]:
        signal, ambient = expected_waveform(scene, beam, 0, 0)
        return signal, ambient, float(getattr(rig.detector.readout, "read_noise_e", 0.0))

    return Instrument(ranger, backscatter, samples)
