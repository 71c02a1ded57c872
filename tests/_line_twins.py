"""What the compiled kernels of laser lines do, in plain NumPy and SciPy: slow, short, and written without them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr

Float = NDArray[np.float64]


def scanned(
    counts: NDArray[np.generic], half: int, returns: int, top: float, dead: float
) -> tuple[NDArray[np.int64], Float, Float, NDArray[np.bool_]]:
    """As `row_scan.scan_rows`, row by row, from sorted pixels."""
    n, cols = counts.shape
    step = max(cols // 256, 1)
    peak, window = np.zeros((n, returns), np.int64), np.zeros((n, returns, 2 * half + 1))
    median, sound = np.full(n, np.nan), np.zeros((n, returns), bool)
    for i, row in enumerate(np.asarray(counts, np.float64)):
        good = (row < top) & (row > dead)
        part = row[::step][good[::step]]
        if part.size:
            median[i] = np.median(part)
        left = np.where(good, row, -np.inf)
        for k in range(returns):
            if not np.isfinite(left).any():
                break
            at = int(left.argmax())
            peak[i, k] = at
            if at >= half and at + half < cols:
                window[i, k] = row[at - half : at + half + 1]
                sound[i, k] = good[at - half : at + half + 1].all()
            left[np.abs(np.arange(cols) - at) <= half] = -np.inf
    return peak, window, median, sound


def fitted(z: Float, floor: float, width: float, *, weighted: bool, spread: float = 0.5) -> tuple[float, float]:
    """(c [px] from the middle pixel, its standard error) of one window, by SciPy's least squares, weights renewed to the end."""
    x = np.arange(z.size) - z.size // 2

    def model(p: Float) -> Float:
        s = np.exp(p[3])
        return np.asarray(p[2] + p[1] * (ndtr((x + 0.5 - p[0]) / s) - ndtr((x - 0.5 - p[0]) / s)))

    held = 1.0 / spread if weighted else np.sqrt(floor) / spread
    p = np.array([0.5 * (z[z.size // 2 + 1] - z[z.size // 2 - 1]) / z.max(), z.sum(), 0.0, np.log(width)])
    for _ in range(25 if weighted else 1):
        deviation = np.sqrt(np.maximum(model(p), 0.0) + floor) if weighted else np.ones(z.size)
        result = least_squares(
            lambda q, d=deviation: np.append((z - model(q)) / d, held * (q[3] - np.log(width))), p,
            x_scale=[1.0, max(z.sum(), 1.0), max(np.sqrt(floor), 1.0), 1.0], ftol=1e-15, xtol=1e-15, gtol=1e-15,
        )  # fmt: skip
        p = result.x
    variance = np.maximum(model(p), 0.0) + floor
    jacobian = np.empty((z.size, 4))
    for k, step in enumerate((1e-5, 1e-3, 1e-3, 1e-5)):
        change = np.zeros(4)
        change[k] = step
        jacobian[:, k] = (model(p + change) - model(p - change)) / (2 * step)
    w = 1.0 / variance if weighted else np.ones(z.size)
    inverse = np.linalg.inv((jacobian.T * w) @ jacobian + np.diag([0, 0, 0, held**2]))
    middle = (jacobian.T * (w * w * variance)) @ jacobian
    return float(p[0]), float(np.sqrt((inverse @ middle @ inverse)[0, 0]))
