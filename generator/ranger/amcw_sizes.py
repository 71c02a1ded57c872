"""Sizes of what the rungs leave out of amplitude-modulated samples, for the choice between them."""

from __future__ import annotations

import numpy as np

from ...optics.water.phase_forms import PhaseFunction
from ...scenes.rigs.amcw import amcw_rig
from ...scenes.scene import Scene
from .amcw_samples import amcw_ranger, expected_samples
from .choose import Instrument, Stack, nearest_water_m, turned_back_and_matt
from .footprint import Footprint

__all__ = ["amcw_instrument"]


def amcw_instrument(scene: Scene) -> Instrument:
    """The ranger, its backscatter and its samples."""
    ranger = amcw_ranger(scene)

    def backscatter(phase: PhaseFunction, range_m: float) -> float:
        """All of the water's light against the target's: ∫ b β̃(π) e^{2c(R − r)} (R/r)² dr/(ρ/π)."""
        turned, matt = turned_back_and_matt(scene, phase)
        r = np.geomspace(min(nearest_water_m(ranger), range_m), range_m, 512)
        loss = np.exp(2.0 * scene.medium.attenuation_per_m * (range_m - r))
        return float(np.trapezoid(turned * loss * (range_m / r) ** 2 / matt, r))

    def samples(beam: Footprint) -> tuple[Stack, float, float]:
        wave, ambient = expected_samples(scene, beam, 0, 0)
        return wave.astype(np.float32), ambient, amcw_rig(scene).detector.read_noise_e

    return Instrument(ranger, backscatter, samples)
