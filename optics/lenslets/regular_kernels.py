"""The compiled loop of `regular`: fields of all lenslets, each computed in cache and added to the lattice."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..jit import kernel

__all__ = ["add_fields"]


@kernel(fastmath=True)
def add_fields(
    real: Any,
    imag: Any,
    kernel_real: Any,
    kernel_imag: Any,
    spread_x: Any,
    spread_y: Any,
    samples: int,
    out_real: Any,
    out_imag: Any,
) -> None:
    """Add Σ_c K(Y, c_y) u(c_y, c_x) K(X, c_x) · spread_y(Y) · spread_x(X) of every lenslet to the lattice.

    real, imag (rows, cols, q, q): u. kernel_real, kernel_imag (q, points): K of one axis. spread_x, spread_y (rows, cols, points).
    samples: points per pitch. out_real, out_imag: the lattice. All float32.
    """
    rows, cols, cells = real.shape[0], real.shape[1], real.shape[2]
    points = kernel_real.shape[1]
    along_real = np.empty((cells, points), np.float32)
    along_imag = np.empty((cells, points), np.float32)
    line_real = np.empty(points, np.float32)
    line_imag = np.empty(points, np.float32)
    for i in range(rows):
        for j in range(cols):
            for a in range(cells):
                for p in range(points):
                    along_real[a, p] = 0.0
                    along_imag[a, p] = 0.0
                for b in range(cells):
                    ur, ui = real[i, j, a, b], imag[i, j, a, b]
                    for p in range(points):
                        along_real[a, p] += ur * kernel_real[b, p] - ui * kernel_imag[b, p]
                        along_imag[a, p] += ur * kernel_imag[b, p] + ui * kernel_real[b, p]
                for p in range(points):
                    along_real[a, p] *= spread_x[i, j, p]
                    along_imag[a, p] *= spread_x[i, j, p]
            for y in range(points):
                factor = spread_y[i, j, y]
                for p in range(points):
                    line_real[p] = 0.0
                    line_imag[p] = 0.0
                for a in range(cells):
                    kr, ki = factor * kernel_real[a, y], factor * kernel_imag[a, y]
                    for p in range(points):
                        line_real[p] += kr * along_real[a, p] - ki * along_imag[a, p]
                        line_imag[p] += kr * along_imag[a, p] + ki * along_real[a, p]
                row, first = i * samples + y, j * samples
                for p in range(points):
                    out_real[row, first + p] += line_real[p]
                    out_imag[row, first + p] += line_imag[p]
