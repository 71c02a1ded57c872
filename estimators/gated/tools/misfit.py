"""Goodness of fit of one echo: where the profile is not R, the stated error must hold what the model does not.

A pixel that sees two surfaces, or a response that was declared too narrow, gives a broader echo than R. To first order the
mean of an echo of delays spread by the variance V is A·(R + V/2·R″): one Fisher step in (B, A, τ, V) from the fit gives V
and its standard error (Rao's score test). The delays of the surfaces lie about √V from the echo's. What V does not describe
shows in Pearson's χ² = Σ (z−μ)²/μ, of mean n − 3 and variance Σ (2 + 1/μ). Both are those at the likeliest place, to which one
step from the given place leads: an estimator with more noise is not taken for a bad fit.
Source: C. R. Rao, Proc. Camb. Phil. Soc. 44:50, 1948; dispersion: P. McCullagh and J. Nelder, Generalized Linear Models, 1989.
"""

from __future__ import annotations

import numpy as np

from ....optics.jit import kernel
from .maximum import TILE
from .stack import load_row

__all__ = ["LIMIT", "NO_VEIL", "state_misfit"]

#: Standard errors beyond which V or χ² is no chance: V in 2 of 10,000 pixels that see one surface.
LIMIT = 3.5
FAST = {"reassoc", "contract"}
#: `below` and `strength` of an echo with no light of another course.
NO_VEIL = (np.empty((0, 0)), np.empty((0, 0)))


@kernel(fastmath=FAST, error_model="numpy")
def _light(zs, e, s, value, k0, k1, out, floor):  # type: ignore[no-untyped-def]
    """A and B of an echo of known place: least squares, reweighted twice. out: sums (z + s, e, s) of the groups beyond."""
    z_out, e_out, s_out = out
    a, b = 0.0, 0.0
    for turn in range(3):
        jaa, jab, ga, gb, jbb = 0.0, 0.0, 0.0, 0.0, 0.0
        for g in range(k0, k1):
            w = 1.0 if turn == 0 else 1 / max(a * value[g] + b * e[g] + s[g], 1e-3)
            v, r = value[g] * w, zs[g] - s[g]
            ga += v * r
            gb += e[g] * w * r
            jaa += v * value[g]
            jab += v * e[g]
            jbb += e[g] * e[g] * w
        if e_out > 0:
            w = 1 / e_out if turn == 0 else e_out / max(b * e_out + s_out, 1e-3)
            gb += (z_out - s_out) * w
            jbb += e_out * w
        determinant = jaa * jbb - jab * jab
        if not determinant > 1e-12 * jaa * jbb:
            return 0.0, 0.0
        a, b = (jbb * ga - jab * gb) / determinant, (jaa * gb - jab * ga) / determinant
        if b < floor:
            b = floor
            a = (ga - jab * b) / jaa
    return a, b


@kernel(fastmath=FAST, error_model="numpy")
def _spread(zs, e, s, value, slope, bend, k0, k1, out, a, b, held):  # type: ignore[no-untyped-def]
    """V, its variance (∞ where the groups do not tell it), χ² and the variance of χ², from A, B and the place of an echo.

    value, slope, bend (group): R, dR/dx and R″/2 there. held: whether B is at its bound."""
    z_out, e_out, s_out = out
    jbb, jab, jxb, jvb, jaa, jxa, jva, jxx, jvx, jvv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    gb, ga, gx, gv, square, variance = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for g in range(k0, k1):
        mean = max(a * value[g] + b * e[g] + s[g], 1e-3)
        w = 1 / mean
        r = zs[g] * w - 1
        v, x, c = value[g], a * slope[g], a * bend[g]
        gb += e[g] * r
        ga += v * r
        gx += x * r
        gv += c * r
        jbb += e[g] * e[g] * w
        jab += v * e[g] * w
        jxb += x * e[g] * w
        jvb += c * e[g] * w
        jaa += v * v * w
        jxa += x * v * w
        jva += c * v * w
        jxx += x * x * w
        jvx += c * x * w
        jvv += c * c * w
        square += mean * r * r
        variance += 2 + w
    if e_out > 0:
        mean = max(b * e_out + s_out, 1e-3)
        r = z_out / mean - 1
        gb += e_out * r
        jbb += e_out * e_out / mean
        square += mean * r * r
        variance += 2 + 1 / mean
    whole = jvv
    if not held:
        p = 1 / jbb
        jaa, jxa, jva = jaa - jab * jab * p, jxa - jab * jxb * p, jva - jab * jvb * p
        jxx, jvx, jvv = jxx - jxb * jxb * p, jvx - jxb * jvb * p, jvv - jvb * jvb * p
        ga, gx, gv = ga - jab * gb * p, gx - jxb * gb * p, gv - jvb * gb * p
    p = 1 / jaa
    jxx, jvx, jvv = jxx - jxa * jxa * p, jvx - jxa * jva * p, jvv - jva * jva * p
    gx, gv = gx - jxa * ga * p, gv - jva * ga * p
    p = 1 / jxx
    jvv, gv = jvv - jvx * jvx * p, gv - jvx * gx * p
    # One step in the place.
    if jxx > 0:
        square -= gx * gx / jxx
    if not (jaa > 0 and jxx > 0 and jvv > 1e-6 * whole):
        return 0.0, np.inf, square, variance
    return gv / jvv, 1 / jvv, square, variance


@kernel(error_model="numpy")
def state_misfit(  # type: ignore[no-untyped-def]
    counts,
    slices,
    group,
    e,
    known,
    levels,
    table,
    first,
    last,
    width,
    floor,
    limit,
    units,
    tau,
    sigma,
    suspect,
    below,
    strength,
):
    """Enlarge sigma (row, col) in place where the profile of a pixel is not R; arguments as `poisson_ml._fit_rows`.

    known (group): the shift of the likelihood. Light of a known course is part of the mean: strength (row, col) × below (row of
    the table, group) at the place; both empty where there is none.

    sigma² becomes sigma² + V where V exceeds `limit` of its standard errors, and at least sigma²·χ²/(n − 3) where χ² exceeds
    its mean by as many standard deviations. Pixels that have a clipped or missing sample, or fewer than five groups, are
    left alone. Groups beyond R enter as their sum. suspect (row, col): the pixels to look at.
    """
    offset, scale, saturation = levels
    n, rows, cols = e.size, counts.shape[1], counts.shape[2]
    z, bad = np.empty((TILE, n)), np.zeros(TILE, np.int64)
    zs, value, slope, bend = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    s = known.copy()
    half, veiled = 0.5 * width, strength.size > 0
    whole_e, whole_s = e.sum(), s.sum()
    for row in range(rows):
        for begin in range(0, cols, TILE):
            number = min(TILE, cols - begin)
            few = 8 * suspect[row, begin : begin + number].sum() < number
            if not few:
                load_row(counts, slices, group, row, begin, offset, scale, saturation, z[:number], bad[:number])
            for c in range(number):
                col = begin + c
                if not suspect[row, col]:
                    continue
                if few:
                    load_row(counts, slices, group, row, col, offset, scale, saturation, z[c : c + 1], bad[c : c + 1])
                if bad[c] != 0:
                    continue
                x = (tau[row, col] - units[0]) / units[1]
                if not (half + 1 < x < table.shape[0] - half - 2):
                    continue
                j, left, right = int(x + 0.5), int(x - half + 0.5), int(x + half + 0.5)
                f, fl, fr = x - j, x - half - left, x + half - right
                k0, k1 = min(first[left], first[right]), max(last[left], last[right])
                total, inside, e_in, s_in = 0.0, 0.0, 0.0, 0.0
                if veiled:
                    whole_s = 0.0
                    for g in range(n):
                        s[g] = known[g] + strength[row, col] * (
                            below[j, g] + f * 0.5 * (below[j + 1, g] - below[j - 1, g])
                        )
                        whole_s += s[g]
                for g in range(n):
                    zs[g] = z[c, g] + known[g]
                    total += zs[g]
                for g in range(k0, k1):
                    value[g] = table[j, 0, g] + f * (table[j, 1, g] + f * table[j, 2, g])
                    slope[g] = table[j, 1, g] + 2 * f * table[j, 2, g]
                    before = table[left, 0, g] + fl * (table[left, 1, g] + fl * table[left, 2, g])
                    after = table[right, 0, g] + fr * (table[right, 1, g] + fr * table[right, 2, g])
                    bend[g] = 0.5 * (before + after - 2 * value[g]) / (half * half)
                    inside, e_in, s_in = inside + zs[g], e_in + e[g], s_in + s[g]
                beyond = whole_e - e_in > 0.5 * e[0]
                out = (total - inside, whole_e - e_in if beyond else 0.0, whole_s - s_in)
                groups = k1 - k0 + (1 if beyond else 0)
                a, b = _light(zs, e, s, value, k0, k1, out, floor)
                if groups < 5 or not a > 0:
                    continue
                v, v_var, square, spread = _spread(zs, e, s, value, slope, bend, k0, k1, out, a, b, b <= floor)
                variance = sigma[row, col] ** 2
                stated = variance
                if v > limit * np.sqrt(v_var):
                    stated += units[1] * units[1] * v
                if square > groups - 3 + limit * np.sqrt(spread):
                    stated = max(stated, variance * square / (groups - 3))
                if stated > variance:
                    sigma[row, col] = np.sqrt(stated)
