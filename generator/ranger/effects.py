"""The catalogue of effects of the one-detector rangers (waveform, amcw) at the rungs `direct` and `scatter`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S
from ...optics.correlation.detector_response import response_variance
from ...optics.water.halo import forward_share
from ...optics.water.phase_function import asymmetry, mean_square_angle
from ...scenes.medium_index import group_index
from ...scenes.rigs.amcw import amcw_rig
from ...scenes.rigs.waveform import AnalogReadout, waveform_rig
from ...scenes.scene import Scene
from ..gated.effects import interreflection
from .footprint import Footprint, Ranger
from .scatter import forward_gain

__all__ = ["amcw_effects", "waveform_effects"]

Float = NDArray[np.float64]


def waveform_effects(scene: Scene, beam: Footprint, truth_range: Float, rung: str = "direct") -> list[dict[str, Any]]:
    """Every catalogued effect: `name`, `modelled`, `predicted_relative_size` (or None), `basis`."""
    rig = waveform_rig(scene)
    readout, response = rig.detector.readout, rig.detector.response
    analog = isinstance(readout, AnalogReadout)
    effects = _common(scene, beam, truth_range, rung)
    # Shot noise of a current that lasts σ_h is correlated over neighbours: of its variance in a sample of Δ, about
    # σ_h/Δ (at most 1) is shared instead of independent.
    shared = min(float(np.sqrt(response_variance(response.shape, response.rise_time_s))) / rig.record.step_s, 1.0)
    return [
        *effects,
        _effect("detector's impulse response", True, None, "pulse convolved with it, exact"),
        _effect("correlated shot noise of samples", False, None if analog else 0.0,
                f"about {shared:.2g} of the shot noise's variance is shared between neighbouring samples"
                if analog else "counts are independent"),
        _effect("pulse energy fluctuation", bool(rig.laser.energy_fluctuation), rig.laser.energy_fluctuation,
                "rms per shot"),
        _effect("jitter of pulses", bool(rig.laser.jitter_pulse_s), None, "broadens the waveform"),
        _effect("jitter of shots", bool(rig.laser.jitter_shot_s), None, "moves the record"),
        _effect("read noise", analog, None, "Gaussian, white"),
        _effect("avalanche excess noise", isinstance(readout, AnalogReadout) and readout.avalanche is not None, None, "gamma"),
        _effect("pile-up and dead time", not analog, None, "binomial of live pulses"),
        _effect("afterpulsing", False, None if not analog else 0.0, "not modelled"),
        _effect("ringing of amplifier and cable", False, None, "not modelled"),
    ]  # fmt: skip


def amcw_effects(scene: Scene, beam: Footprint, truth_range: Float, rung: str = "direct") -> list[dict[str, Any]]:
    """Every catalogued effect of an AMCW capture, as `waveform_effects`."""
    rig = amcw_rig(scene)
    return [
        *_common(scene, beam, truth_range, rung),
        _effect("power fluctuation", bool(rig.laser.power_fluctuation), rig.laser.power_fluctuation, "rms per shot"),
        _effect("harmonics of the modulation", False, 0.0, "laser and reference are pure cosines"),
        _effect("ambiguity of the phase", True, None, "phases repeat every half modulation wavelength"),
        _effect("read noise", True, None, "Gaussian"),
        _effect("multi-path phasors of the footprint", True, None, "rays add as phasors"),
    ]


def _effect(name: str, modelled: bool, size: float | None, basis: str) -> dict[str, Any]:
    return {"name": name, "modelled": modelled, "predicted_relative_size": size, "basis": basis}


def _common(scene: Scene, beam: Footprint, truth_range: Float, rung: str) -> list[dict[str, Any]]:
    typical = float(np.nanmedian(truth_range)) if np.isfinite(truth_range).any() else 0.0
    c = scene.medium.attenuation_per_m
    return [
        _effect("first bounce", True, 1.0, "Mitsuba first hits, exact times"),
        _effect("footprint", True, None, f"{beam.tau.shape[1]} even rays a shot"),
        _effect("beam attenuation", True, float(-np.expm1(-2 * c * typical)), "1 − e^(−2cr)"),
        _effect("group index", True, None, "all times at c/n_g"),
        *_scattering(scene, typical, rung == "scatter"),
        _effect("interreflection", False, *interreflection(scene)),
        _effect("parallax of laser and lens", False, 0.0, "coaxial"),
        _effect("defocus of near ranges", False, None, "the lens is taken as focused on the target"),
        _effect("speckle", False, None, "not modelled; contrast 1/√M"),
        _effect("photon noise", True, None, "Poisson"),
    ]


def _scattering(scene: Scene, range_m: float, there: bool) -> list[dict[str, Any]]:
    """Light scattered forward and back, before a wall at `range_m`; by the scatter rung's own quadrature, untraced."""
    b, phase = scene.medium.scattering_per_m, scene.medium.phase
    if b == 0.0 or range_m == 0.0 or phase is None:
        wide = float(np.expm1(min(2 * b * range_m, 50.0)))
        back, why = (0.0, "nothing scatters") if b == 0.0 else (None, "needs the phase function")
        return [
            _effect("forward-scattered light", there, wide, "e^(2br) − 1, wide beam"),
            _effect("volume backscatter", there, back, why),
            _effect("delay of scattered light", False, back, why),
            _effect("multiple scattering", False, back, why),
        ]
    ranger = Ranger.of(scene)
    late = 2.0 * b * forward_share(phase) * range_m**2 * mean_square_angle(phase) / 12.0
    turned = float(-np.expm1(-2.0 * b * (1.0 - asymmetry(phase)) * range_m))
    seconds = late * group_index(scene.medium, ranger.wavelength_m) / C_M_PER_S
    gain = forward_gain(scene, phase, range_m) - 1.0
    return [
        _effect("forward-scattered light", there, gain if np.isfinite(gain) else None, "over the unscattered echo"),
        _effect("volume backscatter", there, None, "single scattering, up to the target"),
        _effect("delay of scattered light", False, None, f"{seconds:.2g} s on the mean: br²⟨ψ²⟩/6"),
        _effect("multiple scattering", False, turned, "1 − e^(−2b(1 − g)r)"),
    ]
