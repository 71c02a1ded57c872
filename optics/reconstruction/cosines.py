"""Zonal reconstruction on full rectangles by cosine transforms: the same least squares as the sparse systems, in O(N log N).

Southwell: the normal matrix is the Laplacian with free ends, which the cosine transform (type II) makes diagonal,
4 sin²(πk/2M) + 4 sin²(πl/2N). Fried: phases cos(πki/M) cos(πlj/N) at the corners have the slopes

    s_x = −(2/h) sin(πk/2M) cos(πl/2N) sin(πk(i+½)/M) cos(πl(j+½)/N),

and likewise s_y, which are orthogonal for different (k, l): each coefficient is a projection of its own.

Sources: W. H. Southwell, JOSA 70:998, 1980; D. L. Fried, JOSA 67:370, 1977; derived here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import dct, dctn, dst, idctn

__all__ = ["fried_by_cosines", "fried_noise", "hudgin_noise", "southwell_by_cosines", "southwell_noise"]

Float = NDArray[np.float64]


def southwell_by_cosines(slope_x: ArrayLike, slope_y: ArrayLike, pitch_m: float) -> Float:
    """φ (…, rows, cols) at the centres of lenslets from their slopes (…, rows, cols), zero mean; as `zonal.southwell`."""
    sx, sy = _pair(slope_x, slope_y)
    right = _against(0.5 * (sx[..., :, 1:] + sx[..., :, :-1]), -1) + _against(
        0.5 * (sy[..., 1:, :] + sy[..., :-1, :]), -2
    )
    rows, cols = sx.shape[-2:]
    eigenvalue = _half_sines(rows)[:, None] + _half_sines(cols)[None, :]
    eigenvalue[0, 0] = np.inf
    return np.asarray(idctn(dctn(pitch_m * right, type=2, axes=(-2, -1)) / eigenvalue, type=2, axes=(-2, -1)))


def fried_by_cosines(slope_x: ArrayLike, slope_y: ArrayLike, pitch_m: float) -> Float:
    """φ (…, rows + 1, cols + 1) at the corners of lenslets from slopes (…, rows, cols), without piston and waffle; as
    `zonal.fried`."""
    sx, sy = _pair(slope_x, slope_y)
    rows, cols = sx.shape[-2:]
    k, j = np.arange(cols + 1), np.arange(rows + 1)
    sine_x, cosine_x = np.sin(0.5 * np.pi * k / cols), np.cos(0.5 * np.pi * k / cols)
    sine_y, cosine_y = np.sin(0.5 * np.pi * j / rows), np.cos(0.5 * np.pi * j / rows)
    part_x = _sines(_cosines(sx, -2), -1) * (-2.0 * cosine_y[:, None] * sine_x[None, :])
    part_y = _sines(_cosines(sy, -1), -2) * (-2.0 * sine_y[:, None] * cosine_x[None, :])
    norm = (2.0 * cosine_y[:, None] * sine_x[None, :]) ** 2 * _norm_cosine(rows)[:, None] * _norm_sine(cols)[None, :]
    norm = (
        norm
        + (2.0 * sine_y[:, None] * cosine_x[None, :]) ** 2 * _norm_sine(rows)[:, None] * _norm_cosine(cols)[None, :]
    )
    norm[0, 0] = norm[rows, cols] = np.inf
    coefficient = pitch_m * (part_x + part_y) / norm
    # Cosine transform of type I: the inner coefficients count twice there.
    for axis in (-2, -1):
        inner = [slice(None)] * coefficient.ndim
        inner[axis] = slice(1, -1)
        coefficient[tuple(inner)] *= 0.5
        coefficient = dct(coefficient, type=1, axis=axis)
    odd = (j[:, None] + k[None, :]) % 2
    for parity in (0, 1):
        inside = odd == parity
        coefficient[..., inside] -= coefficient[..., inside].mean(axis=-1, keepdims=True)
    return np.asarray(coefficient)


def southwell_noise(rows: int, cols: int) -> float:
    """G of Southwell's geometry on a full rectangle, mean phase variance over h²σ_s², in closed form:

    (1/MN) Σ' [sin²(πk/M) + sin²(πl/N)]/[4 sin²(πk/2M) + 4 sin²(πl/2N)]², without (0, 0).
    """
    power = np.sin(np.pi * np.arange(rows) / rows)[:, None] ** 2 + np.sin(np.pi * np.arange(cols) / cols)[None, :] ** 2
    eigenvalue = _half_sines(rows)[:, None] + _half_sines(cols)[None, :]
    eigenvalue[0, 0] = np.inf
    return float((power / eigenvalue**2).sum() / (rows * cols))


def fried_noise(rows: int, cols: int) -> float:
    """G of Fried's geometry on a full rectangle of lenslets, mean phase variance of the corners over h²σ_s², piston and waffle
    removed; exact sum over the modes of the module's head.

    Fried (1977) printed .6558 + .3206 ln N, which is within 3 % for N = 9 to 25 corners a side; the slope tends to 1/π =
    .318, that of Noll (JOSA 68:139, 1978), slowly: it is .301 between 256 and 512.
    """
    j, k = np.arange(rows + 1), np.arange(cols + 1)
    x = 4.0 * (np.cos(0.5 * np.pi * j / rows)[:, None] * np.sin(0.5 * np.pi * k / cols)[None, :]) ** 2
    y = 4.0 * (np.sin(0.5 * np.pi * j / rows)[:, None] * np.cos(0.5 * np.pi * k / cols)[None, :]) ** 2
    norm = x * _norm_cosine(rows)[:, None] * _norm_sine(cols)[None, :]
    norm = norm + y * _norm_sine(rows)[:, None] * _norm_cosine(cols)[None, :]
    norm[0, 0] = norm[rows, cols] = np.inf
    wave = [np.cos(np.pi * np.outer(i, i) / (i.size - 1)) for i in (j, k)]
    square = [(w**2).sum(axis=1) for w in wave]
    plain = [w.sum(axis=1) for w in wave]
    alternating = [(w * (-1.0) ** np.arange(len(w))).sum(axis=1) for w in wave]
    total = (np.outer(*square) / norm).sum()
    nodes = (rows + 1) * (cols + 1)
    even = (nodes + 1) // 2
    for sign, count in ((1.0, even), (-1.0, nodes - even)):
        total -= ((0.5 * (np.outer(*plain) + sign * np.outer(*alternating))) ** 2 / norm).sum() / count
    return float(total / nodes)


def hudgin_noise(rows: int, cols: int) -> float:
    """G where each phase difference is measured by itself (Hudgin 1977): (1/MN) Σ' 1/[4 sin²(πk/2M) + 4 sin²(πl/2N)]."""
    eigenvalue = _half_sines(rows)[:, None] + _half_sines(cols)[None, :]
    eigenvalue[0, 0] = np.inf
    return float((1.0 / eigenvalue).sum() / (rows * cols))


def _half_sines(count: int) -> Float:
    return np.asarray(4.0 * np.sin(0.5 * np.pi * np.arange(count) / count) ** 2)


def _against(value: Float, axis: int) -> Float:
    """Transpose of the difference between neighbours: −v₀, v₀ − v₁, …, v_last."""
    pad = [(0, 0)] * value.ndim
    pad[axis] = (1, 1)
    return np.asarray(-np.diff(np.pad(value, pad), axis=axis))


def _sines(value: Float, axis: int) -> Float:
    """Σ v_i sin(πk(i+½)/N) for k = 0 … N."""
    inner = 0.5 * dst(value, type=2, axis=axis)
    pad = [(0, 0)] * value.ndim
    pad[axis] = (1, 0)
    return np.pad(inner, pad)


def _cosines(value: Float, axis: int) -> Float:
    """Σ v_i cos(πk(i+½)/N) for k = 0 … N."""
    inner = 0.5 * dct(value, type=2, axis=axis)
    pad = [(0, 0)] * value.ndim
    pad[axis] = (0, 1)
    return np.pad(inner, pad)


def _norm_sine(count: int) -> Float:
    norm = np.full(count + 1, 0.5 * count)
    norm[0], norm[-1] = 0.0, count
    return norm


def _norm_cosine(count: int) -> Float:
    return _norm_sine(count)[::-1].copy()


def _pair(slope_x: ArrayLike, slope_y: ArrayLike) -> tuple[Float, Float]:
    sx, sy = np.asarray(slope_x, np.float64), np.asarray(slope_y, np.float64)
    if sx.shape != sy.shape or sx.ndim < 2:
        raise ValueError(f"slope_x and slope_y need one shape (…, rows, cols), not {sx.shape} and {sy.shape}.")
    return sx, sy
