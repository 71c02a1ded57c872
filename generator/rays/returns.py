"""Returns: the few echoes that stand for all light of a pixel, and the stack they give.

Sub-samples of a pixel whose times lie close together are merged into one return with three moments (photoelectrons,
mean time, standard deviation). A return is rendered as two halves at tau ± spread: Gauss's two-point rule, exact to the
third moment, so a tilted surface inside a pixel costs two look-ups instead of many.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...optics.correlation.response import Table, hermite_value, lookup
from ...optics.jit import kernel, prange

__all__ = ["Returns", "depth_of_pixels", "gather_returns", "render_stack"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]


@dataclass(frozen=True)
class Returns:
    """Pixel i owns returns `start[i]` … `start[i+1] − 1`: photoelectrons, mean time and its spread (1 σ), s."""

    start: Int
    amplitude: Float
    tau: Float
    spread: Float


def gather_returns(
    pixels: int,
    pixel: Int,
    amplitude: Float,
    tau: Float,
    spread: Float,
    width_s: float,
    alone: tuple[NDArray[np.bool_], Float, Float, Float] | None = None,
) -> tuple[Returns, Float, Float]:
    """Merge samples into returns.

    Main arguments:
        pixels: number of pixels; `pixel` (n): owner of each sample; samples of zero amplitude are dropped.
        width_s: samples of a pixel within this time of the first of a group become one return.
    Other arguments:
        alone: (mask, amplitude, tau, spread) over all pixels: those that one sample stands for, in place of samples.

    Returns the returns and, per pixel, the first and last time that carries light (NaN where there is none).
    """
    order, start = _order(pixels, pixel, amplitude, tau)
    if alone is None:
        alone = (np.zeros(pixels, dtype=np.bool_), np.zeros(0), np.zeros(0), np.zeros(0))
    out = _merge(pixels, start, order, amplitude, tau, spread, width_s, *alone)
    return Returns(*out[:4]), out[4], out[5]


def depth_of_pixels(returns: Returns) -> float:
    """Standard deviation [s] of the times of a pixel's light, rms over pixels (weights: photoelectrons)."""
    total = float(returns.amplitude.sum())
    if total <= 0.0:
        return 0.0
    owner = np.repeat(np.arange(len(returns.start) - 1), np.diff(returns.start))
    a = returns.amplitude
    light = np.maximum(np.bincount(owner, a, len(returns.start) - 1), 1e-300)
    mean = np.bincount(owner, a * returns.tau, len(light)) / light
    return float(np.sqrt(a @ (returns.spread**2 + (returns.tau - mean[owner]) ** 2) / total))


@kernel
def _order(pixels, pixel, amplitude, tau):  # type: ignore[no-untyped-def]
    """Indices of the samples that carry light, by pixel (counting sort) and then by time; and where each pixel begins."""
    start = np.zeros(pixels + 1, dtype=np.int64)
    for i in range(pixel.size):
        if amplitude[i] > 0.0:
            start[pixel[i] + 1] += 1
    for p in range(pixels):
        start[p + 1] += start[p]
    order = np.empty(start[pixels], dtype=np.int64)
    fill = start[:-1].copy()
    for i in range(pixel.size):
        if amplitude[i] > 0.0:
            order[fill[pixel[i]]] = i
            fill[pixel[i]] += 1
    for p in range(pixels):
        begin, end = start[p], start[p + 1]
        # Shell's sort with ties by index: few samples go in one pass of insertions, and any order of work gives the same order.
        gap = 1
        while end - begin > 16 * gap:
            gap = 3 * gap + 1
        while gap > 0:
            for a in range(begin + gap, end):
                index = order[a]
                b = a
                while b >= begin + gap and (
                    tau[order[b - gap]] > tau[index] or (tau[order[b - gap]] == tau[index] and order[b - gap] > index)
                ):
                    order[b] = order[b - gap]
                    b -= gap
                order[b] = index
            gap //= 3
    return order, start


@kernel
def _merge(pixels, begin, order, amplitude, tau, spread, width, alone, one_a, one_t, one_s):  # type: ignore[no-untyped-def]
    n = order.size + one_a.size
    start = np.zeros(pixels + 1, dtype=np.int64)
    out_a = np.empty(n)
    out_t = np.empty(n)
    out_s = np.empty(n)
    first = np.full(pixels, np.nan)
    last = np.full(pixels, np.nan)
    made = 0
    half_width = 1.7320508075688772  # a uniform spread reaches √3 σ to either side
    for p in range(pixels):
        start[p] = made
        if alone[p]:
            if one_a[p] > 0.0:
                out_a[made], out_t[made], out_s[made] = one_a[p], one_t[p], one_s[p]
                first[p] = one_t[p] - half_width * one_s[p]
                last[p] = one_t[p] + half_width * one_s[p]
                made += 1
            continue
        i = begin[p]
        while i < begin[p + 1]:
            origin = tau[order[i]]
            a0 = 0.0
            a1 = 0.0
            a2 = 0.0
            while i < begin[p + 1] and tau[order[i]] - origin <= width:
                j = order[i]
                x = tau[j] - origin
                a0 += amplitude[j]
                a1 += amplitude[j] * x
                a2 += amplitude[j] * (x * x + spread[j] * spread[j])
                reach = half_width * spread[j]
                if not first[p] <= tau[j] - reach:
                    first[p] = tau[j] - reach
                if not last[p] >= tau[j] + reach:
                    last[p] = tau[j] + reach
                i += 1
            mean = a1 / a0
            out_a[made] = a0
            out_t[made] = origin + mean
            out_s[made] = np.sqrt(max(a2 / a0 - mean * mean, 0.0))
            made += 1
    start[pixels] = made
    return start, out_a[:made], out_t[:made], out_s[:made], first, last


#: Cells of the fine table per cell of the given one: linear interpolation then errs by about 2e-6 of R's peak.
_FINE = 32
#: A spread below this fraction of R's width changes R by about 1e-5: one look-up is enough.
_THIN = 2e-3
#: Longest span of slices that share an origin of single-precision times, in widths of R.
_PIECE = 512.0


def render_stack(
    returns: Returns, table: Table, delays_s: Float, scale: Float, offset_s: Float | None, out: NDArray[np.float32]
) -> None:
    """Write S_k = scale_k Σ_j a_j [R(τ_j + s_j − t_k − o) + R(τ_j − s_j − t_k − o)]/2 into `out` (slices, pixels).

    `offset_s` (pixels): the gate opens later by this much in a pixel. Pixels are shared out over the threads; each is
    computed alone, so the bits do not depend on their number. Most pixels have one return: they go through one loop
    without branches, which runs on the processor's vector units.
    """
    fine, low, step, width = _fine_table(table)
    count = np.diff(returns.start)
    single = count == 1
    shift = np.asarray(delays_s, dtype=np.float64) + low
    gain = np.asarray(scale, dtype=np.float32)
    offset = np.zeros(len(count)) if offset_s is None else np.ascontiguousarray(offset_s, dtype=np.float64).ravel()
    # Single precision holds a time to 6e-8 of the span it is counted from: long records go in pieces.
    piece = np.floor((shift - shift.min(initial=np.inf)) / (_PIECE * width)) if len(shift) else shift
    for number in np.unique(piece):
        own = np.flatnonzero(piece == number)
        whole = own.size == len(shift)
        part = out if whole else np.empty((own.size, len(count)), dtype=np.float32)
        _render_singles(returns, single, shift[own], step, width, gain[own], offset, fine, part)
        if not whole:
            out[own] = part
    several = np.flatnonzero(count > 1)
    if len(several):
        _several_returns(
            several, returns.start, returns.amplitude, returns.tau, returns.spread, table.start_s, 1.0 / table.step_s,
            table.value, table.slope, np.ascontiguousarray(delays_s, dtype=np.float64),
            np.ascontiguousarray(scale, dtype=np.float64), offset, out,
        )  # fmt: skip


def _render_singles(
    returns: Returns, single: NDArray[np.bool_], shift: Float, step: float, width: float, gain: NDArray[np.float32],
    offset: Float, fine: NDArray[np.float32], out: NDArray[np.float32],
) -> None:  # fmt: skip
    """Pixels with one return, of slices whose table starts at the times `shift`; zero in the others."""
    inverse = 1.0 / step
    origin = float(shift.min())
    if len(returns.tau):
        first = np.minimum(returns.start[:-1], len(returns.tau) - 1)
        position = np.where(single, _cells(returns.tau[first] - origin - offset, inverse), np.float32(0.0))
        amplitude = np.where(single, returns.amplitude[first], 0.0).astype(np.float32)
        spread = np.where(single, returns.spread[first], 0.0)
        spread = np.where(spread > _THIN * width, _cells(spread, inverse), np.float32(0.0))
    else:
        position = amplitude = spread = np.zeros(len(single), dtype=np.float32)
    _single_returns(position, amplitude, spread, _cells(shift - origin, inverse), gain, fine, out)


def _cells(time_s: Float, inverse: float) -> NDArray[np.float32]:
    """Times in cells of the fine table; those beyond single precision become infinite, and show nothing."""
    return (time_s * inverse).astype(np.float32)


def _fine_table(table: Table) -> tuple[NDArray[np.float32], float, float, float]:
    """R for linear interpolation: values, start [s], step [s], and R's width [s]. The far tails, under 1e-7 of the peak,
    are cut off: a Gaussian's are twice as wide as their use. Both ends are zero."""
    bright = np.flatnonzero(table.value > 1e-7 * table.value.max())
    first, last = max(bright[0] - 1, 0), min(bright[-1] + 1, len(table.value) - 1)
    cells = int(last - first)
    fine = max(1, min(_FINE, (1 << 16) // cells))
    step = table.step_s / fine
    low = table.start_s + table.step_s * first
    value = lookup(table, low + step * np.arange(cells * fine + 1))
    value[0] = value[-1] = 0.0
    above = np.flatnonzero(table.value >= table.value.max() / 2)
    return value.astype(np.float32), float(low), float(step), float(table.step_s * (above[-1] - above[0] + 1))


@kernel(parallel=True)
def _single_returns(position, amplitude, spread, shift, gain, fine, out):  # type: ignore[no-untyped-def]
    pixels = position.size
    block = 256  # short enough that few blocks need the second look-up, and that many see nothing of a slice
    last = np.float32(fine.size - 1)
    top = np.int32(fine.size - 2)
    zero = np.float32(0.0)
    half = np.float32(0.5)
    # max(zero, x), not max(x, zero): the first stands where x is no number (∞ − ∞), which must not become an index.
    for b in prange((pixels + block - 1) // block):
        begin = b * block
        end = min(begin + block, pixels)
        widest = zero
        early = np.float32(np.inf)
        late = np.float32(-np.inf)
        for p in range(begin, end):
            if amplitude[p] > zero:
                widest = max(widest, spread[p])
                early = min(early, position[p])
                late = max(late, position[p])
        for k in range(shift.size):
            x0 = shift[k]
            g = gain[k]
            row = out[k]
            if late - x0 + widest <= zero or early - x0 - widest >= last:
                for p in range(begin, end):
                    row[p] = zero
            elif widest == zero:
                for p in range(begin, end):
                    x = min(max(zero, position[p] - x0), last)
                    i = min(np.int32(x), top)
                    low = fine[i]
                    row[p] = g * amplitude[p] * (low + (x - np.float32(i)) * (fine[i + 1] - low))
            else:
                for p in range(begin, end):
                    x = min(max(zero, position[p] - x0 - spread[p]), last)
                    y = min(max(zero, position[p] - x0 + spread[p]), last)
                    i = min(np.int32(x), top)
                    j = min(np.int32(y), top)
                    low = fine[i]
                    high = fine[j]
                    low += (x - np.float32(i)) * (fine[i + 1] - low)
                    high += (y - np.float32(j)) * (fine[j + 1] - high)
                    row[p] = g * amplitude[p] * half * (low + high)


@kernel(parallel=True)
def _several_returns(which, start, amplitude, tau, spread, t0, inv_step, value, slope, delays, scale, offset, out):  # type: ignore[no-untyped-def]
    for n in prange(which.size):
        p = which[n]
        late = offset[p]
        for k in range(delays.size):
            total = 0.0
            for j in range(start[p], start[p + 1]):
                u = tau[j] - delays[k] - late
                s = spread[j]
                total += (
                    0.5
                    * amplitude[j]
                    * (
                        hermite_value(t0, inv_step, value, slope, u + s)
                        + hermite_value(t0, inv_step, value, slope, u - s)
                    )
                )
            out[k, p] = total * scale[k]
