"""The catalogue of effects that all one-detector rangers share, at the rungs `direct` and `scatter`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S
from ...optics.water.halo import forward_share
from ...optics.water.phase_function import asymmetry, mean_square_angle
from ...scenes.medium_index import group_index
from ...scenes.scene import Scene
from ..effect import Effect, effect, interreflection
from ..model import Expected
from .footprint import Footprint, Ranger
from .scatter import forward_gain

__all__ = ["common_effects"]

Float = NDArray[np.float64]


def common_effects(scene: Scene, ranger: Ranger, expected: Expected[Footprint], rung: str) -> list[Effect]:
    """Effects that all rangers share, at the rung."""
    truth_range: Float = expected.truth["truth_range"]
    typical = float(np.nanmedian(truth_range)) if np.isfinite(truth_range).any() else 0.0
    c = scene.medium.attenuation_per_m
    return [
        effect("first bounce", True, 1.0, "Mitsuba first hits, exact times"),
        effect("footprint", True, None, f"{expected.light.tau.shape[1]} even rays a shot"),
        effect("beam attenuation", True, float(-np.expm1(-2 * c * typical)), "1 − e^(−2cr)"),
        effect("group index", True, None, "all times at c/n_g"),
        *_scattering(scene, ranger, typical, rung == "scatter"),
        effect("interreflection", False, *interreflection(scene)),
        effect("parallax of laser and lens", False, 0.0, "coaxial"),
        effect("defocus of near ranges", False, None, "the lens is taken as focused on the target"),
        effect("speckle", False, None, "not modelled; contrast 1/√M"),
        effect("photon noise", True, None, "Poisson"),
    ]


def _scattering(scene: Scene, ranger: Ranger, range_m: float, there: bool) -> list[Effect]:
    """Light scattered forward and back, before a wall at `range_m`; by the scatter rung's own quadrature, untraced."""
    b, phase = scene.medium.scattering_per_m, scene.medium.phase
    if b == 0.0 or range_m == 0.0 or phase is None:
        wide = float(np.expm1(min(2 * b * range_m, 50.0)))
        back, why = (0.0, "nothing scatters") if b == 0.0 else (None, "needs the phase function")
        return [
            effect("forward-scattered light", there, wide, "e^(2br) − 1, wide beam"),
            effect("volume backscatter", there, back, why),
            effect("delay of scattered light", False, back, why),
            effect("multiple scattering", False, back, why),
        ]
    late = 2.0 * b * forward_share(phase) * range_m**2 * mean_square_angle(phase) / 12.0
    turned = float(-np.expm1(-2.0 * b * (1.0 - asymmetry(phase)) * range_m))
    seconds = late * group_index(scene.medium, ranger.wavelength_m) / C_M_PER_S
    gain = forward_gain(scene, ranger, phase, range_m) - 1.0
    return [
        effect("forward-scattered light", there, gain if np.isfinite(gain) else None, "over the unscattered echo"),
        effect("volume backscatter", there, None, "single scattering, up to the target"),
        effect("delay of scattered light", False, None, f"{seconds:.2g} s on the mean: br²⟨ψ²⟩/6"),
        effect("multiple scattering", False, turned, "1 − e^(−2b(1 − g)r)"),
    ]
