"""The truth of turbulence: its strength at every gate, and where the strongest layer is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...scenes.rigs.wavefront_spec import WavefrontRig
from ...scenes.rigs.wavefront_turbulence import layers_of
from .field import Pupils

__all__ = ["turbulence_truth"]

Float = NDArray[np.float64]


def turbulence_truth(rig: WavefrontRig, pupils: Pupils, delay: Float, range_m: Float) -> dict[str, Float]:
    """`truth_r0` [m] and `truth_present` (gate), gates in the order of their delays, and `truth_source` [m] (layer).

    Main arguments: delay (frame) [s]; range_m (frame): of the reflector whose light is most of a frame's.

    Strengths r0^{−5/3} of layers add: 2² times that of one pass before a mirror; (1 − z/r)^{5/3} of it before a diffuse target.
    On the array r0 is larger by the magnification. r0 is that of Kolmogorov's law, also of a layer with an outer scale.
    """
    first = np.unique(delay, return_index=True)[1]
    strength = np.array([_strength(pupils, float(range_m[frame])) for frame in first])
    with np.errstate(divide="ignore"):
        r0 = np.where(strength > 0.0, rig.bench.magnification * np.where(strength > 0, strength, 1.0) ** -0.6, np.nan)
    reached = [layer for layer in layers_of(rig.turbulence) if layer in pupils.before(float(range_m.max()))]
    strongest = min(reached, key=lambda layer: layer.r0_m, default=None)
    at = np.nan if strongest is None else strongest.range_m
    return {"truth_r0": r0, "truth_present": (strength > 0.0).astype(np.float64), "truth_source": np.array([at])}


def _strength(pupils: Pupils, range_m: float) -> float:
    """r0^{−5/3} [m^{−5/3}] in lengths of the water."""
    total = 0.0
    for layer in pupils.before(range_m):
        passed = 4.0 if pupils.mirror else max(1.0 - layer.range_m / range_m, 0.0) ** (5.0 / 3.0)
        total += passed * layer.r0_m ** (-5.0 / 3.0)
    return total
