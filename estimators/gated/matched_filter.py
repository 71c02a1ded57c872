"""Matched filter: the delay at which the profile correlates best with the declared response."""

from __future__ import annotations

import numpy as np
import xarray as xr

from ...optics.jit import kernel
from ..registry import estimator
from ..result import range_result
from .tools.design import Design, design_of
from .tools.goodness import hold_misfit
from .tools.maximum import TILE
from .tools.stack import Stack, load_row, read_stack

__all__ = ["matched_filter"]

#: Rows of the design table (σ_R/64 apart) between evaluated scores.
STRIDE = 8


@kernel(fastmath={"reassoc", "contract"}, error_model="numpy")
def _score(z, table, first, last, mean, norm, light, j):  # type: ignore[no-untyped-def]
    total = 0.0
    for g in range(first[j], last[j]):
        total += z[g] * table[j, 0, g]
    return (total - mean[j] * light) * norm[j]


@kernel(error_model="numpy")
def _filter_rows(  # type: ignore[no-untyped-def]
    counts, slices, group, levels, noise, number, table, first, last, mean, norm, ends, snr, tau, sigma, ok
):
    rows, cols = counts.shape[1], counts.shape[2]
    offset, scale, saturation = levels
    excess, floor = noise
    begin, end, coarse = ends
    groups = table.shape[2]
    z = np.empty((TILE, groups))
    bad = np.zeros(TILE, np.int64)
    for row in range(rows):
        for col0 in range(0, cols, TILE):
            width = min(TILE, cols - col0)
            load_row(counts, slices, group, row, col0, offset, scale, saturation, z[:width], bad[:width])
            for c in range(width):
                if bad[c] != 0:
                    continue
                y = z[c]
                light = 0.0
                for g in range(groups):
                    light += y[g]
                best, top = begin, -np.inf
                for j in range(begin, end, coarse):
                    s = _score(y, table, first, last, mean, norm, light, j)
                    if s > top:
                        best, top = j, s
                middle = best
                for j in range(max(begin, middle - coarse), min(end, middle + coarse + 1), STRIDE):
                    s = _score(y, table, first, last, mean, norm, light, j)
                    if s > top:
                        best, top = j, s
                if not (top > 0 and begin <= best - STRIDE and best + STRIDE < end):
                    continue
                before = _score(y, table, first, last, mean, norm, light, best - STRIDE)
                after = _score(y, table, first, last, mean, norm, light, best + STRIDE)
                bend = 2 * top - before - after
                if not (bend > 0 and before <= top and after <= top):
                    continue
                # w = (v − m)/|v − m|: its derivative at the maximum, and the noise of the data through it.
                q, back = norm[best], light / groups - top * norm[best] * mean[best]
                lean = 0.0
                for g in range(groups):
                    lean += (table[best, 0, g] - mean[best]) * q * table[best, 1, g] * q
                square, quiet, flat = 0.0, 0.0, 0.0
                for g in range(groups):
                    flat += table[best, 1, g] * q / groups
                for g in range(groups):
                    w = (table[best, 0, g] - mean[best]) * q
                    d = table[best, 1, g] * q - flat - lean * w
                    light_g = max(top * q * table[best, 0, g] + max(back, 0.0), 0.0)
                    v = excess * light_g + floor * number[g]
                    square += d * d
                    quiet += d * d * v
                spread = 0.0
                for g in range(groups):
                    w = (table[best, 0, g] - mean[best]) * q
                    spread += (
                        w * w * (excess * max(top * q * table[best, 0, g] + max(back, 0.0), 0.0) + floor * number[g])
                    )
                if top > snr * np.sqrt(spread) and square > 0:
                    tau[row, col0 + c] = best + STRIDE * 0.5 * (after - before) / bend
                    sigma[row, col0 + c] = np.sqrt(quiet) / (top * square)
                    ok[row, col0 + c] = True


def _norms(design: Design, stack: Stack) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[type-arg]
    value = design.table[:, 0, :]
    mean = value.mean(axis=1)
    length = np.sqrt(np.maximum((value**2).sum(axis=1) - mean**2 * stack.groups, 0))
    return mean, 1 / np.maximum(length, 1e-3 * length.max())


@estimator("gated", cites="Turin, IRE Trans. Inf. Theory 6:311, 1960 (an introduction to matched filters)")
def matched_filter(capture: xr.Dataset, *, min_snr: float = 4.0) -> xr.Dataset:
    """τ = argmax of Σ_k y_k·w_k(τ), w = (v − v̄)/|v − v̄|, v_k = R(τ − t_k): the response with its mean projected out.

    This is least squares with equal weights over amplitude and background: optimal for equal noise in all slices, less so
    for photon noise. Scores are computed every σ_R/8, and the greatest is refined by a parabola.
    Other arguments: min_snr: least score in its standard errors. Returns range, sigma [m], valid (row, col): sigma by
    propagation of the photon noise of the fitted profile, and with the spread of the delays in pixels of several surfaces
    (`misfit`). Invalid: a clipped or NaN sample, no maximum inside the window.
    """
    stack = read_stack(capture)
    rig = stack.instrument
    shape = stack.counts.shape[1:]
    tau, sigma, ok = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, dtype=bool)
    if stack.signal < 3:
        return range_result(tau, sigma, ok)
    design = design_of(stack)
    mean, norm = _norms(design, stack)
    coarse = max(STRIDE, int(0.75 * design.width) // STRIDE * STRIDE)
    _filter_rows(
        stack.counts, stack.slices, stack.group, (rig.offset_dn, stack.frames / rig.dn_per_pe, rig.saturation_dn),
        (rig.excess, rig.floor_var), stack.count, design.table, design.first, design.last, mean, norm,
        (int(design.low), int(design.high) + 1, coarse), min_snr, tau, sigma, ok,
    )  # fmt: skip
    hold_misfit(stack, design, tau, sigma, ok)
    return range_result(*rig.to_range(design.origin_s + design.step_s * tau, design.step_s * sigma), ok)
