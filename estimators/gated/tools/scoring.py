"""Fisher scoring in a few parameters with lower bounds, for likelihood fits of more than one echo."""

from __future__ import annotations

import numpy as np

from ....optics.jit import kernel

__all__ = ["information_step", "log_likelihood", "read_design"]


@kernel(error_model="numpy")
def read_design(table, x, value, slope):  # type: ignore[no-untyped-def]
    """R and dR/dx of all groups at row x (any fraction) of a design table."""
    j = int(x + 0.5)
    f = x - j
    for g in range(value.size):
        value[g] = table[j, 0, g] + f * (table[j, 1, g] + f * table[j, 2, g])
        slope[g] = table[j, 1, g] + 2 * f * table[j, 2, g]


@kernel(error_model="numpy")
def log_likelihood(z, mean):  # type: ignore[no-untyped-def]
    """Σ z·ln μ − μ of shifted Poisson counts, without constants; −inf where a mean is not positive."""
    total = 0.0
    for g in range(z.size):
        if not mean[g] > 0:
            return -np.inf
        total += z[g] * np.log(mean[g]) - mean[g]
    return total


@kernel(error_model="numpy")
def information_step(z, mean, columns, free, step, error):  # type: ignore[no-untyped-def]
    """Step = J⁻¹·score of the free parameters and their standard errors; columns (parameter, group) = ∂μ/∂parameter.

    J = Σ ∂μ ∂μᵀ/μ is solved by the Cholesky factors of its free part, scaled to a unit diagonal. Parameters that are not
    free get the step 0 and the error ∞. Returns False where J is singular.
    """
    p = columns.shape[0]
    j = np.zeros((p, p))
    score = np.zeros(p)
    scale = np.ones(p)
    for i in range(p):
        step[i], error[i] = 0.0, np.inf
    for g in range(z.size):
        w = 1 / mean[g]
        r = z[g] * w - 1
        for i in range(p):
            score[i] += columns[i, g] * r
            for k in range(i + 1):
                j[i, k] += columns[i, g] * columns[k, g] * w
    for i in range(p):
        if not free[i]:
            score[i] = 0.0
            for k in range(p):
                if k < i:
                    j[i, k] = 0.0
                elif k > i:
                    j[k, i] = 0.0
            j[i, i] = 1.0
        if not j[i, i] > 0:
            return False
        scale[i] = 1 / np.sqrt(j[i, i])
    for i in range(p):
        for k in range(i + 1):
            total = j[i, k] * scale[i] * scale[k]
            for m in range(k):
                total -= j[i, m] * j[k, m]
            if i == k:
                if not total > 1e-10:
                    return False
                j[i, i] = np.sqrt(total)
            else:
                j[i, k] = total / j[k, k]
    half = np.zeros(p)
    for i in range(p):
        total = score[i] * scale[i]
        for m in range(i):
            total -= j[i, m] * half[m]
        half[i] = total / j[i, i]
    for i in range(p - 1, -1, -1):
        total = half[i]
        for m in range(i + 1, p):
            total -= j[m, i] * step[m]
        step[i] = total / j[i, i]
    for i in range(p):
        # Column i of the inverse: |L⁻¹e_i|² is its diagonal.
        square = 0.0
        for m in range(p):
            half[m] = 0.0
        for m in range(i, p):
            total = 1.0 if m == i else 0.0
            for q in range(i, m):
                total -= j[m, q] * half[q]
            half[m] = total / j[m, m]
            square += half[m] * half[m]
        error[i] = np.sqrt(square) * scale[i]
    for i in range(p):
        if free[i]:
            step[i] *= scale[i]
        else:
            step[i], error[i] = 0.0, np.inf
    return True
