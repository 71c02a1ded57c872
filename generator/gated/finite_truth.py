"""Truth that a lens and a lamp of finite size change."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S
from ...scenes.medium_index import group_index
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..paths.finite import FiniteLight
from ..rays.trace import pixel_directions
from .direct import MIXED_FRACTION
from .gates import response_width_s

__all__ = ["finite_truth"]

Float = NDArray[np.float64]


def finite_truth(scene: Scene, truth: dict[str, Any], traced: FiniteLight) -> dict[str, Any]:
    """Truth that a finite lens and lamp change: `truth` of the direct rung, with what the paths give.

    truth_amplitude is all light that meets one surface on its way, at an open gate; truth_first and truth_last are half of the
    shortest and the longest path less what the lamp's place adds at the pixel's centre, those of the direct rung included (points
    are part of lens and lamp); truth_mixed follows from them.
    """
    rig = gated_rig(scene)
    half = 0.5 * C_M_PER_S / group_index(scene.medium, rig.laser.wavelength_m)
    distance = np.asarray(truth["truth_range"], np.float64)
    row, col = np.mgrid[: distance.shape[0], : distance.shape[1]]
    point = pixel_directions(rig.camera, row, col) * distance
    lamp = np.asarray(rig.laser.position_m, np.float64)[:, None, None]
    beside = np.nan_to_num(0.5 * (np.sqrt(np.sum((point - lamp) ** 2, axis=0)) - distance))
    first = np.fmin(truth["truth_first"], 0.5 * traced.first_m - beside)
    last = np.fmax(truth["truth_last"], 0.5 * traced.last_m - beside)
    return {
        # Where hardly any light is left, the difference leaves its noise.
        "truth_amplitude": np.maximum(truth["truth_amplitude"] + traced.amplitude, 0.0),
        "truth_first": first,
        "truth_last": last,
        "truth_mixed": np.nan_to_num(last - first) > MIXED_FRACTION * response_width_s(scene)[1] * half,
    }
