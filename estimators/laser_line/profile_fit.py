"""Fit of a pixel-integrated Gaussian to the windows of a line, compiled: Levenberg-Marquardt for every row alone.

    μ_j = B + A [Φ((j + ½ − c)/s) − Φ((j − ½ − c)/s)]

with c, A, B and ln s free (or s held). A free ln s is expected within `SPREAD` of its first value, which settles it where the
light is too weak to do so. Weighted, the weights are 1/(max(μ, 0) + v), v the variance without light: quasi-maximum
likelihood (R. W. M. Wedderburn, Biometrika 61:439, 1974), as precise as maximum likelihood for Poisson light and read noise.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ...optics.copying import copy_into
from ...optics.jit import kernel
from .profile_model import normal_table, profile

__all__ = ["SPREAD", "fit_profiles"]

Float = npt.NDArray[np.float64]

#: Standard deviation of ln s about what the rig declares: matter that is turned away widens or narrows the line.
SPREAD = 0.5
#: Widths outside of these [px] are no lines.
_NARROW, _WIDE = 0.12, 40.0


def fit_profiles(
    z: Float, level: Float, floor_e2: float, width: Float, *, weighted: bool, free_width: bool, steps: int = 100
) -> tuple[Float, Float, npt.NDArray[np.bool_]]:
    """(position [px] from the middle pixel, its standard error [px], whether the fit converged), each (n).

    Main arguments:
        z (n, 2h + 1): photoelectrons above the background `level` (n), which only the noise needs. floor_e2: variance of a
            pixel without light. width (n): s to begin with, or to hold [px].
    """
    out = np.empty((3, z.shape[0]))
    _fit_all(
        np.ascontiguousarray(z), np.maximum(level, 0.0) + floor_e2, np.clip(width, _NARROW, _WIDE), weighted, free_width,
        1.0 / SPREAD**2, steps, normal_table(), out,
    )  # fmt: skip
    return out[0], out[1], out[2] > 0


@kernel(error_model="numpy")
def _fit_all(z, floor, width, weighted, free_width, prior, steps, table, out):  # type: ignore[no-untyped-def]
    size = z.shape[1]
    work, edge = np.empty((9, size)), np.empty((2, size + 1))
    p, q = np.empty(4), np.empty(4)
    normal, step, slope = np.empty((4, 4)), np.empty(4), np.empty(4)
    for i in range(z.shape[0]):
        out[0, i], out[1, i], out[2, i] = np.nan, np.nan, 0.0
        if not _start(z[i], width[i], p):
            continue
        held = 0.0 if not free_width else prior if weighted else prior * floor[i]
        found = _minimise(
            z[i], floor[i], weighted, free_width, held, steps, table, p, q, work, edge, normal, step, slope
        )
        variance = _variance(floor[i], weighted, free_width, held, work, normal, step) if found else 0.0
        if variance > 0.0:
            out[0, i], out[1, i], out[2, i] = p[0], math.sqrt(variance), 1.0


@kernel(error_model="numpy")
def _start(z, width, p):  # type: ignore[no-untyped-def]
    """First c, A, B, ln s into p; whether the window holds light. c is that of a Gaussian through the three middle pixels."""
    total, middle = 0.0, z.size // 2
    for j in range(z.size):
        total += max(z[j], 0.0)
    top = z[middle]
    if not total > 0.0 or not top > 0.0:
        return False
    p[0], p[1], p[2], p[3] = 0.0, total, 0.0, math.log(width)
    before, after = z[middle - 1], z[middle + 1]
    if before > 0.0 and after > 0.0 and (before < top or after < top):
        left, right = math.log(before / top), math.log(after / top)
        p[0] = min(max(0.5 * (left - right) / (left + right), -0.5), 0.5)
    else:
        p[0] = min(max(0.5 * (after - before) / top, -0.5), 0.5)
    return True


@kernel(error_model="numpy")
def _minimise(z, floor, weighted, free_width, held, steps, table, p, q, work, edge, normal, step, slope):  # type: ignore[no-untyped-def]
    """c, A, B, ln s of the least misfit into p, and its model into `work`; whether it was found.

    `work` holds the weights, and behind them μ and its derivatives by c, A, ln s, of p and of what is tried.
    """
    low, high = math.log(0.12), math.log(40.0)
    first, damping = p[3], 1e-3
    best, trial = work[1:5], work[5:9]
    profile(p[0], p[1], p[2], math.exp(p[3]), table, edge, best[0], best[1], best[2], best[3])
    free, done = free_width, False
    for _ in range(steps):
        _weigh(best[0], floor, weighted, work[0])
        cost = _misfit(z, best[0], work[0]) + held * (p[3] - first) ** 2
        _gradient(z, work[0], best, slope)
        slope[3] = slope[3] - held * (p[3] - first) if free else 0.0
        _information(work[0], best, held, free, normal)
        for a in range(4):
            normal[a, a] = normal[a, a] * (1.0 + damping) + 1e-300
            step[a] = slope[a]
        if not _solve(normal, step):
            break
        expected = 0.0
        for a in range(4):
            expected += step[a] * slope[a]
            q[a] = p[a] + step[a]
        q[0] = min(max(q[0], p[0] - 0.5), p[0] + 0.5)
        if free and not low < q[3] < high:  # a width at its limit is held there: the others' step is another one then
            q[3] = min(max(q[3], low), high)
            free = False
        profile(q[0], q[1], q[2], math.exp(q[3]), table, edge, trial[0], trial[1], trial[2], trial[3])
        new = _misfit(z, trial[0], work[0]) + held * (q[3] - first) ** 2
        if new <= cost * (1.0 + 1e-9):
            still = abs(q[0] - p[0]) < 1e-4 and abs(q[3] - p[3]) < 1e-2
            copy_into(p, q)
            best, trial = trial, best
            # A step that gains much less than it should overshoots: Gauss-Newton would go to and fro across the minimum.
            ratio = (cost - new) / expected if expected > 0.0 else 1.0
            damping = max(damping * (4.0 if ratio < 0.25 else 0.1 if ratio > 0.75 else 1.0), 1e-12)
            damping = max(damping, 1e-3) if ratio < 0.25 else damping
            if still and damping < 2e-3:
                done = True
                break
        else:
            damping *= 8.0
            if damping > 1e12:
                done = True
                break
    for a in range(4):
        copy_into(work[1 + a], best[a])
    return done and p[1] > 0.0


@kernel(error_model="numpy")
def _weigh(mu, floor, weighted, weight):  # type: ignore[no-untyped-def]
    for j in range(mu.size):
        weight[j] = 1.0 / (max(mu[j], 0.0) + floor) if weighted else 1.0


@kernel(error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def _misfit(z, mu, weight):  # type: ignore[no-untyped-def]
    total = 0.0
    for j in range(z.size):
        total += weight[j] * (z[j] - mu[j]) ** 2
    return total


@kernel(error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def _gradient(z, weight, model, slope):  # type: ignore[no-untyped-def]
    """Σ w ∇μ (z − μ) into slope (4)."""
    c = height = level = s = 0.0
    for j in range(z.size):
        w = weight[j] * (z[j] - model[0, j])
        c += w * model[1, j]
        height += w * model[2, j]
        level += w
        s += w * model[3, j]
    slope[0], slope[1], slope[2], slope[3] = c, height, level, s


@kernel(error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def _information(weight, model, held, free, normal):  # type: ignore[no-untyped-def]
    """Σ w ∇μ ∇μᵀ into normal (4, 4), lower triangle; a width that is held has 1 alone."""
    cc = ch = hh = cl = hl = ll = cs = hs = ls = ss = 0.0
    for j in range(weight.size):
        w, c, h, s = weight[j], model[1, j], model[2, j], model[3, j]
        wc, wh, ws = w * c, w * h, w * s
        cc += wc * c
        ch += wc * h
        hh += wh * h
        cl += wc
        hl += wh
        ll += w
        cs += wc * s
        hs += wh * s
        ls += ws
        ss += ws * s
    if not free:
        cs = hs = ls = 0.0
        ss, held = 1.0, 0.0
    normal[0, 0] = cc
    normal[1, 0], normal[1, 1] = ch, hh
    normal[2, 0], normal[2, 1], normal[2, 2] = cl, hl, ll
    normal[3, 0], normal[3, 1], normal[3, 2], normal[3, 3] = cs, hs, ls, ss + held


@kernel(error_model="numpy")
def _solve(a, b):  # type: ignore[no-untyped-def]
    """x of a x = b (4) for a positive definite `a`, its lower triangle given: L D Lᵀ in place. Whether `a` is one."""
    for i in range(4):
        for k in range(i):
            total = a[i, k]
            for m in range(k):
                total -= a[i, m] * a[k, m] * a[m, m]
            a[i, k] = total / a[k, k]
        total = a[i, i]
        for m in range(i):
            total -= a[i, m] * a[i, m] * a[m, m]
        if not total > 1e-300:
            return False
        a[i, i] = total
    for i in range(4):
        for m in range(i):
            b[i] -= a[i, m] * b[m]
    for i in range(4):
        b[i] /= a[i, i]
    for i in range(3, -1, -1):
        for m in range(i + 1, 4):
            b[i] -= a[m, i] * b[m]
    return True


@kernel(error_model="numpy")
def _variance(floor, weighted, free_width, held, work, normal, step):  # type: ignore[no-untyped-def]
    """(N⁻¹ M N⁻¹)_cc with N = Σ w ∇μ∇μᵀ and M = Σ w² V ∇μ∇μᵀ; for weights 1/V it is (N⁻¹)_cc. NaN where N has no inverse."""
    model = work[1:5]
    _weigh(model[0], floor, weighted, work[0])
    _information(work[0], model, held, free_width, normal)
    step[0], step[1], step[2], step[3] = 1.0, 0.0, 0.0, 0.0
    if not _solve(normal, step):
        return np.nan
    total = 0.0
    for j in range(model.shape[1]):
        v = max(model[0, j], 0.0) + floor
        part = step[0] * model[1, j] + step[1] * model[2, j] + step[2]
        if free_width:
            part += step[3] * model[3, j]
        total += (work[0, j] * part) ** 2 * v
    return total
