"""One pass over the rows of a frame, compiled: where each is brightest, its background, and the window around the peak.

A row is read from memory once. Its greatest and least count come first, which show whether all of its pixels are sound, as they
are in most rows; then the column of the greatest one. The background, the median of about 256 of its pixels, is found by
bisection from the median of the row before: of whole numbers mostly three counts of how many lie at or below one.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...optics.copying import copy_into
from ...optics.jit import kernel

__all__ = ["scan_rows"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Pixels of a row that give its background.
_ENOUGH = 256


def scan_rows(
    counts: npt.NDArray[np.generic], half: int, returns: int, top_dn: float, dead_dn: float
) -> tuple[npt.NDArray[np.int64], Float, Float, Bool]:
    """Peaks and backgrounds of rows of counts [DN] (n, cols), whole or real numbers.

    Main arguments:
        half: pixels to either side of a peak. returns: peaks per row, each more than `half` pixels from those before.
        top_dn, dead_dn: counts are sound between these, both excluded.

    Returns column of the peak (n, returns), counts around it (n, returns, 2·half + 1), the row's median (n), NaN where no
    pixel is sound, and whether the window lies within the row and holds sound pixels only (n, returns).
    """
    n, cols = counts.shape
    peak = np.zeros((n, returns), np.int64)
    window = np.zeros((n, returns, 2 * half + 1))
    median = np.empty(n)
    sound = np.zeros((n, returns), np.bool_)
    step = max(cols // _ENOUGH, 1)
    _scan(counts, half, step, top_dn, dead_dn, counts.dtype.kind in "ui", peak, window, median, sound)
    return peak, window, median, sound


@kernel(error_model="numpy")
def _scan(counts, half, step, top, dead, whole, peak, window, median, sound):  # type: ignore[no-untyped-def]
    cols = counts.shape[1]
    some, real = np.empty(cols // step + 1, counts.dtype), np.empty(cols // step + 1)
    guess = counts[0, 0] if counts.size else some[0]
    for i in range(counts.shape[0]):
        row = counts[i]
        high, low = row[0], row[0]
        for j in range(cols):
            if row[j] > high:
                high = row[j]
            if row[j] < low:
                low = row[j]
        plain = high < top and low > dead and (whole or _numbers(row))
        size = 0
        if plain:
            size = (cols + step - 1) // step
            for j in range(size):
                some[j] = row[j * step]
        else:
            for j in range(0, cols, step):
                if row[j] < top and row[j] > dead:
                    some[size] = row[j]
                    size += 1
        median[i] = np.nan
        if size and whole:
            median[i], guess = _whole_median(some[:size], guess, low, high)
        elif size:
            copy_into(real, some[:size])
            median[i] = np.median(real[:size])
        for k in range(peak.shape[1]):
            at = _highest(row, high, top, dead, plain and k == 0, half, peak[i, :k])
            if at < 0:
                break
            peak[i, k] = at
            inside = at >= half and at + half < cols
            good = inside
            if inside:
                for j in range(2 * half + 1):
                    value = row[at - half + j]
                    window[i, k, j] = value
                    good = good and (plain or (value < top and value > dead))
            sound[i, k] = good


@kernel(error_model="numpy")
def _highest(row, high, top, dead, plain, half, before):  # type: ignore[no-untyped-def]
    """The first column of the greatest sound count beyond `half` pixels of those `before`; −1 where there is none."""
    if plain:
        at = 0
        while row[at] != high:
            at += 1
        return at
    best = -1
    for j in range(row.size):
        if row[j] < top and row[j] > dead and (best < 0 or row[j] > row[best]):
            free = True
            for m in range(before.size):
                free = free and abs(j - before[m]) > half
            if free:
                best = j
    return best


@kernel(error_model="numpy")
def _numbers(row):  # type: ignore[no-untyped-def]
    """Whether no pixel is NaN."""
    count = 0
    for j in range(row.size):
        count += row[j] == row[j]
    return count == row.size


@kernel(error_model="numpy")
def _below(some, value):  # type: ignore[no-untyped-def]
    """How many are `value` or less."""
    count = np.int32(0)
    for j in range(some.size):
        count = np.int32(count + np.int32(some[j] <= value))
    return count


@kernel(error_model="numpy")
def _whole_median(some, guess, low, high):  # type: ignore[no-untyped-def]
    """(median of whole numbers between low and high, the lower middle one). `guess`: where to begin."""
    need = (some.size - 1) // 2 + 1
    # Fewer than `need` are at or below `down`, and `need` or more at or below `up`.
    down, up = np.int64(low) - 1, np.int64(high)
    at = min(max(np.int64(guess), down + 1), up)
    reach = 1
    held = -1
    while up - down > 1 or held < 0:
        count = _below(some, some.dtype.type(at))
        if count >= need:
            up, held = at, count
            at = max(at - reach, (down + up) // 2)
        else:
            down = at
            at = min(at + reach, (down + up + 1) // 2)
        reach *= 2
        if up - down == 1 and held < 0:
            held = _below(some, some.dtype.type(up))
        at = min(max(at, down + 1), up)
    middle = float(up)
    if some.size % 2 == 0 and held == need:
        after, least = high, some.dtype.type(up)
        for j in range(some.size):
            value = some[j] if some[j] > least else high
            after = value if value < after else after
        middle = 0.5 * (middle + after)
    return middle, some.dtype.type(up)
