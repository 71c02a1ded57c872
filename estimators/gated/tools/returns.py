"""Likelihood of a profile with any number of echoes in water: the model, its derivatives, and Fisher scoring with bounds.

μ_k = Σ_i A_i·R(τ_i−t_k) + C·b_k(τ_last) + B·e_k + s_k; parameters q = (B, C, x_1, A_1, x_2, A_2, …), x in rows of the design
table. b_k(τ) = ∫^τ e^(−2cr)/r²·R(τ'−t_k) dτ' is single backscatter up to the last surface, which hides the water behind it.
"""

from __future__ import annotations

import numpy as np

from ....optics.jit import kernel
from .scoring import information_step, log_likelihood, read_design

__all__ = ["climb", "model"]

#: Steps below this part of the standard error of each echo time end the fit.
SETTLED = 0.02


@kernel(error_model="numpy")
def model(q, e, s, table, below, decay, mean, columns):  # type: ignore[no-untyped-def]
    """Fill mean (group) and columns (parameter, group) = ∂μ/∂q. Where `below` (row, group) has one row there is no water."""
    echoes = (q.size - 2) // 2
    for g in range(e.size):
        columns[0, g] = e[g]
        columns[1, g] = 0.0
        mean[g] = q[0] * e[g] + s[g]
    for i in range(echoes):
        read_design(table, q[2 + 2 * i], columns[3 + 2 * i], columns[2 + 2 * i])
        for g in range(e.size):
            mean[g] += q[3 + 2 * i] * columns[3 + 2 * i, g]
            columns[2 + 2 * i, g] *= q[3 + 2 * i]
    if below.shape[0] > 1:
        x = q[2 * echoes]
        j = int(x + 0.5)
        last = 2 * echoes
        for g in range(e.size):
            value = columns[last + 1, g]
            columns[1, g] = below[j, g] + (x - j) * decay[j] * value
            mean[g] += q[1] * columns[1, g]
            columns[last, g] += q[1] * decay[j] * value


@kernel(error_model="numpy")
def climb(zs, e, s, table, below, decay, bounds, q, error):  # type: ignore[no-untyped-def]
    """Maximise the likelihood of zs = z + s from q on, in place; error: standard errors. Returns (settled, log likelihood).

    bounds: least and greatest x, longest step of x, least B. B and C are held at their bound (0 for C) while the score
    points beyond it; steps are halved until the likelihood does not fall; the echoes stay in order of x.
    """
    low, high, reach, floor = bounds
    n, p = zs.size, q.size
    water = below.shape[0] > 1
    mean, columns = np.empty(n), np.empty((p, n))
    other, spare = np.empty(n), np.empty((p, n))
    step, new = np.empty(p), np.empty(p)
    free = np.ones(p, np.bool_)
    model(q, e, s, table, below, decay, mean, columns)
    here = log_likelihood(zs, mean)
    if not here > -np.inf:
        return False, here
    for _ in range(40):
        free[:] = True
        free[1] = water
        ready = False
        for _again in range(3):
            if not information_step(zs, mean, columns, free, step, error):
                break
            ready = True
            if free[0] and q[0] + step[0] < floor and q[0] <= floor:
                free[0] = False
            elif free[1] and q[1] + step[1] < 0 and q[1] <= 0:
                free[1] = False
            else:
                break
            ready = False
        if not ready:
            return False, here
        scale, done = 1.0, True
        for i in range(2, p, 2):
            scale = min(scale, reach / max(abs(step[i]), 1e-300))
            done = done and abs(step[i]) < SETTLED * error[i]
        moved = False
        for _half in range(14):
            inside = True
            for i in range(p):
                new[i] = q[i] + scale * step[i]
            new[0], new[1] = max(new[0], floor), max(new[1], 0.0)
            for i in range(2, p, 2):
                inside = inside and low <= new[i] <= high and new[i + 1] > 0 and (i == 2 or new[i] > new[i - 2])
            if inside:
                model(new, e, s, table, below, decay, other, spare)
                there = log_likelihood(zs, other)
                if there >= here - 1e-12 * abs(here):
                    moved = True
                    break
            scale *= 0.5
        if not moved:
            return done, here
        q[:], mean[:], columns[:], here = new, other, spare, there
        if done:
            return True, here
    return False, here
