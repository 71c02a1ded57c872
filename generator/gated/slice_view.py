"""How strongly the slices of a stack show light of a time: what the relative error of a stack is relative to.

V(τ)² = Σ_k R(τ − t_k)² over the slices with laser light. Light that no slice shows adds nothing to the stack, and its error
nothing to the stack's error: rays are shared out by what is seen, or a target half outside the gates gets too few inside.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from ...optics.correlation.response import Table, lookup
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from .gates import gate_offset

__all__ = ["slice_view"]

Float = NDArray[np.float64]

#: Cells of the tabulated V per σ of R, and how many at most.
_CELLS_PER_SIGMA = 4.0
_MOST_CELLS = 1 << 15
#: Light within so many σ of a time may be what a neighbour's centre ray stands for.
_NEAR_SIGMAS = 0.5
#: Weight of what no slice shows, relative to what is seen best: truth is made of its rays too.
_LEAST = 0.1
#: Light of which the slices show less than this, relative to what is seen best of any time, is light that they do not show: it
#: lies in the tail of a pulse that has no end.
_NOTHING = 1e-6


def slice_view(scene: Scene, tables: Sequence[Table], sigma_s: float, tau_s: Float) -> tuple[Float, Float]:
    """(V, weight) at times of any shape, relative to the largest V of any time; both 1 where the slices see nothing of it.

    Main arguments:
        tables: R of each gate; sigma_s: its σ; tau_s: arrival times [s].

    `weight` is the largest V within half a σ (and a gate's delays over the image), and no less than a tenth of its own largest.
    """
    rig = gated_rig(scene)
    delays = rig.delays.after(rig.t0_s)
    offset = gate_offset(scene)
    late = np.zeros(1) if offset is None else offset
    delays = delays + 0.5 * (late.min() + late.max())
    low = delays.min() + min(t.start_s for t in tables)
    high = delays.max() + max(t.start_s + t.step_s * (t.value.size - 1) for t in tables)
    cells = int(np.clip((high - low) / sigma_s * _CELLS_PER_SIGMA, 16, _MOST_CELLS))
    step = (high - low) / cells
    grid = low + step * np.arange(cells + 1)
    square = np.zeros(grid.size)
    for table in tables:
        reach = table.step_s * (table.value.size - 1)
        first = np.clip(np.floor((delays + table.start_s - low) / step).astype(int), 0, cells)
        count = min(int(np.ceil(reach / step)) + 2, cells + 1)
        for delay, begin in zip(delays, first, strict=True):
            part = slice(begin, begin + count)
            square[part] += lookup(table, grid[part] - delay) ** 2
    view = np.sqrt(square)
    if not view.any():  # slices so far apart that this grid, as fine as it may be, steps over every gate
        return np.ones(np.shape(tau_s)), np.ones(np.shape(tau_s))
    near = int(np.ceil((_NEAR_SIGMAS * sigma_s + 0.5 * (late.max() - late.min())) / step))
    wide = maximum_filter1d(view, 2 * near + 1, mode="constant")
    when = np.where(np.isfinite(tau_s), tau_s, np.inf)  # a ray that meets nothing has no time
    shown, weight = (np.interp(when, grid, v, left=0.0, right=0.0) / view.max() for v in (view, wide))
    if shown.max() < _NOTHING:
        return np.ones(shown.shape), np.ones(shown.shape)
    # Of what is seen best of this light: where all of it lies at the slices' far edge, a tenth of what they could see is more than
    # they do see, and no number of rays would be enough.
    return shown, np.maximum(weight, _LEAST * float(weight.max()))
