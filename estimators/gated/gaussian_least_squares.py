"""Gaussian least squares: a bell curve of free height, place, width and background fitted to every profile."""

from __future__ import annotations

import numpy as np
import xarray as xr

from ...optics.jit import kernel
from ..registry import estimator
from ..result import range_result
from .tools.design import design_of
from .tools.goodness import hold_misfit
from .tools.maximum import TILE
from .tools.stack import load_row, read_stack

__all__ = ["gaussian_least_squares"]


@kernel(error_model="numpy")
def _solve4(j, score, step):  # type: ignore[no-untyped-def]
    """Cholesky solution of j·step = score, j (4, 4) overwritten by its factor; False where it is singular."""
    for i in range(4):
        for k in range(i + 1):
            total = j[i, k]
            for m in range(k):
                total -= j[i, m] * j[k, m]
            if i == k:
                if not total > 0:
                    return False
                j[i, i] = np.sqrt(total)
            else:
                j[i, k] = total / j[k, k]
    for i in range(4):
        total = score[i]
        for m in range(i):
            total -= j[i, m] * step[m]
        step[i] = total / j[i, i]
    for i in range(3, -1, -1):
        total = step[i]
        for m in range(i + 1, 4):
            total -= j[m, i] * step[m]
        step[i] = total / j[i, i]
    return True


@kernel(error_model="numpy")
def _shape(t, q, k, row):  # type: ignore[no-untyped-def]
    """Value of A·exp(−½((t−x)/s)²) + B for q = (A, x, ln s, B), and its derivatives in row."""
    s = np.exp(q[2])
    u = (t[k] - q[1]) / s
    bell = np.exp(-0.5 * u * u)
    row[0], row[1], row[2], row[3] = bell, q[0] * bell * u / s, q[0] * bell * u * u, 1.0
    return q[0] * bell + q[3]


@kernel(error_model="numpy")
def _fit_rows(counts, slices, group, levels, noise, share, number, reads, t, width, snr, tau, sigma, ok):  # type: ignore[no-untyped-def]
    rows, cols = counts.shape[1], counts.shape[2]
    offset, scale, saturation = levels
    excess, floor = noise
    n = t.size
    bad = np.zeros(TILE, np.int64)
    q, try_q, row, score, step = np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(4)
    j, damped = np.zeros((4, 4)), np.zeros((4, 4))
    for r in range(rows):
        for first in range(0, cols, TILE):
            count = min(TILE, cols - first)
            y = np.empty((count, share.size))
            load_row(counts, slices, group, r, first, offset, scale, saturation, y, bad[:count])
            for c in range(count):
                if bad[c] != 0:
                    continue
                best, low = 0, np.inf
                for k in range(n):
                    y[c, k] *= share[k]
                    low = min(low, y[c, k])
                    if y[c, k] > y[c, best]:
                        best = k
                q[0], q[1], q[2], q[3] = y[c, best] - low, t[best], np.log(width), low
                if not q[0] > 0:
                    continue
                damping, here, settled = 1e-3, np.inf, False
                for _ in range(60):
                    j[:] = 0.0
                    score[:] = 0.0
                    here = 0.0
                    for k in range(n):
                        d = y[c, k] - _shape(t, q, k, row)
                        here += d * d
                        for a in range(4):
                            score[a] += row[a] * d
                            for b in range(4):
                                j[a, b] += row[a] * row[b]
                    moved = False
                    while damping < 1e9:
                        damped[:] = j
                        for a in range(4):
                            damped[a, a] *= 1 + damping
                        if _solve4(damped, score, step):
                            for a in range(4):
                                try_q[a] = q[a] + step[a]
                            there = 0.0
                            for k in range(n):
                                d = y[c, k] - _shape(t, try_q, k, row)
                                there += d * d
                            if there <= here * (1 + 1e-12) and abs(try_q[2] - np.log(width)) < 1.5:
                                moved = True
                                break
                        damping *= 10
                    if not moved:
                        break
                    q[:] = try_q
                    damping = max(damping * 0.1, 1e-9)
                    if abs(step[1]) < 1e-5 * width and abs(step[2]) < 1e-4 and abs(step[0]) < 1e-4 * abs(q[0]):
                        settled = True
                        break
                if not settled or not (t[0] <= q[1] <= t[n - 1]) or not q[0] > 0:
                    continue
                # The noise through the fit: (JᵀJ)⁻¹ Jᵀ V J (JᵀJ)⁻¹ of x and of A.
                j[:] = 0.0
                for k in range(n):
                    _shape(t, q, k, row)
                    for a in range(4):
                        for b in range(4):
                            j[a, b] += row[a] * row[b]
                for which in range(2):
                    damped[:] = j
                    score[:] = 0.0
                    score[which] = 1.0
                    if not _solve4(damped, score, step):
                        break
                    total = 0.0
                    for k in range(n):
                        mean = _shape(t, q, k, row)
                        lever = step[0] * row[0] + step[1] * row[1] + step[2] * row[2] + step[3] * row[3]
                        total += lever * lever * (excess * max(mean, 0.0) + floor * reads[k]) / number[k]
                    if which == 0 and not q[0] > snr * np.sqrt(total):
                        break
                    if which == 1:
                        tau[r, first + c], sigma[r, first + c] = q[1], np.sqrt(total)
                        ok[r, first + c] = np.sqrt(total) < width


@estimator(
    "gated", cites="Wagner et al., ISPRS J. Photogramm. 60:100, 2006 (Gaussian decomposition, Levenberg-Marquardt)"
)
def gaussian_least_squares(capture: xr.Dataset, *, min_snr: float = 4.0) -> xr.Dataset:
    """Least squares of y_k = A·exp(−½((t_k + ū − τ)/s)²) + B over (A, τ, s, B), equal weights, by Levenberg-Marquardt.

    ū is the centroid of R. Beside ū, the declared instrument enters only as the first value of the width (s stays within
    e^±1.5 of it), so that a wrongly declared pulse matters little; an R that is not Gaussian biases by its asymmetry.
    Other arguments: min_snr: least A in its standard errors. Returns range, sigma [m], valid (row, col): sigma propagates
    the photon noise of the fitted profile through the fit, without the error of the model, and holds the spread of the delays
    where a pixel sees several surfaces (`misfit`). Invalid: not settled within 60
    steps, centre outside the delays, a clipped or NaN sample.
    """
    stack = read_stack(capture)
    rig = stack.instrument
    shape = stack.counts.shape[1:]
    tau, sigma, ok = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, dtype=bool)
    n = stack.signal
    unit = float(np.sqrt(rig.responses[int(stack.gate[0])].variance_s2)) if n else 0.0
    if n < 5 or not unit > 0:  # too few slices, or a gate that never opens
        return range_result(tau, sigma, ok)
    used = stack.group < n
    t = stack.centroid_delay_s
    origin = float(t[0])
    _fit_rows(
        stack.counts, stack.slices[used], stack.group[used],
        (rig.offset_dn, 1 / rig.dn_per_pe, rig.saturation_dn), (rig.excess, rig.floor_var),
        stack.frames / stack.exposure[:n], stack.exposure[:n], stack.reads[:n], (t - origin) / unit, 1.0, min_snr,
        tau, sigma, ok,
    )  # fmt: skip
    time, error = origin + unit * tau, unit * sigma
    design = design_of(stack)
    error /= design.step_s
    hold_misfit(stack, design, (time - design.origin_s) / design.step_s, error, ok)
    return range_result(*rig.to_range(time, design.step_s * error), ok)
