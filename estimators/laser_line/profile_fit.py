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

from ...optics.jit import kernel

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
    _fit(
        np.ascontiguousarray(z), np.maximum(level, 0.0) + floor_e2, np.clip(width, _NARROW, _WIDE), weighted, free_width,
        1.0 / SPREAD**2, steps, out,
    )  # fmt: skip
    return out[0], out[1], out[2] > 0


@kernel
def _model(p, x, mu, grad):  # type: ignore[no-untyped-def]
    """μ and its gradient by (c, A, B, ln s) at the pixels x."""
    s = math.exp(p[3])
    root = 0.7071067811865476
    for j in range(x.size):
        hi = (x[j] + 0.5 - p[0]) / s
        lo = (x[j] - 0.5 - p[0]) / s
        share = 0.5 * (math.erf(hi * root) - math.erf(lo * root))
        up = 0.3989422804014327 * math.exp(-0.5 * hi * hi)
        down = 0.3989422804014327 * math.exp(-0.5 * lo * lo)
        mu[j] = p[2] + p[1] * share
        grad[0, j] = -p[1] * (up - down) / s
        grad[1, j] = share
        grad[2, j] = 1.0
        grad[3, j] = -p[1] * (hi * up - lo * down)


@kernel
def _solve(a, b, n):  # type: ignore[no-untyped-def]
    """x of a x = b (n, m) by elimination with pivots, in place; whether a has an inverse."""
    for i in range(n):
        best = i
        for r in range(i + 1, n):
            if abs(a[r, i]) > abs(a[best, i]):
                best = r
        if not abs(a[best, i]) > 1e-300:
            return False
        if best != i:
            for c in range(n):
                a[i, c], a[best, c] = a[best, c], a[i, c]
            for c in range(b.shape[1]):
                b[i, c], b[best, c] = b[best, c], b[i, c]
        for r in range(n):
            if r != i:
                ratio = a[r, i] / a[i, i]
                for c in range(i, n):
                    a[r, c] -= ratio * a[i, c]
                for c in range(b.shape[1]):
                    b[r, c] -= ratio * b[i, c]
    for i in range(n):
        for c in range(b.shape[1]):
            b[i, c] /= a[i, i]
    return True


@kernel
def _fit(z, floor, width, weighted, free_width, prior, steps, out):  # type: ignore[no-untyped-def]
    n, size = z.shape
    most = 4 if free_width else 3
    x = np.arange(size) - size // 2 + 0.0
    mu, trial = np.empty(size), np.empty(size)
    grad, other = np.empty((4, size)), np.empty((4, size))
    weight = np.ones(size)
    normal, step = np.empty((4, 4)), np.empty((4, 4))
    p, q, slope = np.empty(4), np.empty(4), np.empty(4)
    low, high = math.log(0.12), math.log(40.0)
    for i in range(n):
        out[0, i] = np.nan
        out[1, i] = np.nan
        out[2, i] = 0.0
        total = 0.0
        top = 0.0
        for j in range(size):
            total += max(z[i, j], 0.0)
            top = max(top, z[i, j])
        if not total > 0.0 or not top > 0.0:
            continue
        p[0], p[1], p[2], p[3] = 0.0, total, 0.0, math.log(width[i])
        # The neighbours' balance is a good first guess of the position.
        middle = size // 2
        p[0] = 0.5 * (z[i, middle + 1] - z[i, middle - 1]) / top
        damping = 1e-3
        first = p[3]
        held = prior if weighted else prior * floor[i]
        if not free_width:
            held = 0.0
        _model(p, x, mu, grad)
        done = False
        free = most
        for _ in range(steps):
            cost = 0.0
            for j in range(size):
                if weighted:
                    weight[j] = 1.0 / (max(mu[j], 0.0) + floor[i])
                cost += weight[j] * (z[i, j] - mu[j]) ** 2
            cost += held * (p[3] - first) ** 2
            for a in range(free):
                step[a, 0] = 0.0
                for j in range(size):
                    step[a, 0] += weight[j] * grad[a, j] * (z[i, j] - mu[j])
                for b in range(free):
                    normal[a, b] = 0.0
                    for j in range(size):
                        normal[a, b] += weight[j] * grad[a, j] * grad[b, j]
            if free == 4:
                step[3, 0] -= held * (p[3] - first)
                normal[3, 3] += held
            for a in range(free):
                slope[a] = step[a, 0]
                normal[a, a] *= 1.0 + damping
                normal[a, a] += 1e-300
            if not _solve(normal, step[:, :1], free):
                break
            expected = 0.0
            for a in range(4):
                q[a] = p[a] + (step[a, 0] if a < free else 0.0)
                expected += step[a, 0] * slope[a] if a < free else 0.0
            q[0] = min(max(q[0], p[0] - 0.5), p[0] + 0.5)
            if q[3] <= low or q[3] >= high:  # a width at its limit is held there: the others' step is another one then
                q[3] = min(max(q[3], low), high)
                free = 3
            _model(q, x, trial, other)
            new = 0.0
            for j in range(size):
                new += weight[j] * (z[i, j] - trial[j]) ** 2
            new += held * (q[3] - first) ** 2
            if new <= cost * (1.0 + 1e-9):
                moved = abs(q[0] - p[0])
                for a in range(4):
                    p[a] = q[a]
                _model(p, x, mu, grad)
                # A step that gains much less than it should overshoots: Gauss-Newton would go to and fro across the minimum.
                ratio = (cost - new) / expected if expected > 0.0 else 1.0
                damping = max(damping * (4.0 if ratio < 0.25 else 0.2 if ratio > 0.75 else 1.0), 1e-12)
                damping = max(damping, 1e-3) if ratio < 0.25 else damping
                if moved < 1e-6 and damping < 0.1:
                    done = True
                    break
            else:
                damping *= 8.0
                if damping > 1e12:
                    done = True
                    break
        if not done or not p[1] > 0.0:
            continue
        free = most
        # Covariance: N⁻¹ M N⁻¹ with N = Σ w ∇∇ᵀ, M = Σ w² V ∇∇ᵀ; for weights 1/V it is N⁻¹.
        for a in range(free):
            for b in range(free):
                normal[a, b] = 0.0
                for j in range(size):
                    w = 1.0 / (max(mu[j], 0.0) + floor[i]) if weighted else 1.0
                    normal[a, b] += w * grad[a, j] * grad[b, j]
                step[a, b] = 1.0 if a == b else 0.0
        if free == 4:
            normal[3, 3] += held
        if not _solve(normal, step[:, :free], free):
            continue
        variance = 0.0
        for j in range(size):
            v = max(mu[j], 0.0) + floor[i]
            w = 1.0 / v if weighted else 1.0
            sensitivity = 0.0
            for a in range(free):
                sensitivity += step[0, a] * grad[a, j]
            variance += (w * sensitivity) ** 2 * v
        out[0, i] = p[0]
        out[1, i] = math.sqrt(variance)
        out[2, i] = 1.0
