"""Centre of gravity over whole cells, compiled: background, moments and their variance straight from the counts of each frame.

The same sums as `cells_of` and `moments`, without an array per cell: of z = (counts − offset)/gain − level the centre is
c = Σ x z/Σ z, its variance Σ V (x − c)²/(Σ z)².
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
    out = np.empty((number, lenslets, 6))
    corner, levels = np.empty(lenslets), np.empty((number, 1))
    for image, own, held in zip(images, out, levels, strict=True):
        counts = np.ascontiguousarray(image)
        _corners(counts, place_px, half_px, far_px, *scale, corner)
        known = corner[np.isfinite(corner)]
        held[0] = level = float(np.median(known)) if known.size else np.nan
        _moments(counts, place_px, half_px, *scale, level, floor_e2, excess, own)
    flat = out.reshape(-1, 6)
    with np.errstate(invalid="ignore"):
        noise = least_sigmas * np.sqrt(floor_e2 + excess * np.maximum(levels, 0.0))
        sound = whole & (out[..., 5] > noise) & (out[..., 4] > 0) & np.isfinite(levels)
    return flat[:, :2].copy(), flat[:, 2:4].copy(), np.isfinite(flat[:, 0]), np.asarray(sound.ravel())


@kernel
def _corners(counts, place, half, far, offset, gain, dead, top, corner):  # type: ignore[no-untyped-def]
    """Mean photoelectrons of the good pixels in each cell's corners; NaN where there are none."""
    rows, cols = counts.shape
    for lenslet in range(len(place)):
        px, py = place[lenslet, 0], place[lenslet, 1]
        total, number = 0.0, 0
        for i in range(max(int(np.ceil(py - half)), 0), min(int(np.floor(py + half)), rows - 1) + 1):
            if abs(i - py) <= far:
                continue
            for j in range(max(int(np.ceil(px - half)), 0), min(int(np.floor(px + half)), cols - 1) + 1):
                if abs(j - px) > far and counts[i, j] > dead and counts[i, j] < top:
                    total += counts[i, j]
                    number += 1
        corner[lenslet] = (total / number - offset) / gain if number else np.nan


@kernel
def _moments(counts, place, half, offset, gain, dead, top, level, floor, excess, out):  # type: ignore[no-untyped-def]
    """out (lenslet, 6): x, y, their variances, 1 or 0 where a pixel is bad, the brightest z. Sums about the declared place."""
    rows, cols = counts.shape
    per_dn = 1.0 / gain
    base = offset * per_dn + level
    for lenslet in range(len(place)):
        px, py = place[lenslet, 0], place[lenslet, 1]
        total = sx = sy = v0 = vx = vxx = vy = vyy = brightest = 0.0
        bad = 0
        first, last = max(int(np.ceil(px - half)), 0), min(int(np.floor(px + half)), cols - 1)
        for i in range(max(int(np.ceil(py - half)), 0), min(int(np.floor(py + half)), rows - 1) + 1):
            y = i - py
            x = first - px
            row = row_x = spread = spread_x = spread_xx = 0.0
            for j in range(first, last + 1):
                dn = float(counts[i, j])
                good = (dn > dead) & (dn < top)
                bad += 1 - good
                z = dn * per_dn - base if good else 0.0
                v = excess * max(z + level, 0.0) + floor
                brightest = max(brightest, z)
                row += z
                row_x += x * z
                spread += v
                spread_x += x * v
                spread_xx += x * x * v
                x += 1.0
            total, sx, sy = total + row, sx + row_x, sy + y * row
            v0, vx, vxx = v0 + spread, vx + spread_x, vxx + spread_xx
            vy, vyy = vy + y * spread, vyy + y * y * spread
        if total > 0.0:
            cx, cy = sx / total, sy / total
            out[lenslet, 0], out[lenslet, 1] = cx, cy
            out[lenslet, 2] = max(vxx - 2.0 * cx * vx + cx * cx * v0, 0.0) / total**2
            out[lenslet, 3] = max(vyy - 2.0 * cy * vy + cy * cy * v0, 0.0) / total**2
        else:
            out[lenslet, :4] = np.nan
        out[lenslet, 4], out[lenslet, 5] = 1.0 if bad == 0 else 0.0, brightest
