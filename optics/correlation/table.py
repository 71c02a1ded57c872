"""Tables of R(u) on an even grid, read with cubic Hermite polynomials: tens of times faster than error functions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .forms import correlation, correlation_kinks, correlation_slope, correlation_support
from .gates import Gate, gate_parts
from .parts import Array, Decay, Part, PiecewiseLinear
from .pulses import Pulse, pulse_part

__all__ = ["Table", "lookup", "tabulate"]

_FIRST_CELLS = 32
_MOST_CELLS = 1 << 21
#: Share of rtol allowed to the error at checked points; the rest is a margin for the points between them.
_SHARE = 0.8


@dataclass(frozen=True, eq=False)
class Table:
    """R and dR/du on u = start_s + step_s·i. `value`(n), `slope`(n) [1/s]; both are zero at the ends.

    `max_error` is the largest error at the checked points, as a fraction of max R.
    """

    start_s: float
    step_s: float
    value: Array
    slope: Array
    max_error: float

    @property
    def inv_step(self) -> float:
        """1/step_s, the argument of the compiled lookups."""
        return 1.0 / self.step_s


def tabulate(pulse: Pulse, gate: Gate, rtol: float) -> Table:
    """A cubic Hermite table of R(u) with error below rtol·max R.

    Main arguments:
        pulse, gate: shapes of `waveforms`.
        rtol: largest error of the tabulated value, as a fraction of max R; 1e-12 < rtol < 1.
    The number of cells doubles until the error at three points of each cell and at every kink of R is below 0.8 rtol.
    Smooth R needs tens to hundreds of cells (error ∝ step⁴). Where pulse and gate both jump, R has kinks and the
    error there is up to |ΔR'|·step/6.75: the table starts with the number of cells that this requires, about 10⁵ for
    rtol 1e-5, and omits tails below rtol/10 of the peak. Lookups are not negative (beyond rounding) unless R itself is,
    as with negative samples. Raises ValueError, with the error reached, where 2²¹ cells do not suffice (rectangles: rtol
    below 1e-6).
    """
    if not 1e-12 < rtol < 1.0:
        raise ValueError(f"rtol must be between 1e-12 and 1, not {rtol!r}")
    lo, hi = correlation_support(pulse, gate)
    kinks, bend = correlation_kinks(pulse, gate)
    coarse_u, coarse_step = np.linspace(lo, hi, 4097, retstep=True)
    coarse = np.abs(correlation(pulse, gate, coarse_u))
    if bend * (hi - lo) > rtol * np.max(coarse):
        seen = coarse_u[coarse > 0.1 * rtol * np.max(coarse)]
        lo, hi = max(lo, seen[0] - coarse_step), min(hi, seen[-1] + coarse_step)
    needed = bend * (hi - lo) / (6.75 * _SHARE * rtol * max(float(np.max(coarse)), 1e-300))
    # Start with at most two finest details per cell, so that the checks cannot miss one.
    detail = max(_finest(pulse_part(pulse)), min(_finest(piece) for piece in gate_parts(gate)))
    seen_cells = min((hi - lo) / (2.0 * detail), _MOST_CELLS / 16)
    cells = int(np.clip(max(1.02 * needed, seen_cells), _FIRST_CELLS, _MOST_CELLS))
    while True:
        step = (hi - lo) / cells
        # Two cells of margin on both sides; the outer one is exactly zero, so that lookups beyond it are zero too.
        grid = lo + step * np.arange(-2, cells + 3)
        value, slope = correlation(pulse, gate, grid), correlation_slope(pulse, gate, grid)
        peak = float(np.max(np.abs(value)))
        if peak == 0.0:
            raise ValueError("The gate never transmits the pulse: R is zero everywhere.")
        value[[0, 1, -2, -1]] = slope[[0, 1, -2, -1]] = 0.0
        if np.min(value) > -1e-9 * peak:
            # Expected counts must not be negative: |slope| ≤ 3 value/step is sufficient for cubics that stay above 0
            # (Schmidt and Hess, BIT 28:340, 1988). It binds only at the feet of R; the check below includes its effect.
            value = np.maximum(value, 0.0)
            steepest = 2.99 * value / step  # a little less than 3, for rounding
            slope = np.clip(slope, -steepest, steepest)
        table = Table(float(grid[0]), step, value, slope, 0.0)
        check = np.concatenate([grid[:-1] + f * step for f in (0.25, 0.5, 0.75)] + [kinks])
        error = float(np.max(np.abs(lookup(table, check) - correlation(pulse, gate, check)))) / peak
        if error <= _SHARE * rtol:
            return Table(table.start_s, step, value, slope, error)
        if cells >= _MOST_CELLS:
            raise ValueError(
                f"rtol {rtol:g} cannot be reached for this pulse and gate: {cells} cells leave an error of {error:.3g}; "
                "give the pulse or the gate finite edges, or choose a larger rtol"
            )
        cells = min(2 * cells, _MOST_CELLS)


def _finest(part: Part) -> float:
    """Length [s] over which the part varies: σ, or the closest knots; 0 for the jump of a decay."""
    if isinstance(part, PiecewiseLinear):
        return float(np.min(np.diff(part.knot)))
    return 0.0 if isinstance(part, Decay) else part.sigma


def lookup(table: Table, u: ArrayLike) -> Array:
    """R(u) from the table at u [s] of any shape; zero outside. NaN in, NaN out."""
    x = (np.asarray(u, dtype=np.float64) - table.start_s) / table.step_s
    last = table.value.size - 1
    inside = np.clip(x, 0.0, float(last))
    i = np.minimum(np.nan_to_num(inside).astype(np.intp), last - 1)
    s = inside - i
    a, ma, mb = table.value[i], table.slope[i] * table.step_s, table.slope[i + 1] * table.step_s
    d = table.value[i + 1] - a
    return np.asarray(a + s * (ma + s * (3.0 * d - 2.0 * ma - mb + s * (ma + mb - 2.0 * d))), dtype=np.float64)
