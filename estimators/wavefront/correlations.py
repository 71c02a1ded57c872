"""Positions by correlation with the declared spot: on whole pixels with a parabola between them, and to the maximum."""

from __future__ import annotations

from functools import partial
from typing import Literal

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..registry import estimator
from .cells import Cells, Found, Search, first_guess, measured
from .options import whole

__all__ = ["spot_correlation", "spot_matched"]

Float = npt.NDArray[np.float64]


def _shifted(cells: Cells, middle: Float, shifts: Float) -> tuple[Float, Float]:
    """Share of a spot at place + middle + shift in the pixels: (lenslet, shift, w) along x and along y."""
    x = cells.x[:, None, :] - middle[:, :1, None] - shifts[None, :, None]
    y = cells.y[:, None, :] - middle[:, 1:, None] - shifts[None, :, None]
    return cells.spot.share(x), cells.spot.share(y)


def _products(cells: Cells) -> Float:
    """Σ z T(x − s) (lenslet, 2r + 1, 2r + 1) at whole-pixel shifts s of −r … r, by FFT on the cell's own pixels."""
    width = cells.z.shape[1]
    reach = width // 2
    side = 2 * width
    tx, ty = _shifted(cells, np.zeros((len(cells.z), 2)), np.zeros(1))
    template = ty[:, 0, :, None] * tx[:, 0, None, :]
    spectrum = np.fft.rfft2(cells.z, s=(side, side)) * np.conj(np.fft.rfft2(template, s=(side, side)))
    score = np.fft.irfft2(spectrum, s=(side, side))
    return np.asarray(np.roll(score, (reach, reach), axis=(1, 2))[:, : 2 * reach + 1, : 2 * reach + 1])


def _differences(cells: Cells, power: int) -> Float:
    """−Σ |z − A T(x − s)|^power at the same shifts, A the light of the cell."""
    reach = cells.z.shape[1] // 2
    shifts = np.arange(-reach, reach + 1, dtype=np.float64)
    tx, ty = _shifted(cells, np.zeros((len(cells.z), 2)), shifts)
    light = _light(cells)[:, None, None]
    score = np.empty((len(cells.z), shifts.size, shifts.size))
    for i in range(shifts.size):
        for j in range(shifts.size):
            rest = cells.z - light * ty[:, i, :, None] * tx[:, j, None, :]
            score[:, i, j] = -((np.abs(rest) ** power) * cells.inside).sum(axis=(1, 2))
    return np.asarray(score, np.float64)


def _light(cells: Cells) -> Float:
    return np.asarray(np.maximum(cells.z.sum(axis=(1, 2)), 1e-9), np.float64)


def _correlated(cells: Cells, fit: str, metric: str) -> Found:
    reach = cells.z.shape[1] // 2
    score = _products(cells) if metric == "product" else _differences(cells, 2 if metric == "square" else 1)
    flat = score.reshape(len(score), -1).argmax(axis=1)
    row, col = np.clip(flat // (2 * reach + 1), 1, 2 * reach - 1), np.clip(flat % (2 * reach + 1), 1, 2 * reach - 1)
    at = np.arange(len(score))
    near = score[
        at[:, None, None], row[:, None, None] + np.arange(-1, 2)[:, None], col[:, None, None] + np.arange(-1, 2)
    ]
    gradient, bend = _paraboloid(near) if fit == "surface" else _parabolas(near)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = (
            -np.stack(
                [
                    gradient[:, 0] * bend[:, 1] - gradient[:, 1] * bend[:, 2],
                    gradient[:, 1] * bend[:, 0] - gradient[:, 0] * bend[:, 2],
                ],
                axis=1,
            )
            / (bend[:, 0] * bend[:, 1] - bend[:, 2] ** 2)[:, None]
        )
    middle = np.stack([col - reach, row - reach], axis=1).astype(np.float64)
    good = np.asarray((np.abs(offset) <= 1.0).all(axis=1) & (bend[:, :2] < 0).all(axis=1))
    return Found(middle + offset, _parabola_variance(cells, middle, bend, metric), good)


def _parabolas(near: Float) -> tuple[Float, Float]:
    """(gradient, (xx, yy, xy)) of a parabola along each axis through the middle row and column."""
    gx, gy = 0.5 * (near[:, 1, 2] - near[:, 1, 0]), 0.5 * (near[:, 2, 1] - near[:, 0, 1])
    bx = near[:, 1, 2] - 2.0 * near[:, 1, 1] + near[:, 1, 0]
    by = near[:, 2, 1] - 2.0 * near[:, 1, 1] + near[:, 0, 1]
    return np.stack([gx, gy], axis=1), np.stack([bx, by, np.zeros_like(bx)], axis=1)


def _paraboloid(near: Float) -> tuple[Float, Float]:
    """The same of the paraboloid that fits all nine values by least squares."""
    t = np.array([-1.0, 0.0, 1.0])
    gx, gy = np.einsum("lij,j->l", near, t) / 6.0, np.einsum("lij,i->l", near, t) / 6.0
    second = np.array([1.0, -2.0, 1.0])
    bx, by = np.einsum("lij,j->l", near, second) / 3.0, np.einsum("lij,i->l", near, second) / 3.0
    return np.stack([gx, gy], axis=1), np.stack([bx, by, np.einsum("lij,i,j->l", near, t, t) / 4.0], axis=1)


def _parabola_variance(cells: Cells, middle: Float, bend: Float, metric: str) -> Float:
    """Variance [px²] of the gradient's noise over the curvature's square: Σ V (∂gradient/∂z)², what the scores at both sides of the
    middle have by z: T, 2 A T (but for a common part), or the sign of A T − z."""
    tx, ty = _shifted(cells, middle, np.array([-1.0, 0.0, 1.0]))
    light = _light(cells)[:, None, None]

    def slope(row: int, col: int) -> Float:
        spot = ty[:, row, :, None] * tx[:, col, None, :]
        if metric == "product":
            return np.asarray(spot)
        return np.asarray(2.0 * light * spot if metric == "square" else np.sign(light * spot - cells.z))

    spread = 0.25 * cells.variance * cells.inside
    vx = (spread * (slope(1, 2) - slope(1, 0)) ** 2).sum(axis=(1, 2))
    vy = (spread * (slope(2, 1) - slope(0, 1)) ** 2).sum(axis=(1, 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([vx, vy], axis=1) / bend[:, :2] ** 2


@estimator(
    "centroid",
    cites="L. A. Poyneer, Appl. Opt. 42:5807, 2003 (correlation by FFT, parabola); S. Thomas et al., MNRAS 371:323, 2006",
)
def spot_correlation(
    capture: xr.Dataset,
    *,
    metric: Literal["product", "square", "absolute"] = "product",
    fit: Literal["lines", "surface"] = "lines",
    least_sigmas: float = 5.0,
    search: Search = "cell",
) -> xr.Dataset:
    """The maximum of Σ z T(x − c) on whole pixels, T the declared spot, or, by `metric`, the minimum of Σ (z − A T)² or
    of Σ |z − A T|, A the cell's light.

    Refined by parabolas along the two axes ("lines") or by the paraboloid through the nine values beside it
    ("surface").

    Returns spot, sigma [px], valid (frame, lenslet, axis), as `spot-centroid`. A parabola is not the peak's shape: the reading is
    biased by the place within a pixel.
    """
    return measured(capture, partial(_correlated, fit=fit, metric=metric), least_sigmas=least_sigmas, search=search)


def _matched(cells: Cells, steps: int) -> Found:
    c = first_guess(cells)[:, :2]
    for _ in range(steps):
        u, v = cells.x - c[:, :1], cells.y - c[:, 1:]
        px, gx, bx = _unit(cells, u)
        py, gy, by = _unit(cells, v)
        pull = np.stack([_sum(cells.z, py, gx), _sum(cells.z, gy, px)], axis=1)
        bend = np.stack([_sum(cells.z, py, bx), _sum(cells.z, by, px)], axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.where(bend < 0, -pull / bend, 0.25 * np.sign(pull))
        step = np.clip(step, -0.5, 0.5)
        c = c + step
        if np.abs(step[cells.sound]).max(initial=0.0) < 1e-6:
            break
    spread = cells.variance * cells.inside
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = np.stack([_sum(spread, py**2, gx**2), _sum(spread, gy**2, px**2)], axis=1) / bend**2
    return Found(c, variance, np.asarray((bend < 0).all(axis=1) & (np.abs(step) < 1e-4).all(axis=1)))


def _unit(cells: Cells, u: Float) -> tuple[Float, Float, Float]:
    """The spot along one axis over its norm, T/√ΣT², and its first and second derivative by the place c (lenslet, w).

    Σ T² over the pixels changes with c within a pixel where spots are narrow: without the norm, c would be drawn to its maxima.
    """
    t, d, b = cells.spot.share(u), -cells.spot.slope(u), cells.spot.bend(u)
    norm = np.sqrt(np.maximum((t**2).sum(axis=1, keepdims=True), 1e-30))
    first = (t * d).sum(axis=1, keepdims=True) / norm
    second = ((d**2 + t * b).sum(axis=1, keepdims=True) - first**2) / norm
    one = d / norm - t * first / norm**2
    two = b / norm - 2.0 * d * first / norm**2 - t * second / norm**2 + 2.0 * t * first**2 / norm**3
    return t / norm, one, two


def _sum(z: Float, down: Float, along: Float) -> Float:
    return np.asarray(np.einsum("lij,li,lj->l", z, down, along))


@estimator("centroid", cites="M. Gratadour, L. M. Mugnier, D. Rouan, A&A 443:357, 2005 (maximum of the correlation)")
def spot_matched(
    capture: xr.Dataset, *, steps: int = 30, least_sigmas: float = 5.0, search: Search = "cell"
) -> xr.Dataset:
    """c maximises Σ z T(x − c)/√ΣT², T the declared spot integrated over pixels, by Newton's method from the brightest pixel.

    Returns spot, sigma [px], valid (frame, lenslet, axis), as `spot-centroid`. Invalid also where `steps` steps do not settle.
    """
    return measured(
        capture, partial(_matched, steps=whole("steps", steps, 1)), least_sigmas=least_sigmas, search=search
    )
