"""Kernels of `poisson-ml`: the start, Fisher scoring, and the careful path with step halving. Time is in rows of the design
table, light in scaled photoelectrons."""

from __future__ import annotations

import numpy as np

from ....optics.jit import kernel
from .poisson_clipped import log_reached, reached

__all__ = ["fit_careful", "fit_fast", "solve", "start"]

#: Square of the last step, in standard errors of x: the error left is its product with the rate, which is below a tenth.
SETTLED = 1.6e-3
#: Sums may be reordered (so that they use vector registers); NaN and infinity keep their meaning.
FAST = {"reassoc", "contract"}


@kernel(fastmath=FAST, error_model="numpy")
def _match(z, table, first, last, j):  # type: ignore[no-untyped-def]
    v = table[j, 0]
    total = 0.0
    for g in range(first[j], last[j]):
        total += z[g] * v[g]
    return total


@kernel(fastmath=FAST, error_model="numpy")
def start(z, e, s, table, first, last, candidates, box, mean, norm, running):  # type: ignore[no-untyped-def]
    """Matched filter with the background projected out: (x, A, B) of the best candidate; A ≤ 0 without one.

    score_j = Σ z·(v − m·e)/|v − m·e| on a grid of ¾ σ_R, its maximum refined by a parabola. Running sums over boxes (R
    above .3 of its peak: 6 % less signal to noise than the matched filter) select the candidates to try; where the best
    box is not far above the noise, all candidates are tried.
    """
    n = candidates.size
    light, square = 0.0, 0.0
    running[0] = 0.0
    for g in range(z.size):
        light += e[g] * z[g]
        square += e[g] * e[g]
        running[g + 1] = light
    level = light / square
    best, top = 0, -np.inf
    for i in range(n):
        score = (running[box[i, 1]] - running[box[i, 0]] - level * box[i, 2]) * norm[i, 1]
        if score > top:
            best, top = i, score
    inside = running[box[best, 1]] - running[box[best, 0]]
    net = inside - level * box[best, 2]
    begin, end = max(best - 2, 0), min(best + 3, n)
    if net * net < 64.0 * (max(inside, 1.0) + s[0] * box[best, 2]):
        begin, end = 0, n
    best, top, before, after, held = -1, 0.0, 0.0, 0.0, 0.0
    for i in range(begin, end):
        score = (_match(z, table, first, last, candidates[i]) - mean[i] * light) * norm[i, 0]
        if score > top:
            best, top, before, after = i, score, held, -np.inf
        elif i == best + 1:
            after = score
        held = score
    if best < 0:
        return 0.0, 0.0, 0.0
    x = float(candidates[best])
    amplitude = top * norm[best, 0]
    background = level - amplitude * mean[best]
    if begin < best < end - 1:
        bend = 2 * top - before - after
        if bend > 0:
            x += 0.5 * (after - before) / bend * (candidates[1] - candidates[0])
    return x, amplitude, background


@kernel(error_model="numpy")
def solve(jxx, jxa, jxb, jaa, jab, jbb, gx, ga, gb, held):  # type: ignore[no-untyped-def]
    """Step (dx, dA, dB) and the variances of x and A. With `held` the background stays at its value."""
    by_b = 1 / jbb
    c, e = jxb * by_b, jab * by_b
    a2, b2, d2 = jxx - c * jxb, jxa - c * jab, jaa - e * jab
    by_d = 1 / d2
    a3 = a2 - b2 * b2 * by_d
    if not (d2 > 0 and a3 > 0):
        return 0.0, 0.0, 0.0, np.inf, np.inf
    var_x = 1 / a3
    var_a = a2 * by_d * var_x
    if held:
        w = jxx - jxa * jxa / jaa
        dx = (gx - jxa / jaa * ga) / w
        return dx, (ga - jxa * dx) / jaa, 0.0, var_x, var_a
    hx, ha = gx - c * gb, ga - e * gb
    dx = (hx - b2 * by_d * ha) * var_x
    da = (ha - b2 * dx) * by_d
    return dx, da, (gb - jxb * dx - jab * da) * by_b, var_x, var_a


@kernel(fastmath=FAST, error_model="numpy")
def _sums(zs, e, s, table, j, f, k0, k1, a, b):  # type: ignore[no-untyped-def]
    """Score and Fisher information of (x, A, B) over groups k0..k1: r = (z+s)/V − 1, V = A·R + B·e + s."""
    v, d, c = table[j, 0], table[j, 1], table[j, 2]
    jxx, jxa, jxb, jaa, jab, jbb = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    gx, ga, gb, inside = 0.0, 0.0, 0.0, 0.0
    for g in range(k0, k1):
        value = v[g] + f * (d[g] + f * c[g])
        slope = a * (d[g] + 2 * f * c[g])
        w = 1 / (a * value + b * e[g] + s[g])
        r = zs[g] * w - 1
        gx += slope * r
        ga += value * r
        gb += e[g] * r
        sw, vw = slope * w, value * w
        jxx += slope * sw
        jxa += value * sw
        jxb += e[g] * sw
        jaa += value * vw
        jab += e[g] * vw
        jbb += e[g] * e[g] * w
        inside += zs[g]
    return jxx, jxa, jxb, jaa, jab, jbb, gx, ga, gb, inside


@kernel(fastmath=FAST, error_model="numpy")
def fit_fast(zs, e, s, e_sum, s_sum, table, first, last, low, high, reach, floor, x, a, b):  # type: ignore[no-untyped-def]
    """Fisher scoring from (x, A, B); groups beyond R's support enter as one sum, which is sufficient for them.

    Returns x, A, B, var x, var A and whether the last step was below .04 of x's standard error within 12 steps.
    """
    total = 0.0
    for g in range(zs.size):
        total += zs[g]
    var_x, var_a = np.inf, np.inf
    for _ in range(12):
        if not (low <= x <= high and a > 0):
            break
        j = int(x + 0.5)
        k0, k1 = first[j], last[j]
        jxx, jxa, jxb, jaa, jab, jbb, gx, ga, gb, inside = _sums(zs, e, s, table, j, x - j, k0, k1, a, b)
        e_out, s_out = e_sum[-1] - (e_sum[k1] - e_sum[k0]), s_sum[-1] - (s_sum[k1] - s_sum[k0])
        if e_out > 0.5 * e[0]:
            w = 1 / (b * e_out + s_out)
            gb += e_out * ((total - inside) * w - 1)
            jbb += e_out * e_out * w
        dx, da, db, var_x, var_a = solve(jxx, jxa, jxb, jaa, jab, jbb, gx, ga, gb, False)
        if not var_x < np.inf:
            break
        if b + db <= floor:
            b, db = floor, 0.0
            # The background is held at its bound: the other two move without it, by the information at its old value.
            dx, da, _db, var_x, var_a = solve(jxx, jxa, jxb, jaa, jab, jbb, gx, ga, gb, True)
        b += db
        a = a + da if da > -0.7 * a else 0.3 * a
        x += min(max(dx, -reach), reach)
        if dx * dx <= SETTLED * var_x and abs(da) < 0.1 * a:
            return x, a, b, var_x, var_a, low <= x <= high and a > 0
    return x, a, b, var_x, var_a, False


@kernel(error_model="numpy")
def _misfit(zs, e, s, share, held, table, x, a, b):  # type: ignore[no-untyped-def]
    """−log likelihood of the shifted Poisson counts and of the clipped ones, without constants."""
    clipped, clip, e_one, s_one, part = held
    j = int(x + 0.5)
    f = x - j
    total = 0.0
    for g in range(zs.size):
        v = a * (table[j, 0, g] + f * (table[j, 1, g] + f * table[j, 2, g]))
        if share[g] > 0:
            mean = v * share[g] + b * e[g] + s[g]
            if mean <= 0:
                return np.inf
            total += mean - zs[g] * np.log(mean)
        if clipped[g] > 0:
            mean = v * part[g] + b * e_one[g] + s_one[g]
            if mean <= 0:
                return np.inf
            total -= clipped[g] * log_reached(mean, clip[g])
    return total


@kernel(error_model="numpy")
def _first(zs, e, s, share, held, table, low, high, reach, x, a, b):  # type: ignore[no-untyped-def]
    """The best of several starts where samples are clipped: the light they lack makes the matched filter's amplitude too
    small."""
    best, top, x1, a1 = np.inf, 0, x, a
    for turn in range(3):
        place = min(max(x + (0.0, -2.0, 2.0)[turn] * reach, low), high)
        for power in range(12):
            there = _misfit(zs, e, s, share, held, table, place, a * 3.0**power, b)
            if there < best:
                best, top, x1, a1 = there, power, place, a * 3.0**power
            elif power > top + 1 and turn == 0:
                break
    return x1, a1


@kernel(error_model="numpy")
def fit_careful(zs, e, s, share, held, table, low, high, reach, floor, x, a, b):  # type: ignore[no-untyped-def]
    """Fisher scoring with step halving on the likelihood, for pixels with missing samples and those that did not settle.

    share[g] is the usable part of group g; e and s are those of that part, in arrays of the caller that are changed where
    the part is 0. `held`: per group the number of clipped samples, and for one of them the clip, exposure, shift and part
    of the group. Returns as `fit_fast`.
    """
    clipped, clip, e_one, s_one, part = held
    scaled = np.empty((1, 3, zs.size))
    b = max(b, floor)
    if clipped.any():
        x, a = _first(zs, e, s, share, held, table, low, high, reach, x, a, b)
    here = _misfit(zs, e, s, share, held, table, x, a, b)
    for g in range(zs.size):
        if share[g] == 0:
            zs[g], s[g] = 1.0, 1.0  # a residual of zero and no information, without a division by zero
    var_x, var_a = np.inf, np.inf
    for _ in range(60):
        j = int(x + 0.5)
        f = x - j
        for g in range(zs.size):
            for order in range(3):
                scaled[0, order, g] = table[j, order, g] * share[g]
        jxx, jxa, jxb, jaa, jab, jbb, gx, ga, gb, _in = _sums(zs, e, s, scaled, 0, f, 0, zs.size, a, b)
        for g in range(zs.size):
            if clipped[g] > 0:
                value = part[g] * (table[j, 0, g] + f * (table[j, 1, g] + f * table[j, 2, g]))
                slope = part[g] * a * (table[j, 1, g] + 2 * f * table[j, 2, g])
                mean = a * value + b * e_one[g] + s_one[g]
                score, w = reached(mean, clip[g])
                score, w = clipped[g] * score, clipped[g] * w
                gx, ga, gb = gx + slope * score, ga + value * score, gb + e_one[g] * score
                jxx, jxa, jxb = jxx + slope * slope * w, jxa + slope * value * w, jxb + slope * e_one[g] * w
                jaa, jab, jbb = jaa + value * value * w, jab + value * e_one[g] * w, jbb + e_one[g] * e_one[g] * w
        fixed = b <= floor and gb < 0
        dx, da, db, var_x, var_a = solve(jxx, jxa, jxb, jaa, jab, jbb, gx, ga, gb, fixed)
        if not var_x < np.inf:
            return x, a, b, var_x, var_a, False
        scale = min(1.0, reach / max(abs(dx), 1e-300))
        done = dx * dx <= SETTLED * var_x
        moved = False
        for _half in range(12):
            x2, a2, b2 = x + scale * dx, a + scale * da, max(b + scale * db, floor)
            if low <= x2 <= high and a2 > 0:
                there = _misfit(zs, e, s, share, held, table, x2, a2, b2)
                if there <= here + 1e-12 * abs(here):
                    x, a, b, here = x2, a2, b2, there
                    moved = True
                    break
            scale *= 0.5
        if done or not moved:
            return x, a, b, var_x, var_a, done
    return x, a, b, var_x, var_a, False
