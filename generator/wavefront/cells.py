"""The number of cells of a lenslet, and the error of it, from the scene's own optics and turbulence."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ...scenes.rigs.wavefront import WavefrontRig
from ...scenes.rigs.wavefront_geometry import lattice_of
from .field import Pupils
from .fields import FINEST, pilot
from .spots import HEXAGON_CELLS, spot_image

__all__ = ["cell_errors", "cells_for"]

#: Lenslets of a side of the pilot, and its draws, of which the worst counts.
_ACROSS, _DRAWS = 4, (0, 1)


def cells_for(rig: WavefrontRig, range_m: float, rung: str, rtol: float) -> tuple[int, float]:
    """(cells, their error): the fewest of a side of a lenslet whose error is below `rtol`; where none is, one per sample."""
    errors = cell_errors(rig, range_m, rung)
    most = max(errors)
    return next(((cells, error) for cells, error in errors.items() if error <= rtol), (most, errors[most]))


def cell_errors(rig: WavefrontRig, range_m: float, rung: str) -> dict[int, float]:
    """{cells of a side, fewest first: rms over rms of the image's difference from that of `FINEST` cells}; 0 where the pupil has
    as many samples, against its own."""
    return dict(_errors(pilot(rig, _ACROSS).model_dump_json(), range_m, rung))


@lru_cache(maxsize=32)
def _errors(rig_json: str, range_m: float, rung: str) -> tuple[tuple[int, float], ...]:
    rig = WavefrontRig.model_validate_json(rig_json)
    own = rig.pupil.samples
    numbers, finer = [n for n in range(2, own + 1) if own % n == 0] or [own], None
    # The finer pupil has every number of cells as a divisor of its samples.
    finest = own * max(1, -(-FINEST // own))
    if rig.lenslets.hexagonal:  # whose cells are no samples of the pupil
        numbers, finer = [HEXAGON_CELLS], 2 * HEXAGON_CELLS
    fine = pilot(rig, _ACROSS, finest)
    lattice = lattice_of(fine, every=True)
    worst = np.zeros(len(numbers))
    for seed in _DRAWS:
        field = np.exp(1j * Pupils(fine, lattice_of(fine), seed, 0).phase(0, range_m))
        whole = spot_image(fine, lattice, field, 1.0, rung, cells=finer)
        other = [spot_image(fine, lattice, field, 1.0, rung, cells=number) for number in numbers]
        scale = float(np.sqrt((whole**2).sum()))
        worst = np.maximum(worst, [float(np.sqrt(((image - whole) ** 2).sum())) / scale for image in other])
    return tuple(zip(numbers, (float(value) for value in worst), strict=True))
