"""Centre of gravity over whole cells, compiled: background, moments and their variance straight from the counts of each frame.

The same sums as `cells_of` and `moments`, without an array per cell, in single precision for the sums of a column: of z = (counts −
offset)/gain − level the centre is c = Σ x z/Σ z, its variance Σ V (x − c)²/(Σ z)².
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ...optics.jit import kernel

__all__ = ["centres_of_gravity"]

Float = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


def centres_of_gravity(
    images: npt.NDArray[Any], place_px: Float, half_px: float, far_px: float, whole: npt.NDArray[np.bool_],
    scale: tuple[float, float, float, float], floor_e2: float, excess: float, least_sigmas: float,
) -> tuple[Float, Float, npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:  # fmt: skip
    """(position from the declared place [px], variance [px²]) (image·lenslet, axis), whether there is light, and whether the cell
    is sound (image·lenslet), as `Cells.sound`.

    Main arguments:
        images (image, rows, cols) [DN]. place_px (lenslet, axis). half_px: of a cell. far_px: beyond it in both axes lie corners
        that show the background. whole (lenslet): cells within the image. scale: offset [DN], DN per photoelectron, and the counts
        between which (exclusive) a pixel is good. floor_e2, excess, least_sigmas: as for `cells_of`.
    """
    number, lenslets = len(images), len(place_px)
    offset, gain, dead, top = scale
    out, sums, corner = np.empty((number, lenslets, 6)), np.empty((lenslets, _SUMS)), np.empty(lenslets)
    levels, above = np.empty((number, 1)), np.zeros((images.shape[1], images.shape[2] + _LANES), np.float32)
    for image, own, held in zip(images, out, levels, strict=True):
        _above_offset(np.ascontiguousarray(image), offset, above)
        _sums(above, image.shape[1], place_px, half_px, far_px, dead - offset, top - offset, sums, corner)
        known = corner[np.isfinite(corner)]
        held[0] = level = float(np.median(known)) / gain if known.size else np.nan
        _centres(sums, 1.0 / gain, level, floor_e2, excess, own)
    flat = out.reshape(-1, 6)
    with np.errstate(invalid="ignore"):
        noise = least_sigmas * np.sqrt(floor_e2 + excess * np.maximum(levels, 0.0))
        sound = whole & (out[..., 5] > noise) & (out[..., 4] > 0) & np.isfinite(levels)
    return flat[:, :2].copy(), flat[:, 2:4].copy(), np.isfinite(flat[:, 0]), np.asarray(sound.ravel())


#: Sums of a cell: of e, k e, i e, p, k p, k² p, i p, i² p; the greatest e, the bad pixels; columns and rows, and the place of the
#: first of both. e = counts − offset, p = max(e, 0), k and i the column and row in the cell.
_SUMS = 14
#: Columns that are summed at once: a number of them that the compiler knows fills its vectors.
_LANES = 16


@kernel
def _above_offset(counts, offset, out):  # type: ignore[no-untyped-def]
    """counts − offset into the first columns of `out`: single precision holds whole numbers of up to 24 bits."""
    for i in range(counts.shape[0]):
        for j in range(counts.shape[1]):
            out[i, j] = np.float32(counts[i, j] - offset)


@kernel
def _sums(above, cols, place, half, far, dead, top, out, corner):  # type: ignore[no-untyped-def]
    """out (lenslet, _SUMS), and the mean e of the good pixels in each cell's corners (lenslet), NaN where there are none.

    above (rows, cols + _LANES). Each pixel is read once, into sums of a column; what lies beside a cell is left out in the end. In
    one function: a call, or an array that might be another one, takes twice the time.
    """
    low, high, none, one = np.float32(dead), np.float32(top), np.float32(0.0), np.float32(1.0)
    a = np.empty((9, _LANES), np.float32)
    for lenslet in range(len(place)):
        px, py = place[lenslet, 0], place[lenslet, 1]
        left, right = max(int(np.ceil(px - half)), 0), min(int(np.floor(px + half)), cols - 1)
        first, last = max(int(np.ceil(py - half)), 0), min(int(np.floor(py + half)), len(above) - 1)
        s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = bad = light = clear = 0.0
        peak = -np.inf
        for begin in range(left, right + 1, _LANES):
            a[:] = none
            a[5] = -np.inf
            for row in range(first, last + 1):
                i = np.float32(row - first)
                line = above[row, begin : begin + _LANES]
                for j in range(_LANES):
                    e = line[j]
                    p = e if e > none else none
                    a[0, j] += e
                    a[1, j] += i * e
                    a[2, j] += p
                    a[3, j] += i * p
                    a[4, j] += i * i * p
                    a[5, j] = e if e > a[5, j] else a[5, j]
                    a[6, j] += none if (e > low) & (e < high) else one
                if abs(row - py) > far:
                    for j in range(_LANES):
                        e = line[j]
                        good = (e > low) & (e < high)
                        a[7, j] += e if good else none
                        a[8, j] += one if good else none
            for j in range(min(_LANES, right + 1 - begin)):
                k, e, p = float(begin - left + j), a[0, j], a[2, j]
                s0, s1, s2, s3 = s0 + e, s1 + k * e, s2 + a[1, j], s3 + p
                s4, s5, s6, s7 = s4 + k * p, s5 + k * k * p, s6 + a[3, j], s7 + a[4, j]
                peak, bad = max(peak, a[5, j]), bad + a[6, j]
                if abs(begin + j - px) > far:
                    light, clear = light + a[7, j], clear + a[8, j]
        size = float(max(right - left + 1, 0)), float(max(last - first + 1, 0))
        own = out[lenslet]
        own[0], own[1], own[2], own[3], own[4], own[5], own[6], own[7] = s0, s1, s2, s3, s4, s5, s6, s7
        own[8], own[9], own[10], own[11], own[12], own[13] = peak, bad, size[0], size[1], left - px, first - py
        corner[lenslet] = light / clear if clear > 0.0 else np.nan


@kernel
def _centres(sums, per_dn, level, floor, excess, out):  # type: ignore[no-untyped-def]
    """out (lenslet, 6): x, y, their variances, 1 or 0 where a pixel is bad, the brightest z = e/gain − level.

    V = excess·p/gain + floor; sums about the first pixel of a cell become those about the declared place.
    """
    for lenslet in range(len(sums)):
        s = sums[lenslet]
        n, m, x, y = s[10], s[11], s[12], s[13]
        columns, rows = 0.5 * n * (n - 1.0), 0.5 * m * (m - 1.0)
        columns2, rows2 = columns * (2.0 * n - 1.0) / 3.0, rows * (2.0 * m - 1.0) / 3.0
        total = s[0] * per_dn - level * n * m
        if total > 0.0:
            # Centre and spread from the first pixel; x and y lead from the declared place to that.
            cx, cy = (s[1] * per_dn - level * columns * m) / total, (s[2] * per_dn - level * rows * n) / total
            v0, per = excess * per_dn * s[3] + floor * n * m, excess * per_dn
            vx = per * s[5] + floor * columns2 * m - 2.0 * cx * (per * s[4] + floor * columns * m) + cx * cx * v0
            vy = per * s[7] + floor * rows2 * n - 2.0 * cy * (per * s[6] + floor * rows * n) + cy * cy * v0
            out[lenslet, 0], out[lenslet, 1] = x + cx, y + cy
            out[lenslet, 2], out[lenslet, 3] = max(vx, 0.0) / total**2, max(vy, 0.0) / total**2
        else:
            out[lenslet, :4] = np.nan
        out[lenslet, 4] = 1.0 if s[9] == 0.0 else 0.0
        out[lenslet, 5] = s[8] * per_dn - level
