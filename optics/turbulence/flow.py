"""Turbulence that is carried along: frozen flow of a screen (Taylor), and a table of r₀ against the flow in a tank.

φ(x, t) = φ(x − v t, 0): a window moves over one larger screen. Whole points are exact; between them the screen's torus is
interpolated by trigonometric polynomials.

Source: G. I. Taylor, Proc. R. Soc. A 164:476, 1938.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .embedding import ScreenPlan

__all__ = ["TABLE_FLOW_L_PER_MIN", "TABLE_R0_M", "TABLE_RANGE_M", "FrozenFlow", "frozen_flow", "table_r0_m"]

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FrozenFlow:
    """One layer that is carried along.

    Main arguments:
        plan, noise: the larger screen. shape: rows, columns of a frame. velocity_m_per_s: x, y. start_m: x, y of the window
        at t = 0. duration_s: up to which frames exist.
    """

    plan: ScreenPlan
    noise: tuple[NDArray[np.complex128], Float]
    shape: tuple[int, int]
    velocity_m_per_s: tuple[float, float]
    start_m: tuple[float, float]
    duration_s: float

    def frame(self, time_s: float) -> Float:
        """φ(x − v t) (rows, cols) [rad]. Its mean is free to change in time. Raises ValueError outside 0 … duration_s."""
        if not 0.0 <= time_s <= self.duration_s * (1 + 1e-12):
            raise ValueError(
                f"time_s must lie in 0 … {self.duration_s!r} s, for which the screen was made, not {time_s!r}."
            )
        shift = (
            self.start_m[0] - self.velocity_m_per_s[0] * time_s,
            self.start_m[1] - self.velocity_m_per_s[1] * time_s,
        )
        return np.asarray(self.plan.field(self.noise, shift)[: self.shape[0], : self.shape[1]])


def frozen_flow(
    plan_of: Callable[[tuple[int, int]], ScreenPlan],
    shape: tuple[int, int],
    velocity_m_per_s: tuple[float, float],
    duration_s: float,
    rng: np.random.Generator,
) -> FrozenFlow:
    """A layer carried at `velocity_m_per_s` (x, y) for `duration_s`.

    Main arguments:
        plan_of: shape → plan of screens, such as `lambda s: kolmogorov_plan(r0_m, s, spacing_m)`. shape: rows, columns of a frame.
        rng: advanced by the numbers of one larger screen.

    Raises ValueError for a duration that is negative or not finite.
    """
    if not (duration_s >= 0 and np.isfinite(duration_s)):
        raise ValueError(f"duration_s must be at least 0 and finite, not {duration_s!r}.")
    spacing = plan_of((1, 1)).spacing_m
    travel = [abs(v) * duration_s for v in velocity_m_per_s]
    cells = [int(np.ceil(t / spacing)) + (1 if t else 0) for t in travel]
    plan = plan_of((shape[0] + cells[1], shape[1] + cells[0]))
    start = tuple(t if v > 0 else 0.0 for t, v in zip(travel, velocity_m_per_s, strict=True))
    return FrozenFlow(plan, plan.noise(rng), shape, velocity_m_per_s, (start[0], start[1]), duration_s)


#: Flow into the tank [L/min] and range of the gate [m] of the table below.
TABLE_FLOW_L_PER_MIN = np.array([0.0, 10.0, 20.0, 30.0, 40.0])
TABLE_RANGE_M = np.array([1.0, 2.0, 3.0, 4.0])

#: r₀ [m] (range, flow) at 532 nm. **Ours, not physics and not measured by anyone**: chosen so that the lenslets of Guo et al.
#: 2017 have d/r₀ of .01 to .13, rising with the flow and toward the inlet at 4 m, as their text says of their figures. Any
#: trend that follows from this table is by construction. (At fixed dissipation of temperature, more flow would even mean
#: weaker turbulence.)
TABLE_R0_M = 1e-3 * np.array(
    [
        [np.inf, 12.6, 8.4, 6.3, 5.0],
        [np.inf, 7.8, 5.2, 3.9, 3.1],
        [np.inf, 4.8, 3.2, 2.4, 1.9],
        [np.inf, 3.0, 2.0, 1.5, 1.2],
    ]
)


def table_r0_m(flow_l_per_min: ArrayLike, range_m: ArrayLike) -> Float:
    """r₀ [m] of our table (see `TABLE_R0_M`), r₀^{−5/3} interpolated linearly in flow and range, 0 at range 0.

    The arguments broadcast. Infinite at no flow. Raises ValueError outside 0 … 40 L/min or 0 … 4 m.
    """
    flow, far = np.broadcast_arrays(np.asarray(flow_l_per_min, np.float64), np.asarray(range_m, np.float64))
    if not ((flow >= 0) & (flow <= 40)).all() or not ((far >= 0) & (far <= 4)).all():
        raise ValueError(f"The table holds 0 … 40 L/min and 0 … 4 m, not {flow_l_per_min!r} L/min at {range_m!r} m.")
    strength = np.vstack([np.zeros((1, TABLE_FLOW_L_PER_MIN.size)), TABLE_R0_M ** (-5.0 / 3.0)])
    row, column = np.minimum(far.astype(int), 3), np.minimum((flow / 10.0).astype(int), 3)
    a, b = far - row, flow / 10.0 - column
    value = (1 - a) * ((1 - b) * strength[row, column] + b * strength[row, column + 1])
    value = value + a * ((1 - b) * strength[row + 1, column] + b * strength[row + 1, column + 1])
    with np.errstate(divide="ignore"):
        return np.asarray(value**-0.6)
