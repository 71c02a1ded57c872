"""The compiled loop of `lattice`: fields of all lenslets, each computed in cache and added to the lattice."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..jit import kernel

__all__ = ["add_fields"]


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
            for p in range(points):
                line_real[p] = 0.0
                line_imag[p] = 0.0
            for a in range(cells):
                kr, ki = factor * y_real[ky, a, y], factor * y_imag[ky, a, y]
                for p in range(points):
                    line_real[p] += kr * along_real[a, p] - ki * along_imag[a, p]
                    line_imag[p] += kr * along_imag[a, p] + ki * along_real[a, p]
            row, first = first_y[k] + y, first_x[k]
            if apart:
                for p in range(points):
                    out_real[row, first + p] += line_real[p] * line_real[p] + line_imag[p] * line_imag[p]
            else:
                for p in range(points):
                    out_real[row, first + p] += line_real[p]
                    out_imag[row, first + p] += line_imag[p]
