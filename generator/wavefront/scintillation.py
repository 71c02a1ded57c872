"""How much the light scintillates, which phase screens in the pupil leave out and split-step propagation models."""

from __future__ import annotations

import numpy as np

from ...optics.turbulence.propagation import thin_layer_scintillation
from ...scenes.medium import Medium
from ...scenes.medium_index import phase_index
from ...scenes.rigs.wavefront import WavefrontRig
from ...scenes.rigs.wavefront_turbulence import layers_of

__all__ = ["irradiance_index", "rytov_of"]


def rytov_of(rig: WavefrontRig, range_m: float, medium: Medium) -> float:
    """Rytov's variance of log irradiance at a point of the array, of light from a reflector at `range_m` through thin layers.

    σ² = Σ_layers (Σ_passes σ_i)²: both passes of a layer see the same water, and layers are independent. σ_i² =
    5.32 (L/k r₀²)^{5/6}, L the way left to the array: z on the way back from a mirror, 2r − z on the way to it. Of a point on a
    diffuse target one pass counts, and L is z(r − z)/r.
    """
    wavelength_m = rig.wavelength_m / phase_index(medium, rig.wavelength_m)
    total = 0.0
    for layer in layers_of(rig.turbulence):
        at = layer.range_m
        if at > range_m:
            continue
        ways = (at, 2.0 * range_m - at) if rig.reflection == "mirror" else (at * (1.0 - at / range_m),)
        own = [thin_layer_scintillation(layer.r0_m, way, wavelength_m) for way in ways]
        total += float(np.sum(np.sqrt(own)) ** 2)
    return total


def irradiance_index(rytov: float) -> float:
    """σ_I² = ⟨I²⟩/⟨I⟩² − 1 of a plane wave from weak to strong turbulence, for Rytov's variance σ².

    exp[.49 σ²/(1 + 1.11 σ^{12/5})^{7/6} + .51 σ²/(1 + .69 σ^{12/5})^{5/6}] − 1: σ² where weak, and towards 1 where saturated.
    Source: L. C. Andrews and R. L. Phillips, Laser Beam Propagation through Random Media, 2005, ch. 9.
    """
    power = rytov**1.2
    large = 0.49 * rytov / (1.0 + 1.11 * power) ** (7.0 / 6.0)
    small = 0.51 * rytov / (1.0 + 0.69 * power) ** (5.0 / 6.0)
    return float(np.expm1(large + small))
