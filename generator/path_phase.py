"""A phase function as cells that drjit looks up and samples without error of its own.

s = sin²(ψ/2) has dΩ = 4π ds, so a function that is constant in each cell of s keeps the light of every cell exactly, is
sampled exactly, and its density is one look-up. 2048 cells even in ln s follow β̃ within a per cent in each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..optics.phase_forms import PhaseFunction, phase_cdf
from ..scenes.errors import InputError
from ..scenes.scene import Scene
from .backend import mitsuba

__all__ = ["PhaseCells", "phase_cells_of"]

_CELLS = 2048
_FINEST = 1e-10  # ψ = 2e-5 rad: light that turns by less goes straight on for any camera


@dataclass(frozen=True)
class PhaseCells:
    """Edges of s, F and β̃ [1/sr] of cells; the first reaches from 0 to the finest s."""

    edge: Any
    cdf: Any
    value: Any
    per_log: float

    @staticmethod
    def of(phase: PhaseFunction) -> PhaseCells:
        """Cells of a phase function."""
        mi = mitsuba()
        edge = np.concatenate([[0.0], np.geomspace(_FINEST, 1.0, _CELLS + 1)])
        cdf = phase_cdf(phase, 2.0 * np.arcsin(np.sqrt(edge)))
        cdf[0], cdf[-1] = 0.0, 1.0
        value = np.diff(cdf) / (4.0 * np.pi * np.diff(edge))
        return PhaseCells(
            mi.Float(edge.astype(np.float32)),
            mi.Float(cdf.astype(np.float32)),
            mi.Float(value.astype(np.float32)),
            _CELLS / -float(np.log(_FINEST)),
        )

    def density(self, a: Any, b: Any) -> Any:
        """β̃ [1/sr] between unit directions a and b."""
        import drjit as dr

        mi = mitsuba()
        s = 0.25 * dr.squared_norm(a - b)
        x = (dr.log(dr.maximum(s, _FINEST)) - float(np.log(_FINEST))) * self.per_log
        cell = dr.select(s < _FINEST, 0, dr.minimum(mi.UInt32(x) + 1, _CELLS))
        return dr.gather(mi.Float, self.value, cell)

    def sample(self, forward: Any, choice: Any, point: Any) -> Any:
        """A direction with density β̃ about `forward`, from one and two uniform numbers."""
        import drjit as dr

        mi = mitsuba()
        search: Any = dr.binary_search
        cell = search(0, _CELLS, lambda i: dr.gather(mi.Float, self.cdf, i + 1) <= choice)
        low = dr.gather(mi.Float, self.edge, cell)
        s = low + point.x * (dr.gather(mi.Float, self.edge, cell + 1) - low)
        sine = 2.0 * dr.safe_sqrt(s * (1.0 - s))
        sin_phi, cos_phi = dr.sincos(2.0 * dr.pi * point.y)
        local = mi.Vector3f(sine * cos_phi, sine * sin_phi, 1.0 - 2.0 * s)
        return dr.normalize(mi.Frame3f(forward).to_world(local))


def phase_cells_of(scene: Scene) -> PhaseCells | None:
    """Cells of the scene's phase function; None where nothing scatters.

    Raises:
        InputError: the medium scatters, and how is not told.
    """
    if scene.medium.scattering_per_m == 0.0:
        return None
    phase = scene.medium.phase
    if phase is None:
        raise InputError(
            "The medium scatters light, and its phase function is not told.",
            where=f"{scene.name}: medium.phase_function",
            allowed="henyey-greenstein, fournier-forand, molecular, tabulated",
            next_step='--set medium.phase_function=\'{"kind": "henyey-greenstein", "g": 0.92}\'',
        )
    return PhaseCells.of(phase)
