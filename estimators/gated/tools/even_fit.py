"""Kernels of `poisson-ml` for even delays: tiles of pixels, single precision, whole vectors, no branch per slice.

The start runs over the pixels of a tile (samples stored slice by slice), the Fisher steps over the slices of the window of a
pixel. Sums are in single precision: at 10⁶ photoelectrons their rounding moves τ by 10⁻⁴ of its standard error.
"""

from __future__ import annotations

import numpy as np

from ....optics.jit import kernel
from .even_screen import screen
from .poisson_fit import SETTLED

__all__ = ["fit_even"]

#: Pixels of a tile: with 64 slices they fill half of the first-level cache.
TILE = 64
FAST = {"reassoc", "contract", "arcp"}
MOST = 10


@kernel(fastmath={"contract"}, error_model="numpy")
def _load(counts, slices, p0, n, offset, scale, saturation, z, light, bad):  # type: ignore[no-untyped-def]
    light[:] = 0.0
    bad[:] = 0
    offset, scale = np.float32(offset), np.float32(scale)
    for g in range(slices.size):
        row, out = counts[slices[g], p0 : p0 + n], z[g]
        for p in range(n):
            v = np.float32(row[p])
            bad[p] |= not v < saturation
            v = (v - offset) * scale
            out[p] = v
            light[p] += v


@kernel(fastmath={"contract"}, error_model="numpy")
def _start(z, light, template, span, mean, norm, scores, top, best):  # type: ignore[no-untyped-def]
    """score_j = Σ z·(v − mean)/|v − mean| of all candidates and pixels, and the greatest one."""
    top[:] = 0.0
    best[:] = -1
    for j in range(mean.size):
        s, m, q = scores[j], mean[j], norm[j]
        for p in range(TILE):
            s[p] = -m * light[p]
        g, last = span[j, 0], span[j, 1]
        while g + 3 < last:
            v0, v1, v2, v3 = template[j, g], template[j, g + 1], template[j, g + 2], template[j, g + 3]
            z0, z1, z2, z3 = z[g], z[g + 1], z[g + 2], z[g + 3]
            for p in range(TILE):
                s[p] += v0 * z0[p] + v1 * z1[p] + (v2 * z2[p] + v3 * z3[p])
            g += 4
        while g < last:
            v0, z0 = template[j, g], z[g]
            for p in range(TILE):
                s[p] += v0 * z0[p]
            g += 1
        here = np.int32(j)
        for p in range(TILE):
            value = s[p] * q
            s[p] = value
            more = value > top[p]
            top[p] = value if more else top[p]
            best[p] = here if more else best[p]


@kernel(fastmath=FAST, error_model="numpy")
def _sums(zs, c, mask, m0, table, j, f, a, b, s, out):  # type: ignore[no-untyped-def]
    """out[:, c] = score and information of (x in rows, A, B) of pixel c over its window: r = (z+s)/V − 1,
    V = A·R + B + s; mask: 0 or 1."""
    zero = np.float32(0)
    jxx, jxa, jxb, jaa, jab, jbb, gx, ga, gb = zero, zero, zero, zero, zero, zero, zero, zero, zero
    level = b + s
    for k in range(zs.shape[1]):
        slope, m = table[j, 1, k], mask[m0 + k]
        value = table[j, 0, k] + f * slope
        w = m / (a * value + level)
        r = zs[c, k] * w - m
        vw, dw = value * w, slope * w
        jbb += w
        jab += vw
        jaa += value * vw
        jxb += dw
        jxa += value * dw
        jxx += slope * dw
        gb += r
        ga += value * r
        gx += slope * r
    out[0, c], out[1, c], out[2, c], out[3, c], out[4, c], out[5, c] = jxx, jxa, jxb, jaa, jab, jbb
    out[6, c], out[7, c], out[8, c] = gx, ga, gb


@kernel(fastmath={"contract"}, error_model="numpy")
def _step(sums, outside, number, s, floor, phases, reach, x, a, b, before, var_x, var_a, active, done):  # type: ignore[no-untyped-def]
    """One Fisher step of all pixels of a tile, without a branch: `solve` of `poisson_fit` on whole vectors."""
    for c in range(TILE):
        ap, n = a[c] * phases, number[c]
        w = 1 / (b[c] + s)
        jxx, jxa, jxb, gx = ap * ap * sums[0, c], ap * sums[1, c], ap * sums[2, c], ap * sums[6, c]
        jaa, jab, ga = float(sums[3, c]), float(sums[4, c]), float(sums[7, c])
        jbb = sums[5, c] + n * w
        gb = sums[8, c] + ((outside[c] + n * s) * w - n if n > 0 else 0.0)
        by_b = 1 / jbb
        e = jab * by_b
        a2, b2, d2 = jxx - jxb * by_b * jxb, jxa - jxb * by_b * jab, jaa - e * jab
        by_d = 1 / d2
        a3 = a2 - b2 * b2 * by_d
        vx = 1 / a3
        va = a2 * by_d * vx
        hx, ha = gx - jxb * by_b * gb, ga - e * gb
        dx = (hx - b2 * by_d * ha) * vx
        da = (ha - b2 * dx) * by_d
        new = b[c] + (gb - jxb * dx - jab * da) * by_b
        # Where the bound holds, the other two move without the background.
        by_a = 1 / jaa
        dx_held = (gx - jxa * by_a * ga) / (jxx - jxa * jxa * by_a)
        da_held = (ga - jxa * dx_held) * by_a
        held = new <= floor
        new = floor if held else new
        dx = dx_held if held else dx
        da = da_held if held else da
        good = (d2 > 0) & (a3 > 0)
        square = dx * dx
        # The error left after a step is its product with the rate at which the steps shrink.
        rate = min(1.0, square / before[c])
        settled = (square <= SETTLED * vx) | ((square * rate <= 0.1 * SETTLED * vx) & (square < 0.25 * vx))
        stop = good & settled & (abs(da) < 0.1 * a[c])
        moved = a[c] + da if da > -0.7 * a[c] else 0.3 * a[c]
        run = active[c] != 0
        go = run & good
        x[c] = x[c] + min(max(dx, -reach), reach) if go else x[c]
        a[c] = moved if go else a[c]
        b[c] = new if go else b[c]
        before[c] = square if go else before[c]
        var_x[c] = vx if go else var_x[c]
        var_a[c] = va if go else var_a[c]
        done[c] = 1 if (run & stop) else done[c]
        active[c] = 1 if (go & (not stop)) else 0


@kernel(fastmath=FAST, error_model="numpy")
def _windows(z, light, k0, shift, zs, outside, beyond):  # type: ignore[no-untyped-def]
    """zs (pixel, slice of the window) = z + shift from slice k0 of each pixel on, 0 beyond the stack.

    outside: Σ z of the slices that the window leaves out; beyond: their number."""
    groups, window = z.shape[0], zs.shape[1]
    for c in range(k0.size):
        first, last = max(0, -k0[c]), min(window, groups - k0[c])
        if first > 0 or last < window:
            for k in range(window):
                zs[c, k] = 0
        for k in range(first, last):
            zs[c, k] = z[k0[c] + k, c] + shift
    for c in range(k0.size):
        total = np.float32(0)
        for k in range(window):
            total += zs[c, k]
        first, last = max(0, -k0[c]), min(window, groups - k0[c])
        outside[c] = light[c] - (total - (last - first) * shift)
        beyond[c] = groups - (last - first)


@kernel(error_model="numpy")
def _guess(scores, top, best, light, groups, grid, mean, norm, span, low, high, floor, x, a, b, k0):  # type: ignore[no-untyped-def]
    """The start (x, A, B) of every pixel of a tile, and the first slice of its window; A = 0 without a start."""
    stride = grid[1] - grid[0] if grid.size > 1 else 0.0
    half, pad = span
    for c in range(k0.size):
        j = best[c]
        a[c], k0[c] = 0.0, 0
        if j >= 0:
            place = grid[j]
            if 0 < j < grid.size - 1:
                before, after = scores[j - 1, c], scores[j + 1, c]
                bend = 2 * top[c] - before - after
                if bend > 0:
                    place += 0.5 * (after - before) / bend * stride
            x[c] = min(max(place, low), high)
            a[c] = top[c] * norm[j]
            b[c] = max(light[c] / groups - a[c] * mean[j], floor)
            # The middle row of the table at the start: as much room on either side.
            k0[c] = max(int(np.floor(x[c] - half)), -pad)


@kernel(error_model="numpy")
def _fit(zs, mask, m0, table, phases, xi, outside, beyond, s, floor, low, high, width, k0, state, sums, active, done):  # type: ignore[no-untyped-def]
    """Fisher scoring of all pixels of a tile at a time, each until it settles. See `fit_fast`."""
    x, a, b, before, var_x, var_a = state
    shift, rows = np.float32(s), table.shape[0]
    before[:] = np.inf
    done[:] = 0
    for _ in range(MOST):
        left = 0
        for c in range(TILE):
            if active[c] != 0:
                place = (x[c] - k0[c] - xi) * phases
                j = int(place + 0.5)
                if not (low <= x[c] <= high and a[c] > 0 and place >= 0 and j < rows):
                    active[c] = 0
                    continue
                left += 1
                f = np.float32(place - j)
                _sums(zs, c, mask, m0 + k0[c], table, j, f, np.float32(a[c]), np.float32(b[c]), shift, sums)
        if left == 0:
            return
        _step(sums, outside, beyond, s, floor, phases, 0.7 * width, x, a, b, before, var_x, var_a, active, done)


@kernel(error_model="numpy")
def fit_even(  # type: ignore[no-untyped-def]
    counts, slices, levels, s, floor, tables, phases, xi, mask, pad, bounds, width, grid, template, span, mean, norm,
    snr, units, tau, sigma, ok, again, suspect,
):  # fmt: skip
    """Fit all pixels of counts (slice, pixel): tau = units[0] + units[1]·x, sigma = units[1]·σ_x, x in steps from slice 0;
    NaN where not ok. `again` marks pixels that have a clipped sample or did not settle: they are left to the careful path.
    `suspect` marks those whose profile may not be R (`even_screen`), and all that are left. tables: `table`, `bend` and
    `held` of the design. See `poisson_ml` for the other arguments."""
    offset, scale, saturation = levels
    table = tables[0]
    low, high = bounds
    groups, window = slices.size, table.shape[2]
    z = np.zeros((groups, TILE), np.float32)
    light, top = np.zeros(TILE, np.float32), np.zeros(TILE, np.float32)
    best, bad = np.zeros(TILE, np.int32), np.zeros(TILE, np.uint8)
    scores = np.zeros((grid.size, TILE), np.float32)
    zs = np.zeros((TILE, window), np.float32)
    x, a, b, outside, beyond = np.zeros(TILE), np.zeros(TILE), np.zeros(TILE), np.zeros(TILE), np.zeros(TILE)
    var_x, var_a, before = np.zeros(TILE), np.zeros(TILE), np.zeros(TILE)
    k0 = np.zeros(TILE, np.int64)
    sums = np.ones((18, TILE), np.float32)
    active, done, doubtful = np.zeros(TILE, np.uint8), np.zeros(TILE, np.uint8), np.zeros(TILE, np.bool_)
    shift = np.float32(s)
    span_x = (xi + 0.5 * (table.shape[0] - 1) / phases - 0.5, pad)
    pixels = counts.shape[1]
    for p0 in range(0, pixels, TILE):
        number = min(TILE, pixels - p0)
        _load(counts, slices, p0, number, offset, scale, saturation, z, light, bad)
        _start(z, light, template, span, mean, norm, scores, top, best)
        _guess(scores, top, best, light, groups, grid, mean, norm, span_x, low, high, floor, x, a, b, k0)
        _windows(z, light, k0, shift, zs, outside, beyond)
        for c in range(TILE):
            active[c] = 1 if c < number and bad[c] == 0 and a[c] > 0 else 0
        _fit(
            zs, mask, pad, table, phases, xi, outside, beyond, s, floor, low, high, width, k0,
            (x, a, b, before, var_x, var_a), sums, active, done,
        )  # fmt: skip
        screen(
            zs,
            light,
            outside,
            beyond,
            groups,
            mask,
            pad,
            tables,
            phases,
            xi,
            s,
            floor,
            k0,
            x,
            a,
            b,
            sums,
            done,
            doubtful,
        )
        for c in range(number):
            p = p0 + c
            again[p] = (done[c] == 0) & ((bad[c] != 0) | (best[c] >= 0))
            good = (done[c] != 0) & (a[c] > snr * np.sqrt(var_a[c])) & (var_x[c] < width * width)
            good = good & (low < x[c]) & (x[c] < high)
            tau[p] = units[0] + units[1] * x[c] if good else np.nan
            sigma[p] = units[1] * np.sqrt(var_x[c]) if good else np.nan
            ok[p], suspect[p] = good, doubtful[c]
