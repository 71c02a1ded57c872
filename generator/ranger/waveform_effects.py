"""The catalogue of effects of waveform captures."""

from __future__ import annotations

import numpy as np

from ...optics.correlation.detector_response import response_variance
from ...scenes.rigs.waveform import AnalogReadout, waveform_rig
from ...scenes.scene import Scene
from ..effect import Effect, effect
from ..model import Expected
from .effects import common_effects
from .footprint import Footprint
from .waveform_signal import waveform_ranger

__all__ = ["waveform_effects"]


def waveform_effects(scene: Scene, expected: Expected[Footprint], rung: str) -> list[Effect]:
    """Every catalogued effect of a waveform capture at the rung."""
    rig = waveform_rig(scene)
    readout, response = rig.detector.readout, rig.detector.response
    analog = isinstance(readout, AnalogReadout)
    effects = common_effects(scene, waveform_ranger(scene), expected, rung)
    # Shot noise of a current that lasts σ_h is correlated over neighbours: of its variance in a sample of Δ, about
    # σ_h/Δ (at most 1) is shared instead of independent.
    shared = min(float(np.sqrt(response_variance(response.shape, response.rise_time_s))) / rig.record.step_s, 1.0)
    return [
        *effects,
        effect("detector's impulse response", True, None, "pulse convolved with it, exact"),
        effect("correlated shot noise of samples", False, None if analog else 0.0,
                f"about {shared:.2g} of the shot noise's variance is shared between neighbouring samples"
                if analog else "counts are independent"),
        effect("pulse energy fluctuation", bool(rig.laser.energy_fluctuation), rig.laser.energy_fluctuation,
                "rms per shot"),
        effect("jitter of pulses", bool(rig.laser.jitter_pulse_s), None, "broadens and moves the record"),
        effect("jitter of shots", bool(rig.laser.jitter_shot_s), None, "moves the record"),
        effect("read noise", analog, None, "Gaussian, white"),
        effect("avalanche excess noise", isinstance(readout, AnalogReadout) and readout.avalanche is not None, None, "gamma"),
        effect("pile-up and dead time", not analog, None, "binomial of live pulses"),
        effect("afterpulsing", False, None if not analog else 0.0, "not modelled"),
        effect("ringing of amplifier and cable", False, None, "not modelled"),
    ]  # fmt: skip
