"""Streaming moments of a stack over delay, in integers where the delays are even: the kernels of `weighted-average`.

For even delays the moments Σ y, Σ k·y, Σ k²·y need no multiplication: running sums of running sums, from the last slice
to the first, give them exactly in 32 bits for 64 slices at a time. The counts are read once and never copied, in blocks of
pixels whose accumulators stay in the first cache levels; range and sigma are finished block by block.
"""

from __future__ import annotations

import numpy as np

from ....optics.copying import copy_into
from ....optics.jit import kernel
from .stack import Stack

__all__ = ["average_even", "average_general", "even_order"]

#: Pixels per block: long runs of each slice for the prefetcher, accumulators in the second cache level.
BLOCK = 32768
#: Slices per integer segment: 65535·Σ(k+1)(k+2)/2 over 64 slices is 3.0e9 < 2³².
SEGMENT = 64
_orders: dict[tuple[object, ...], tuple[int, int] | None] = {}


@kernel(error_model="numpy", inline="always")
def _next(y, a, b, c):  # type: ignore[no-untyped-def]
    """One sample onto the running sums: a = Σ y, b = Σ a, c = Σ b."""
    a += np.uint32(y)
    b += a
    c += b
    return a, b, c


@kernel(error_model="numpy")
def _add_many(y15, y14, y13, y12, y11, y10, y9, y8, y7, y6, y5, y4, y3, y2, y1, y0, s0, s1, s2):  # type: ignore[no-untyped-def]
    # Sixteen slices per turn, written out: with a loop over them the compiler would not use vector units over the pixels. With
    # fewer the sums pass through the cache more often (8: 10 % slower), with more they leave the registers (32: half as fast).
    for p in range(s0.size):
        a, b, c = s0[p], s1[p], s2[p]
        a, b, c = _next(y15[p], a, b, c)
        a, b, c = _next(y14[p], a, b, c)
        a, b, c = _next(y13[p], a, b, c)
        a, b, c = _next(y12[p], a, b, c)
        a, b, c = _next(y11[p], a, b, c)
        a, b, c = _next(y10[p], a, b, c)
        a, b, c = _next(y9[p], a, b, c)
        a, b, c = _next(y8[p], a, b, c)
        a, b, c = _next(y7[p], a, b, c)
        a, b, c = _next(y6[p], a, b, c)
        a, b, c = _next(y5[p], a, b, c)
        a, b, c = _next(y4[p], a, b, c)
        a, b, c = _next(y3[p], a, b, c)
        a, b, c = _next(y2[p], a, b, c)
        a, b, c = _next(y1[p], a, b, c)
        a, b, c = _next(y0[p], a, b, c)
        s0[p], s1[p], s2[p] = a, b, c


@kernel(error_model="numpy")
def _add_one(y, s0, s1, s2):  # type: ignore[no-untyped-def]
    for p in range(s0.size):
        s0[p] += np.uint32(y[p])
        s1[p] += s0[p]
        s2[p] += s1[p]


@kernel(error_model="numpy")
def _add(counts, k0, k1, p0, p1, s0, s1, s2):  # type: ignore[no-untyped-def]
    """s0 = Σ y, s1 = Σ (m+1) y, s2 = Σ (m+1)(m+2)/2 y over slices k0…k1−1, m counted from k0."""
    s0[:] = 0
    s1[:] = 0
    s2[:] = 0
    k = k1 - 1
    while k - 15 >= k0:
        _add_many(
            counts[k, p0:p1], counts[k - 1, p0:p1], counts[k - 2, p0:p1], counts[k - 3, p0:p1],
            counts[k - 4, p0:p1], counts[k - 5, p0:p1], counts[k - 6, p0:p1], counts[k - 7, p0:p1],
            counts[k - 8, p0:p1], counts[k - 9, p0:p1], counts[k - 10, p0:p1], counts[k - 11, p0:p1],
            counts[k - 12, p0:p1], counts[k - 13, p0:p1], counts[k - 14, p0:p1], counts[k - 15, p0:p1],
            s0, s1, s2,
        )  # fmt: skip
        k -= 16
    while k >= k0:
        _add_one(counts[k, p0:p1], s0, s1, s2)
        k -= 1


@kernel(error_model="numpy")
def _answer(m0, m1, d0, d1, d2, high, back, sums, floors, noise, scale):  # type: ignore[no-untyped-def]
    """Value a + b·t and sigma b·√Var t of t = Σx(y−B)/Σ(y−B), with Var t = Σ (x−t)²·Var y + share·(Σ(x−t))²·Var B.

    m0, m1: Σ y, Σ x·y of counts with the offset; d0, d1, d2: Σ v·(1, x, x²)·(y − offset), floors: Σ v·(1, x, x²), with v
    the factor by which the weight of a slice changes its variance. The light must exceed 3 σ of the sum as it was averaged.
    """
    n, t1, _t2 = sums
    e0, e1, e2 = floors
    offset, gain, excess, floor, share, limit = noise
    origin, unit, last, spread = scale
    net = m0 - n * back
    inverse = 1 / net
    t = (m1 - t1 * back) * inverse
    lever = t1 - n * t
    variance = excess * gain * (d2 - t * (2 * d1 - t * d0)) + floor * (e2 - t * (2 * e1 - e0 * t))
    variance += share * lever * lever * (excess * gain * max(back - offset, 0.0) + floor)
    quiet = spread * spread * (excess * gain * max(d0, 0.0) + floor * e0)
    good = (net > 0) & (gain * gain * net * net > 9 * quiet) & (variance > 0)
    good = good & (t >= 0) & (t <= last) & (origin + unit * t > 0) & (high < limit)
    value = origin + unit * t if good else np.nan
    # A standard error needs no more than single precision, whose root is four times as fast.
    sigma = np.float32(unit * spread / gain * inverse) * np.sqrt(np.float32(variance)) if good else np.float32(np.nan)
    return value, sigma, good


@kernel(error_model="numpy")
def _finish(m0, m1, m2, high, level, sums, noise, scale, value, sigma, valid):  # type: ignore[no-untyped-def]
    n, t1, t2 = sums
    offset = noise[0]
    for i in range(m0.size):
        d0, d1, d2 = m0[i] - n * offset, m1[i] - t1 * offset, m2[i] - t2 * offset
        value[i], sigma[i], valid[i] = _answer(m0[i], m1[i], d0, d1, d2, high[i], level[i], sums, sums, noise, scale)


@kernel(error_model="numpy")
def _finish_whole(s0, s1, s2, high, level, sums, noise, scale, value, sigma, valid):  # type: ignore[no-untyped-def]
    """`_finish` from the running sums of one segment, without storing the moments; level: one for all pixels."""
    n, t1, t2 = sums
    offset = noise[0]
    for i in range(s0.size):
        z0 = float(s0[i])
        z1 = float(s1[i]) - z0
        z2 = 2 * float(s2[i]) - float(s1[i]) - 2 * z1 - z0
        d0, d1, d2 = z0 - n * offset, z1 - t1 * offset, z2 - t2 * offset
        value[i], sigma[i], valid[i] = _answer(z0, z1, d0, d1, d2, high[i], level, sums, sums, noise, scale)


@kernel(error_model="numpy")
def _greatest(counts, begin, end, p0, p1, high):  # type: ignore[no-untyped-def]
    for k in range(begin, end):
        y = counts[k, p0:p1]
        for p in range(high.size):
            high[p] = max(high[p], y[p])


@kernel(error_model="numpy")
def average_even(counts, begin, end, level, least, sums, noise, scale, value, sigma, valid):  # type: ignore[no-untyped-def]
    """Weighted average of counts (slice, pixel), uint16, slices begin…end−1 at positions x = 0, 1, …

    level: background [DN] per pixel, or one element for all; with `least` the smallest count of the pixel is used instead.
    sums: n, Σx, Σx²; noise: offset, 1/gain, F², floor variance, share of the background's variance, clip level;
    scale: origin and unit of the value, greatest x, factor of sigma. Fills value, sigma (float32; NaN where invalid), valid.
    """
    pixels = counts.shape[1]
    s0, s1, s2 = np.empty(BLOCK, np.uint32), np.empty(BLOCK, np.uint32), np.empty(BLOCK, np.uint32)
    high, low = np.empty(BLOCK, np.uint16), np.empty(BLOCK, np.uint16)
    m0, m1, m2, back = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    limit = noise[5]
    for p0 in range(0, pixels, BLOCK):
        p1 = min(p0 + BLOCK, pixels)
        n = p1 - p0
        a, b, c, h = s0[:n], s1[:n], s2[:n], high[:n]
        h[:] = 0
        if end - begin <= SEGMENT and level.size == 1 and not least:
            _add(counts, begin, end, p0, p1, a, b, c)
            # No sample can be clipped where their sum is below the level.
            if a.max() >= limit:
                _greatest(counts, begin, end, p0, p1, h)
            _finish_whole(a, b, c, h, level[0], sums, noise, scale, value[p0:p1], sigma[p0:p1], valid[p0:p1])
            continue
        m0[:n] = 0.0
        m1[:n] = 0.0
        m2[:n] = 0.0
        for k0 in range(begin, end, SEGMENT):
            _add(counts, k0, min(k0 + SEGMENT, end), p0, p1, a, b, c)
            shift = float(k0 - begin)
            for p in range(n):
                z0 = float(a[p])
                z1 = float(b[p]) - z0
                z2 = 2 * float(c[p]) - float(b[p]) - 2 * z1 - z0
                m0[p] += z0
                m1[p] += z1 + shift * z0
                m2[p] += z2 + shift * (2 * z1 + shift * z0)
        if m0[:n].max() >= limit:
            _greatest(counts, begin, end, p0, p1, h)
        if least:
            w = low[:n]
            w[:] = 65535
            for k in range(begin, end):
                y = counts[k, p0:p1]
                for p in range(n):
                    w[p] = min(w[p], y[p])
            copy_into(back, w)
        elif level.size == 1:
            back[:n] = level[0]
        else:
            copy_into(back, level[p0:p1])
        _finish(m0[:n], m1[:n], m2[:n], h, back[:n], sums, noise, scale, value[p0:p1], sigma[p0:p1], valid[p0:p1])


@kernel(error_model="numpy")
def average_general(counts, slices, plan, level, least, sums, floors, noise, scale, value, sigma, valid):  # type: ignore[no-untyped-def]
    """As `average_even`, for any memory layout of counts (slice, row, col) and any slices.

    plan: for each used slice its position x; its weight w, 1/Σ pulses of all slices of its delay, which makes their sum a
    count of nominal exposure; and the inverse of its own exposure. Shot noise and read noise grow with w² per slice, not
    with w: sums are Σ 1, Σ x, Σ x² over delays, floors those of w² over slices. The level is that of nominal exposure.
    """
    rows, cols = counts.shape[1], counts.shape[2]
    position, weight, apart = plan
    offset = noise[0]
    shifted = (0.0, noise[1], noise[2], noise[3], noise[4], noise[5])
    a, b = np.empty(cols), np.empty(cols)
    d, e, q = np.empty(cols), np.empty(cols), np.empty(cols)
    high, low, back = np.empty(cols), np.empty(cols), np.empty(cols)
    for row in range(rows):
        a[:] = 0.0
        b[:] = 0.0
        d[:] = 0.0
        e[:] = 0.0
        q[:] = 0.0
        high[:] = -np.inf
        low[:] = np.inf
        for i in range(slices.size):
            k, x, f, own = slices[i], position[i], weight[i], apart[i]
            fx, ff, ffx, ffxx = f * x, f * f, f * f * x, f * f * x * x
            for p in range(cols):
                raw = float(counts[k, row, p])
                y = raw - offset
                a[p] += f * y
                b[p] += fx * y
                d[p] += ff * y
                e[p] += ffx * y
                q[p] += ffxx * y
                # NaN must reach the test of `_answer`, which max does not grant in every order of its arguments.
                high[p] = raw if not raw <= high[p] else high[p]
                low[p] = min(low[p], y * own)
        if least:
            copy_into(back, low)
        elif level.size == 1:
            back[:] = level[0] - offset
        else:
            for p in range(cols):
                back[p] = level[row * cols + p] - offset
        for p in range(cols):
            at = row * cols + p
            value[at], sigma[at], valid[at] = _answer(
                a[p], b[p], d[p], e[p], q[p], high[p], back[p], sums, floors, shifted, scale
            )


def even_order(stack: Stack) -> tuple[int, int] | None:
    """(first, last + 1) of the signal slices where the integer kernel applies: uint16, C order, consecutive slices of
    rising, even delay, one gate, equal pulses; else None."""
    if stack.counts.dtype != np.uint16 or not stack.counts.flags.c_contiguous:
        return None
    if stack.key not in _orders:
        if len(_orders) > 8:
            _orders.clear()
        _orders[stack.key] = _order(stack)
    return _orders[stack.key]


def _order(stack: Stack) -> tuple[int, int] | None:
    n = stack.signal
    used = stack.group < n
    signal, group = stack.slices[used], stack.group[used]
    if signal.size != n or n < 2:
        return None
    order = np.empty(n, dtype=np.int64)
    order[group] = signal
    if (np.diff(order) != 1).any() or (stack.gate[:n] != stack.gate[0]).any() or (stack.exposure[:n] != 1).any():
        return None
    even = np.linspace(stack.delay_s[0], stack.delay_s[n - 1], n)
    if not np.abs(stack.delay_s[:n] - even).max() <= 1e-6 * stack.spacing_s():
        return None
    return int(order[0]), int(order[0]) + n
