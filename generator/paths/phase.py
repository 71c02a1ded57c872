"""A phase function as cells that drjit looks up and samples without error of its own.

s = sin²(ψ/2) has dΩ = 4π ds, so a function that is constant in each cell of s keeps the light of every cell exactly, is
sampled exactly, and its density is one look-up. Cells are even in ln s where β̃ is a power law of ψ, and even in cos(ψ/2)
beyond 29°, which is even in ψ near π: measured waters still change there by a per cent in two degrees.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics.water.phase_forms import PhaseFunction, phase_cdf
from ...scenes.scene import Scene
from ..rays.backend import mitsuba
from ..water.phase import phase_of

__all__ = ["PhaseCells", "free_path", "phase_cells_of", "straight_share"]

_LOG_CELLS, _EVEN_CELLS = 1536, 2048
_CELLS = _LOG_CELLS + _EVEN_CELLS
_BORDER = 1.0 / 16.0
_TOP = float(np.sqrt(1.0 - _BORDER))  # cos(ψ/2) there
_FINEST = 1e-10  # ψ = 2e-5 rad: light that turns by less goes straight on for any camera


@dataclass(frozen=True)
class PhaseCells:
    """Edges of s and β̃ [1/sr] of cells; the first reaches from 0 to the finest s. `stay`, `other`: Walker's table."""

    edge: Any
    value: Any
    per_log: float
    stay: Any
    other: Any

    @staticmethod
    def of(phase: PhaseFunction, least_rad: float = 0.0) -> PhaseCells:
        """Cells of a phase function; with `least_rad`, of the part that turns light by more than that, of unit integral."""
        mi = mitsuba()
        log_edge = np.geomspace(_FINEST, _BORDER, _LOG_CELLS + 1)
        half = np.linspace(_TOP, 0.0, _EVEN_CELLS + 1)[1:]
        edge = np.concatenate([[0.0], log_edge, 1.0 - half**2])
        cdf = phase_cdf(phase, 2.0 * np.arcsin(np.sqrt(edge)))
        cdf[0], cdf[-1] = 0.0, 1.0
        share = np.where(edge[1:] <= np.sin(0.5 * least_rad) ** 2, 0.0, np.diff(cdf))
        share /= share.sum()
        value = share / (4.0 * np.pi * np.diff(edge))
        return PhaseCells(
            mi.Float(edge.astype(np.float32)),
            mi.Float(value.astype(np.float32)),
            _LOG_CELLS / float(np.log(_BORDER / _FINEST)),
            *_alias(share),
        )

    def density(self, a: Any, b: Any) -> Any:
        """β̃ [1/sr] between unit directions a and b."""
        import drjit as dr

        mi = mitsuba()
        s = 0.25 * dr.squared_norm(a - b)
        x = (dr.log(dr.maximum(s, _FINEST)) - float(np.log(_FINEST))) * self.per_log
        even = (_TOP - 0.5 * dr.norm(a + b)) * (_EVEN_CELLS / _TOP)
        cell = dr.select(s < _FINEST, 0, dr.minimum(mi.UInt32(x) + 1, _LOG_CELLS))
        cell = dr.select(even < 0.0, cell, dr.minimum(mi.UInt32(dr.maximum(even, 0.0)) + _LOG_CELLS + 1, _CELLS))
        return dr.gather(mi.Float, self.value, cell)

    def draw(self, forward: Any, word: Any, point: Any) -> tuple[Any, Any]:
        """A direction with density β̃ about `forward`, and that density, from 32 even bits and two uniform numbers."""
        import drjit as dr

        mi = mitsuba()
        wide = mi.UInt64(word) * (_CELLS + 1)
        even, rest = mi.UInt32(wide >> 32), mi.UInt32(wide & 0xFFFFFFFF)
        cell = dr.select(rest < dr.gather(mi.UInt32, self.stay, even), even, dr.gather(mi.UInt32, self.other, even))
        return self._turned(forward, cell, point), dr.gather(mi.Float, self.value, cell)

    def _turned(self, forward: Any, cell: Any, point: Any) -> Any:
        """A direction about `forward`, even in a cell."""
        import drjit as dr

        mi = mitsuba()
        low = dr.gather(mi.Float, self.edge, cell)
        s = low + point.x * (dr.gather(mi.Float, self.edge, cell + 1) - low)
        sine = 2.0 * dr.safe_sqrt(s * (1.0 - s))
        sin_phi, cos_phi = dr.sincos(2.0 * dr.pi * point.y)
        local = mi.Vector3f(sine * cos_phi, sine * sin_phi, 1.0 - 2.0 * s)
        return dr.normalize(mi.Frame3f(forward).to_world(local))


def _alias(share: NDArray[np.float64]) -> tuple[Any, Any]:
    """Walker's table: cell i of n even ones stays i below a threshold (of 2³²), and else is another."""
    mi = mitsuba()
    count = len(share)
    left = share / share.sum() * count
    stay, other = np.ones(count), np.arange(count, dtype=np.uint32)
    small, large = [list(np.flatnonzero(m)) for m in (left < 1.0, left >= 1.0)]
    while small and large:
        low, high = small.pop(), large[-1]
        stay[low], other[low] = left[low], high
        left[high] -= 1.0 - left[low]
        if left[high] < 1.0:
            small.append(large.pop())
    return mi.UInt32(np.minimum(stay * 2.0**32, 2.0**32 - 1).astype(np.uint32)), mi.UInt32(other)


def straight_share(phase: PhaseFunction, least_rad: float) -> float:
    """The share of scattered light that `PhaseCells.of` leaves out with `least_rad`."""
    edge = np.concatenate([[0.0], np.geomspace(_FINEST, _BORDER, _LOG_CELLS + 1)])
    last = edge[edge <= np.sin(0.5 * least_rad) ** 2][-1]
    return float(phase_cdf(phase, np.array([2.0 * np.arcsin(np.sqrt(last))]))[0]) if last > 0 else 0.0


def free_path(uniform: Any, scattering: Any) -> Any:
    """Way to the next scattering event [m], with density b e^{−bt}, from a uniform number below one."""
    import drjit as dr

    return -dr.log(1.0 - uniform) / scattering


def phase_cells_of(scene: Scene) -> PhaseCells | None:
    """Cells of the scene's phase function; None where nothing scatters.

    Raises:
        InputError: the medium scatters and has no phase function.
    """
    phase = phase_of(scene)
    return None if phase is None else PhaseCells.of(phase)
