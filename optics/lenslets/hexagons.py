"""Spots of hexagonal lenslets at their focus, and the part of each sample of a grid that lies in a hexagon.

A regular hexagon, flat to flat a, is three rhombi with sides p, q of length a/√3 that meet at its centre, so that its field at
the frequency ν = (X, Y)/λf is

    A(ν) = Σ_rhombi |p × q| sinc(ν·p) sinc(ν·q) e^{−iπν·(p + q)},    sinc t = sin(πt)/(πt),    A(0) = √3/2 a²,

which is real. The light per area is |A|²/(λf)² of a wave of unit irradiance, and |A|²/(A(0) (λf)²) its share. Two edges are
parallel to y, two corners lie on the y axis. The pattern has no frequency above 2/√3 a/λf, so that its integrals over pixels
are smooth: they are tabulated and interpolated by cubic splines.

Source: J. W. Goodman, Introduction to Fourier Optics, 2005, sec. 2.1 and 4.4; the sum over rhombi is derived here.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import RectBivariateSpline

__all__ = ["HexagonSpot", "hexagon_coverage", "hexagon_density", "hexagon_spot"]

Float = NDArray[np.float64]

#: Area of a hexagon of unit width between its flats.
_AREA = float(np.sqrt(0.75))
#: Nodes of the spline per λf/a, and the fewest per pixel: shares then err by 2e-5 of the greatest.
_PER_WIDTH, _PER_PX = 12.0, 8
#: Gauss-Legendre nodes across a cell of a grid in `hexagon_coverage`.
_NODES = 8


def hexagon_density(x: ArrayLike, y: ArrayLike) -> Float:
    """Share of the light per area at (x, y), both in λf/a, of a flat wave behind a hexagon; its integral over the plane is 1."""
    u, v = np.asarray(x, np.float64), np.asarray(y, np.float64)
    angle = np.pi / 2 + 2.0 * np.pi / 3.0 * np.arange(3)
    corner = np.stack([np.cos(angle), np.sin(angle)], axis=1) / np.sqrt(3.0)
    along = [u * one[0] + v * one[1] for one in corner]
    total = np.zeros(np.broadcast_shapes(u.shape, v.shape))
    for k in range(3):
        p, q = along[k], along[(k + 1) % 3]
        total += np.sinc(p) * np.sinc(q) * np.cos(np.pi * (p + q))
    return np.asarray(_AREA * (total / 3.0) ** 2)


class HexagonSpot:
    """Shares of a spot's light in pixels, by a table; 0 beyond `reach_px` from the spot along either axis."""

    def __init__(self, width_px: float, reach_px: float) -> None:
        per = max(_PER_PX, 2 * int(np.ceil(0.5 * _PER_WIDTH / width_px)))
        reach = int(np.ceil(reach_px)) + 1
        edge = np.arange(-(reach + 1) * per, (reach + 1) * per + 1) / per
        density = hexagon_density(edge[None, :] / width_px, edge[:, None] / width_px) / width_px**2
        # Simpson's rule over a pixel, whose sides lie on nodes, along each axis.
        weight = np.r_[1.0, np.tile([4.0, 2.0], per // 2)]
        weight[-1] = 1.0
        weight /= 3.0 * per
        held = np.apply_along_axis(np.convolve, 1, density, weight, "valid")
        held = np.apply_along_axis(np.convolve, 0, held, weight, "valid")
        node = edge[per // 2 : -(per // 2)]
        self.reach_px = float(reach_px)
        self._spline = RectBivariateSpline(node, node, held)

    def shares(self, row: Float, col: Float, *, d_row: int = 0, d_col: int = 0) -> Float:
        """Shares (rows, cols) in pixels whose centres lie row (rows), col (cols) [px] from the spot, both rising; or their
        derivatives by these."""
        return np.asarray(self._spline(row, col, dx=d_row, dy=d_col))

    def image(self, col_px: ArrayLike, row_px: ArrayLike, light: ArrayLike, shape: tuple[int, int]) -> Float:
        """Σ light · shares as (rows, cols), as `spots.isolated_image` for squares: each lenslet alone."""
        total = np.zeros(shape)
        places = np.broadcast_arrays(*(np.ravel(np.asarray(one, np.float64)) for one in (col_px, row_px, light)))
        for x, y, bright in zip(*places, strict=True):
            rows, cols = (self._pixels(at, count) for at, count in ((y, shape[0]), (x, shape[1])))
            if rows.size and cols.size:
                part = total[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
                part += bright * np.maximum(self.shares(rows - y, cols - x), 0.0)
        return total

    def _pixels(self, at: float, count: int) -> NDArray[np.int64]:
        low, high = max(int(np.ceil(at - self.reach_px)), 0), min(int(np.floor(at + self.reach_px)), count - 1)
        return np.arange(low, high + 1)


@lru_cache(maxsize=8)
def hexagon_spot(width_px: float, reach_px: float) -> HexagonSpot:
    """The table of a spot of width λf/a [px] out to `reach_px`. Raises ValueError for lengths that are not positive."""
    if not (width_px > 0 and reach_px > 0 and np.isfinite(width_px) and np.isfinite(reach_px)):
        raise ValueError(f"width_px and reach_px must be positive and finite, not {width_px!r}, {reach_px!r}.")
    return HexagonSpot(width_px, reach_px)


def hexagon_coverage(
    centres_m: ArrayLike, flat_to_flat_m: float, step_m: float, side: int
) -> tuple[NDArray[np.int64], Float]:
    """(sample (hexagons, k), share (hexagons, k)): which samples of a grid lie in each hexagon, and how much of each does, 0 … 1.

    Main arguments:
        centres_m (hexagons, 2): x, y from the grid's middle. step_m, side: of the grid, a sample being a square of side step_m;
            its number is row·side + column. What lies outside the grid is left out.

    Widths are exact, and Gauss-Legendre nodes take their mean over the height of a sample: areas err by some 1e-4.
    """
    centre = np.asarray(centres_m, np.float64)
    a, half_height = flat_to_flat_m, flat_to_flat_m / np.sqrt(3.0)
    first_edge = -0.5 * side * step_m
    high, wide = (int(np.ceil(2.0 * one / step_m)) + 1 for one in (half_height, 0.5 * a))
    row = np.floor((centre[:, 1] - half_height - first_edge) / step_m).astype(np.int64)[:, None] + np.arange(high)
    col = np.floor((centre[:, 0] - 0.5 * a - first_edge) / step_m).astype(np.int64)[:, None] + np.arange(wide)
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    y = first_edge + (row[:, :, None] + 0.5 + 0.5 * node) * step_m - centre[:, 1, None, None]
    reach = np.clip(a - np.sqrt(3.0) * np.abs(y), 0.0, 0.5 * a)[:, :, None, :]
    left = (first_edge + col * step_m - centre[:, :1])[:, None, :, None]
    overlap = np.clip(np.minimum(reach, left + step_m) - np.maximum(-reach, left), 0.0, None)
    share = (overlap @ weight) * 0.5 / step_m
    there = ((row >= 0) & (row < side))[:, :, None] & ((col >= 0) & (col < side))[:, None, :]
    sample = np.where(there, row[:, :, None] * side + col[:, None, :], 0)
    flat = (len(centre), -1)
    return sample.reshape(flat), np.where(there, share, 0.0).reshape(flat)
