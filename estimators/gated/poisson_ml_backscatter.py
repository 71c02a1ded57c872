"""Poisson maximum likelihood with the backscatter of the water in the model."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.jit import kernel
from ...scenes.errors import InputError
from ..registry import estimator
from ..result import range_result
from .tools.design import Design, design_of
from .tools.goodness import hold_misfit
from .tools.instrument import Instrument
from .tools.maximum import TILE
from .tools.returns import climb
from .tools.scoring import information_step
from .tools.stack import load_row, read_stack

__all__ = ["backscatter_template", "poisson_ml_backscatter"]

Float = npt.NDArray[np.float64]


def backscatter_template(
    rig: Instrument, design: Design, nearest_m: float, attenuation_per_m: float
) -> tuple[Float, Float]:
    """(below (row, group), decay (row)): b_k(τ_j) = Σ_{i<j} w_i·R(τ_i − t_k) and w = e^(−2cr)/r² at the rows of a design
    table, w = 1 at its middle row and 0 before `nearest_m`."""
    rows = design.table.shape[0]
    r = rig.m_per_s * (design.origin_s + design.step_s * np.arange(rows))
    far = np.maximum(r, nearest_m)
    middle = max(float(r[rows // 2]), nearest_m)
    decay = np.where(r >= nearest_m, np.exp(-2 * attenuation_per_m * (far - middle)) * (middle / far) ** 2, 0.0)
    value = design.table[:, 0, :] * decay[:, None]
    # Half of the row itself: the trapezoidal rule, so that the template is smooth between rows.
    return np.cumsum(value, axis=0) - 0.5 * value, decay


@kernel(error_model="numpy")
def _fit_rows(  # type: ignore[no-untyped-def]
    counts, slices, group, e, s, levels, table, below, decay, grid, bounds, width, snr, tau, sigma, ok, strength
):
    rows, cols = counts.shape[1], counts.shape[2]
    offset, scale, saturation = levels
    groups = e.size
    z, zs, rough = np.empty((TILE, groups)), np.empty(groups), np.empty(groups)
    bad = np.zeros(TILE, np.int64)
    columns, free = np.empty((3, groups)), np.ones(3, np.bool_)
    step, error3, q, error = np.empty(3), np.empty(3), np.empty(4), np.empty(4)
    for row in range(rows):
        for first in range(0, cols, TILE):
            number = min(TILE, cols - first)
            load_row(counts, slices, group, row, first, offset, scale, saturation, z[:number], bad[:number])
            for c in range(number):
                if bad[c] != 0:
                    continue
                for g in range(groups):
                    rough[g] = max(z[c, g], 0.0) + s[g] + 1.0
                    zs[g] = z[c, g] + rough[g]
                # The start: weighted least squares of (B, C, A) at each place of a grid; the most significant A is taken.
                best = 0.0
                for i in range(grid.size):
                    j = grid[i]
                    for g in range(groups):
                        columns[0, g], columns[1, g], columns[2, g] = e[g], below[j, g], table[j, 0, g]
                    free[1] = True
                    good = information_step(zs, rough, columns, free, step, error3)
                    if not good or step[1] < 0:
                        free[1] = False
                        good = information_step(zs, rough, columns, free, step, error3)
                    if good and step[2] > best * error3[2]:
                        best = step[2] / error3[2]
                        q[0], q[1], q[2], q[3] = max(step[0], bounds[3]), max(step[1], 0.0), float(j), step[2]
                if not best > 0:
                    continue
                for g in range(groups):
                    zs[g] = z[c, g] + s[g]
                done, _likelihood = climb(zs, e, s, table, below, decay, bounds, q, error)
                good = done and q[3] > snr * error[3] and error[2] < width and bounds[0] < q[2] < bounds[1]
                if good:
                    tau[row, first + c], sigma[row, first + c], ok[row, first + c] = q[2], error[2], True
                    strength[row, first + c] = q[1]


@estimator(
    "gated", cites="Fisher scoring: Osborne, Int. Stat. Rev. 60:99, 1992; template: single-scatter lidar equation"
)
def poisson_ml_backscatter(
    capture: xr.Dataset, *, min_snr: float = 4.0, nearest_m: float = 0.1, attenuation_per_m: float | None = None
) -> xr.Dataset:
    """Maximum likelihood of μ_k = A·R(τ−t_k) + C·b_k(τ) + B over (τ, A, C, B), all profiled; C ≥ 0, B ≥ −σ_r²/2.

    b_k(τ) = ∫_{τ₀}^{τ} e^(−2cr)/r²·R(τ'−t_k) dτ', r = cτ'/2n_g: the coaxial single scatter of the declared medium, c = a + b,
    up to the surface, which ends it (so that the end of the backscatter also depends on the range). Its strength C is
    fitted per pixel; its shape is declared. Noise as in `poisson-ml`. Where no light scatters, C costs a little precision.
    Other arguments: min_snr: least A in its standard errors; nearest_m: water nearer than this is not lit or not seen
    (bistatic overlap); attenuation_per_m: c of the template in place of the declared one.
    Returns range, sigma [m] from the Fisher information and, in pixels of several surfaces, their spread (`misfit`),
    valid (row, col): converged, a quarter of the echo inside the window, no clipped or NaN sample. Raises
    InputError for min_snr, nearest_m, attenuation_per_m out of range, and for a rig that lacks a value.
    """
    if min_snr < 0 or nearest_m <= 0 or (attenuation_per_m is not None and attenuation_per_m < 0):
        value = (min_snr, nearest_m, attenuation_per_m)
        raise InputError(
            "A parameter is out of range.", where="poisson-ml-backscatter[min_snr, nearest_m, attenuation_per_m]",
            value=value, allowed=">= 0, > 0, >= 0",
        )  # fmt: skip
    stack = read_stack(capture)
    rig = stack.instrument
    shape = stack.counts.shape[1:]
    tau, sigma, ok = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, dtype=bool)
    if stack.signal < 5:
        return range_result(tau, sigma, ok)
    design = design_of(stack)
    absorption = rig.rig.number("medium.absorption_per_m", least=0)
    strength = np.zeros(shape)
    declared = absorption + rig.rig.number("medium.scattering_per_m", least=0)
    c = declared if attenuation_per_m is None else attenuation_per_m
    below, decay = backscatter_template(rig, design, nearest_m, c)
    shift = stack.count * rig.floor_var / rig.excess**2
    floor = -0.5 * float((shift / stack.exposure).min())
    levels = (rig.offset_dn, stack.frames / (rig.dn_per_pe * rig.excess), rig.saturation_dn)
    _fit_rows(
        stack.counts, stack.slices, stack.group, stack.exposure, shift, levels, design.table, below, decay,
        design.candidates, (design.low, design.high, 0.7 * design.width, floor), design.width, min_snr, tau, sigma, ok, strength,
    )  # fmt: skip
    hold_misfit(stack, design, tau, sigma, ok, veil=(below, strength))
    return range_result(*rig.to_range(design.origin_s + design.step_s * tau, design.step_s * sigma), ok)
