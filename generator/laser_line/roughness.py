"""The truth of a surveyed surface: slope and level of the spectrum that it was drawn from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...optics.roughness import profile_factor, surface_density_factor
from ...scenes.scene import Scene
from ...scenes.shapes import PowerLawRelief

__all__ = ["roughness_truth"]

#: Frequency of the level, cycles/m.
_AT_PER_M = 10.0


def roughness_truth(scene: Scene) -> dict[str, NDArray[np.float64]]:
    """`truth_slope` and `truth_level` [dB re 1 m³ at 10 cycles/m] (survey) of a scene with one surface drawn from a power law;
    nothing for other scenes. The level is that of A f^−γ; waves shorter than the inner scale are missing from the surface."""
    drawn = [item.shape for item in scene.target if isinstance(item.shape, PowerLawRelief)]
    if len(drawn) != 1:
        return {}
    (shape,) = drawn
    density = surface_density_factor(shape.slope, shape.rms_m, shape.outer_m, shape.inner_m)
    level = profile_factor(shape.slope) * density * _AT_PER_M**-shape.slope
    return {"truth_slope": np.array([shape.slope]), "truth_level": np.array([10.0 * np.log10(level)])}
