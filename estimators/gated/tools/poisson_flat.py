"""Likelihoods with flat tops. Where pulse and gate are rectangular, R has corners, and between them are delays that no slice
distinguishes.

Every delay of such a plateau is a maximum; the Fisher information is zero or discontinuous there, and Newton steps do not
converge. The answer is the middle of the top instead: mean and standard deviation of the profile likelihood, normalised
over delays, with amplitude and background fitted at each delay. For a likelihood with one quadratic top these are its maximum
and the standard error of the Fisher information.
"""

from __future__ import annotations

import numpy as np

from ....optics.jit import kernel
from .poisson_clipped import log_reached, reached

__all__ = ["fit_flat"]

#: Points at which the profile is computed, and the drop of its logarithm that ends it: ±5 standard errors.
_POINTS = 33
_DROP = 12.0


@kernel(error_model="numpy")
def _level(zs, e, s, share, held, table, x, floor, a, b):  # type: ignore[no-untyped-def]
    """(log likelihood, variance of A, A, B) of the best A and B at delay x."""
    clipped, clip, e_one, s_one, part = held
    j = min(max(int(x + 0.5), 0), table.shape[0] - 1)
    f = x - j
    like, variance = -np.inf, np.inf
    for turn in range(12):
        jaa, jab, jbb, ga, gb, here = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for g in range(zs.size):
            if share[g] > 0:
                v = share[g] * (table[j, 0, g] + f * (table[j, 1, g] + f * table[j, 2, g]))
                mean = max(a * v + b * e[g] + s[g], 1e-12)
                w = 1 / mean
                r = zs[g] * w - 1
                ga += v * r
                gb += e[g] * r
                jaa += v * v * w
                jab += v * e[g] * w
                jbb += e[g] * e[g] * w
                here += (zs[g] * np.log(mean) if zs[g] > 0 else 0.0) - mean
            if clipped[g] > 0:
                v = part[g] * (table[j, 0, g] + f * (table[j, 1, g] + f * table[j, 2, g]))
                mean = max(a * v + b * e_one[g] + s_one[g], 1e-12)
                r, w = reached(mean, clip[g])
                r, w = clipped[g] * r, clipped[g] * w
                ga += v * r
                gb += e_one[g] * r
                jaa += v * v * w
                jab += v * e_one[g] * w
                jbb += e_one[g] * e_one[g] * w
                here += clipped[g] * log_reached(mean, clip[g])
        like = here
        fixed = b <= floor and gb < 0
        determinant = jaa * jbb - jab * jab
        if fixed:
            if not jaa > 0:
                break
            variance, da, db = 1 / jaa, ga / jaa, 0.0
        else:
            if not determinant > 1e-12 * jaa * jbb:
                break
            variance = jbb / determinant
            da, db = (jbb * ga - jab * gb) / determinant, (jaa * gb - jab * ga) / determinant
        if turn == 11 or da * da < 1e-6 * variance:
            break
        a = a + da if da > -0.7 * a else 0.3 * a
        b = max(b + db, floor)
    return like, variance, a, b


@kernel(error_model="numpy")
def fit_flat(zs, e, s, share, held, table, low, high, width, floor, x, a, b):  # type: ignore[no-untyped-def]
    """x, A, B, var x, var A of one pixel, and whether there is a top within the window; arguments as `fit_careful`.

    The profile is computed over ±2.5 σ_R of the start, then over the delays within 12 of its top, until these stay the same.
    """
    first, last = max(low, x - 2.5 * width), min(high, x + 2.5 * width)
    place, like = np.empty(_POINTS), np.empty(_POINTS)
    best = 0
    var_a, top_a, top_b = np.inf, a, b
    for _ in range(8):
        best, top = 0, -np.inf
        for i in range(_POINTS):
            place[i] = first + (last - first) * i / (_POINTS - 1)
            like[i], variance, fitted, under = _level(zs, e, s, share, held, table, place[i], floor, a, b)
            if like[i] > top:
                best, top, var_a, top_a, top_b = i, like[i], variance, fitted, under
        if not top > -np.inf:
            return x, a, b, np.inf, np.inf, False
        left, right = best, best
        while left > 0 and like[left] > top - _DROP:
            left -= 1
        while right < _POINTS - 1 and like[right] > top - _DROP:
            right += 1
        if place[right] - place[left] > 0.6 * (last - first) or place[right] - place[left] < 1e-4:
            break
        first, last = place[left], place[right]
    total, mean = 0.0, 0.0
    for i in range(_POINTS):
        w = np.exp(like[i] - like[best])
        total += w
        mean += w * place[i]
    mean /= total
    square = 0.0
    for i in range(_POINTS):
        square += np.exp(like[i] - like[best]) * (place[i] - mean) ** 2
    return mean, top_a, top_b, square / total, var_a, 0 < best < _POINTS - 1
