"""Screening of settled echoes for a profile that is not R: `misfit` in single precision, on tiles of pixels.

`state_misfit` costs several times the fit of an even stack, and changes few pixels. Here V and χ² come from one more pass
over the window at the fitted (x, A, B), so that only pixels beyond `SCREEN` standard errors need `state_misfit`, whose
limit is higher: what the pass lacks (its rounding, the curvature at the nearest row) is far below the difference.
"""

from __future__ import annotations

import numpy as np

from ....optics.jit import kernel
from .misfit import LIMIT

__all__ = ["SCREEN", "screen"]

#: Standard errors beyond which a pixel goes to `state_misfit`, whose own limit is LIMIT.
SCREEN = LIMIT - 0.5
FAST = {"reassoc", "contract", "arcp"}


@kernel(fastmath=FAST, error_model="numpy")
def _sums(zs, c, mask, m0, table, bend, held, j, f, a, b, s, out):  # type: ignore[no-untyped-def]
    """out[:, c] = information and score of (x, A, B) and V of pixel c over its window, the first nine as in `even_fit._sums`;
    then, over the slices that `held` marks, Pearson's sum, its Σ 1/μ, the sum of z + s, and their number."""
    zero = np.float32(0)
    jxx, jxa, jxb, jaa, jab, jbb, gx, ga, gb = zero, zero, zero, zero, zero, zero, zero, zero, zero
    jvv, jvx, jva, jvb, gv, square, spread, light, number = zero, zero, zero, zero, zero, zero, zero, zero, zero
    level = b + s
    for k in range(zs.shape[1]):
        z, slope, v, m = zs[c, k], table[j, 1, k], bend[j, k], mask[m0 + k]
        value = table[j, 0, k] + f * slope
        mean = a * value + level
        w = m / mean
        r = z * w - m
        h = held[j, k] * m
        vw, dw, cw = value * w, slope * w, v * w
        jbb += w
        jab += vw
        jaa += value * vw
        jxb += dw
        jxa += value * dw
        jxx += slope * dw
        jvb += cw
        jva += value * cw
        jvx += slope * cw
        jvv += v * cw
        gb += r
        ga += value * r
        gx += slope * r
        gv += v * r
        square += h * mean * r * r
        spread += h * w
        light += h * z
        number += h
    out[0, c], out[1, c], out[2, c], out[3, c], out[4, c], out[5, c] = jxx, jxa, jxb, jaa, jab, jbb
    out[6, c], out[7, c], out[8, c] = gx, ga, gb
    out[9, c], out[10, c], out[11, c], out[12, c], out[13, c] = jvv, jvx, jva, jvb, gv
    out[14, c], out[15, c], out[16, c], out[17, c] = square, spread, light, number


@kernel(fastmath={"contract"}, error_model="numpy")
def _judge(sums, light, groups, outside, beyond, s, floor, b, suspect):  # type: ignore[no-untyped-def]
    """suspect[c]: V or χ² of pixel c is beyond SCREEN of its standard errors, or not told by its sums. light: Σ z of all
    `groups` slices; outside, beyond: sum and number of those that the window leaves out. Where R does not reach, all slices
    are one group of χ²."""
    for c in range(b.size):
        n, w = beyond[c], 1 / (b[c] + s)
        jxx, jxa, jxb, gx = float(sums[0, c]), float(sums[1, c]), float(sums[2, c]), float(sums[6, c])
        jaa, jab, ga = float(sums[3, c]), float(sums[4, c]), float(sums[7, c])
        jbb, gb = sums[5, c] + n * w, sums[8, c] + ((outside[c] + n * s) * w - n)
        jvv, jvx, jva, jvb = float(sums[9, c]), float(sums[10, c]), float(sums[11, c]), float(sums[12, c])
        gv, whole = float(sums[13, c]), float(sums[9, c])
        p = 0.0 if b[c] <= floor else 1 / jbb
        jaa, jxa, jva = jaa - jab * jab * p, jxa - jab * jxb * p, jva - jab * jvb * p
        jxx, jvx, jvv = jxx - jxb * jxb * p, jvx - jxb * jvb * p, jvv - jvb * jvb * p
        ga, gx, gv = ga - jab * gb * p, gx - jxb * gb * p, gv - jvb * gb * p
        p = 1 / jaa
        jxx, jvx, jvv = jxx - jxa * jxa * p, jvx - jxa * jva * p, jvv - jva * jva * p
        gx, gv = gx - jxa * ga * p, gv - jva * ga * p
        p = 1 / jxx
        jvv, gv = jvv - jvx * jvx * p, gv - jvx * gx * p
        # V is A·gv/(A²·jvv): more than SCREEN standard errors where gv > SCREEN·√jvv, whatever A.
        told = (jaa > 0) & (jxx > 0) & (jvv > 1e-6 * whole)
        fits = (gv <= SCREEN * np.sqrt(jvv)) | (not told)
        far = groups - sums[17, c]
        one = 1.0 if far > 0.5 else 0.0
        by_far = w / max(far, 1.0) * one
        more = light[c] + groups * s - sums[16, c] - far / w
        number = sums[17, c] + one
        even = sums[14, c] + more * more * by_far <= number - 3 + SCREEN * np.sqrt(2 * number + sums[15, c] + by_far)
        suspect[c] = not (fits & even)


@kernel(error_model="numpy")
def screen(  # type: ignore[no-untyped-def]
    zs, light, outside, beyond, groups, mask, m0, design, phases, xi, s, floor, k0, x, a, b, sums, settled, suspect
):
    """Mark in suspect (pixel) those of a tile that `state_misfit` must see. settled: pixels with a fit; the others are
    marked. design: `table`, `bend` and `held` of `EvenDesign`; sums: room for 18 numbers of each pixel."""
    table, bend, held = design
    shift, rows = np.float32(s), table.shape[0]
    for c in range(k0.size):
        if settled[c] != 0:
            place = (x[c] - k0[c] - xi) * phases
            j = int(place + 0.5)
            if place >= 0 and j < rows:
                f = np.float32(place - j)
                _sums(zs, c, mask, m0 + k0[c], table, bend, held, j, f, np.float32(a[c]), np.float32(b[c]), shift, sums)
            else:
                sums[14, c] = np.inf
    _judge(sums, light, groups, outside, beyond, s, floor, b, suspect)
    for c in range(k0.size):
        suspect[c] |= settled[c] == 0
