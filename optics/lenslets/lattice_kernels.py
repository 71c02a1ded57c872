"""The compiled loop of `lattice`: fields of all lenslets, each computed in cache and added to the lattice."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..jit import kernel

__all__ = ["add_fields", "sinc_about"]


@kernel(fastmath=True)  # type: ignore[untyped-decorator]
def add_fields(
    real: Any,
    imag: Any,
    x_real: Any,
    x_imag: Any,
    y_real: Any,
    y_imag: Any,
    class_x: Any,
    class_y: Any,
    spread_x: Any,
    spread_y: Any,
    first_x: Any,
    first_y: Any,
    out_real: Any,
    out_imag: Any,
    apart: bool,
) -> None:
    """Add Σ_c K_y(Y, c_y) u(c_y, c_x) K_x(X, c_x) · spread_y(Y) · spread_x(X) of every lenslet to the lattice.

    real, imag (lenslets, q, q): u. x_real … y_imag (classes, q, points): K of either axis. class_x, class_y (lenslets): which K.
    spread_x, spread_y (lenslets, points). first_x, first_y (lenslets): the lattice point of the first. out_real, out_imag:
    the lattice. apart: add |field|² of every lenslet to out_real instead, out_imag stays as it is.
    """
    count, cells, points = real.shape[0], real.shape[1], x_real.shape[2]
    along_real = np.empty((cells, points), np.float32)
    along_imag = np.empty((cells, points), np.float32)
    line_real = np.empty(points, np.float32)
    line_imag = np.empty(points, np.float32)
    for k in range(count):
        kx, ky = class_x[k], class_y[k]
        for a in range(cells):
            for p in range(points):
                along_real[a, p] = 0.0
                along_imag[a, p] = 0.0
            for b in range(cells):
                ur, ui = real[k, a, b], imag[k, a, b]
                for p in range(points):
                    along_real[a, p] += ur * x_real[kx, b, p] - ui * x_imag[kx, b, p]
                    along_imag[a, p] += ur * x_imag[kx, b, p] + ui * x_real[kx, b, p]
            for p in range(points):
                along_real[a, p] *= spread_x[k, p]
                along_imag[a, p] *= spread_x[k, p]
        for y in range(points):
            factor = spread_y[k, y]
            # Two rows of cells at a time, and a loop per output: fewer loads and stores, and loops that the compiler vectorises.
            for a in range(0, cells, 2):
                other = min(a + 1, cells - 1)
                kr, ki = factor * y_real[ky, a, y], factor * y_imag[ky, a, y]
                mr, mi = factor * y_real[ky, other, y], factor * y_imag[ky, other, y]
                if other == a:  # the last row of an odd number has no partner
                    mr, mi = np.float32(0.0), np.float32(0.0)
                if a == 0:
                    for p in range(points):
                        line_real[p] = (
                            kr * along_real[a, p]
                            - ki * along_imag[a, p]
                            + mr * along_real[other, p]
                            - mi * along_imag[other, p]
                        )
                    for p in range(points):
                        line_imag[p] = (
                            kr * along_imag[a, p]
                            + ki * along_real[a, p]
                            + mr * along_imag[other, p]
                            + mi * along_real[other, p]
                        )
                else:
                    for p in range(points):
                        line_real[p] += (
                            kr * along_real[a, p]
                            - ki * along_imag[a, p]
                            + mr * along_real[other, p]
                            - mi * along_imag[other, p]
                        )
                    for p in range(points):
                        line_imag[p] += (
                            kr * along_imag[a, p]
                            + ki * along_real[a, p]
                            + mr * along_imag[other, p]
                            + mi * along_real[other, p]
                        )
            row, first = first_y[k] + y, first_x[k]
            if apart:
                for p in range(points):
                    out_real[row, first + p] += line_real[p] * line_real[p] + line_imag[p] * line_imag[p]
            else:
                for p in range(points):
                    out_real[row, first + p] += line_real[p]
                for p in range(points):
                    out_imag[row, first + p] += line_imag[p]


@kernel  # type: ignore[untyped-decorator]
def sinc_about(place: Any, member: Any, shift: Any, out: Any) -> None:
    """out (lenslets, points) = sinc(place[member[k]] − shift[k]), sinc x = sin πx/πx.

    place (classes, points). sin π(a − b) comes from sines and cosines of a and b, one each per point and per lenslet; near its
    zero, where that loses digits, from a series whose next term is 2e-16.
    """
    sin_place, cos_place = np.sin(np.pi * place), np.cos(np.pi * place)
    for k in range(len(shift)):
        kind, sin_shift, cos_shift = member[k], np.sin(np.pi * shift[k]), np.cos(np.pi * shift[k])
        for p in range(place.shape[1]):
            x = np.pi * (place[kind, p] - shift[k])
            if abs(x) < 1e-2:
                out[k, p] = 1.0 - x * x / 6.0 * (1.0 - x * x / 20.0)
            else:
                out[k, p] = (sin_place[kind, p] * cos_shift - cos_place[kind, p] * sin_shift) / x
