"""Centres of mass of spots: plain, thresholded, windowed, weighted, of a power of the light, of the brightest pixels; quad cell.

With weights W(z) the position is c = Σ W x/Σ W over the cell, and its variance Σ V (dW/dz)² (x − c)²/(Σ W)², V that of a pixel.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.special import ndtr

from ..registry import estimator
from ..rig import DeclaredRig
from .cells import Cells, Found, Scale, Search, corner_px, measured, whole_cells
from .geometry import declared_geometry
from .options import in_range, whole

__all__ = [
    "spot_brightest", "spot_centroid", "spot_power", "spot_quad", "spot_threshold", "spot_weighted", "spot_window",
]  # fmt: skip

Float = npt.NDArray[np.float64]


def _centre(cells: Cells, weight: Float, slope: Float) -> Found:
    """The centre of weights W, `slope` dW/dz, both (lenslet, w, w)."""
    total = weight.sum(axis=(1, 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        cx = np.einsum("lij,lj->l", weight, cells.x) / total
        cy = np.einsum("lij,li->l", weight, cells.y) / total
        spread = cells.variance * slope**2
        vx = np.einsum("lij,lj->l", spread, (cells.x - cx[:, None]) ** 2) / total**2
        vy = np.einsum("lij,li->l", spread, (cells.y - cy[:, None]) ** 2) / total**2
    return Found(np.stack([cx, cy], axis=1), np.stack([vx, vy], axis=1), total > 0)


def _plain(cells: Cells) -> Found:
    return _centre(cells, cells.z, cells.inside.astype(np.float64))


def _plain_straight(images: npt.NDArray[Any], rig: DeclaredRig, exposures: int, least_sigmas: float) -> Found:
    """`_plain` of images (image, rows, cols) [DN] by its kernel."""
    from .moment_kernel import centres_of_gravity

    geometry, scale = declared_geometry(rig), Scale.of(rig)
    position, variance, good, sound = centres_of_gravity(
        images, geometry.place_px, 0.5 * geometry.pitch_px, corner_px(geometry), whole_cells(rig, *images.shape[1:]),
        (scale.offset_dn, scale.dn_per_e, scale.dead_dn, scale.top_dn), scale.floor_e2 / exposures, scale.excess / exposures,
        least_sigmas,
    )  # fmt: skip
    return Found(position, variance, good & sound)


@estimator("centroid", cites="Guo et al. 2017, Eq. 28-29 with α = 1: centre of gravity over the lenslet's cell")
def spot_centroid(capture: xr.Dataset, *, least_sigmas: float = 5.0, search: Search = "cell") -> xr.Dataset:
    """c = Σ x z/Σ z over the pixels of a cell, z above the frame's background.

    Returns spot, sigma [px], valid (frame, lenslet, axis), relative to the reference, whose noise counts. Invalid where the
    brightest pixel is not `least_sigmas` above the background's noise, or where the cell holds a clipped or dead pixel.
    """
    return measured(capture, _plain, least_sigmas=least_sigmas, search=search, reader=_plain_straight)


def _above(cells: Cells, threshold: float, sigmas: float) -> Found:
    peak = cells.z.max(axis=(1, 2), keepdims=True)
    noise = np.sqrt(cells.floor_e2 + cells.excess * np.maximum(cells.level, 0.0))[:, None, None]
    limit = np.maximum(threshold * peak, sigmas * noise)
    above = cells.inside & (cells.z > limit)
    return _centre(cells, np.where(above, cells.z - limit, 0.0), above.astype(np.float64))


@estimator("centroid", cites="S. Thomas et al., MNRAS 371:323, 2006, sec. 3.1 (thresholded centre of gravity)")
def spot_threshold(
    capture: xr.Dataset,
    *,
    threshold: float = 0.1,
    sigmas: float = 3.0,
    least_sigmas: float = 5.0,
    search: Search = "cell",
) -> xr.Dataset:
    """c = Σ x w/Σ w with w = z − T where z > T, T the larger of `threshold` · peak and `sigmas` standard deviations of the dark.

    Returns spot, sigma [px], valid (frame, lenslet, axis), as `spot-centroid`.
    """
    in_range("threshold", threshold, 0, 1)
    in_range("sigmas", sigmas, 0)
    return measured(
        capture, partial(_above, threshold=threshold, sigmas=sigmas), least_sigmas=least_sigmas, search=search
    )


def _around_peak(cells: Cells, reach: int) -> Found:
    lenslets, width, _ = cells.z.shape
    peak = cells.z.reshape(lenslets, -1).argmax(axis=1)
    row, col = peak // width, peak % width
    near = np.abs(np.arange(width) - row[:, None]) <= reach
    beside = np.abs(np.arange(width) - col[:, None]) <= reach
    kept = cells.inside & near[:, :, None] & beside[:, None, :]
    return _centre(cells, np.where(kept, cells.z, 0.0), kept.astype(np.float64))


@estimator("centroid", cites="S. Thomas et al., MNRAS 371:323, 2006, sec. 3.1 (centre of gravity in a window)")
def spot_window(
    capture: xr.Dataset, *, reach: int = 2, least_sigmas: float = 5.0, search: Search = "cell"
) -> xr.Dataset:
    """c = Σ x z/Σ z over the (2·`reach` + 1)² pixels around the brightest one, as far as they lie in the cell.

    Returns spot, sigma [px], valid (frame, lenslet, axis), as `spot-centroid`.
    """
    return measured(
        capture, partial(_around_peak, reach=whole("reach", reach, 1)), least_sigmas=least_sigmas, search=search
    )


def _weighted(cells: Cells, width: float, steps: int) -> Found:
    s = width * cells.spot.sigma_px
    start = _around_peak(cells, 2).position
    c = np.where(np.isfinite(start), start, 0.0)
    for _ in range(steps):
        u, v = cells.x - c[:, :1], cells.y - c[:, 1:]
        gx, gy = np.exp(-0.5 * (u / s) ** 2), np.exp(-0.5 * (v / s) ** 2)
        weight = cells.z * gy[:, :, None] * gx[:, None, :]
        total = np.where((whole := weight.sum(axis=(1, 2))) > 0, whole, np.inf)
        # A step of Newton's method on Σ z g u = 0: twice that of the plain iteration where weight and spot are alike.
        bend_x = np.einsum("lij,lj->l", weight, 1.0 - (u / s) ** 2)
        bend_y = np.einsum("lij,li->l", weight, 1.0 - (v / s) ** 2)
        pull = np.stack([np.einsum("lij,lj->l", weight, u), np.einsum("lij,li->l", weight, v)], axis=1)
        bend = np.stack([bend_x, bend_y], axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.where(bend > 0.2 * total[:, None], pull / bend, pull / total[:, None])
        c = c + np.clip(step, -1.0, 1.0)
        if np.abs(step[cells.sound]).max(initial=0.0) < 1e-6:
            break
    spread = cells.variance * (gy[:, :, None] * gx[:, None, :]) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        vx = np.einsum("lij,lj->l", spread, u**2) / bend_x**2
        vy = np.einsum("lij,li->l", spread, v**2) / bend_y**2
    good = np.isfinite(total) & (bend > 0).all(axis=1) & (np.abs(step) < 1e-3).all(axis=1)
    return Found(c, np.stack([vx, vy], axis=1), good)


@estimator(
    "centroid",
    cites="K. L. Baker and M. M. Moallem, Opt. Express 15:5147, 2007 (iteratively weighted centroiding)",
)
def spot_weighted(
    capture: xr.Dataset, *, width: float = 3.0, steps: int = 12, least_sigmas: float = 5.0, search: Search = "cell"
) -> xr.Dataset:
    """c solves Σ z g(x − c)(x − c) = 0, g a Gaussian of `width` times the declared spot's, by Newton's method.

    Returns spot, sigma [px], valid (frame, lenslet, axis), as `spot-centroid`. Invalid also where `steps` steps do not settle.
    """
    return measured(
        capture,
        partial(_weighted, width=in_range("width", width, 0, above=True), steps=whole("steps", steps, 1)),
        least_sigmas=least_sigmas,
        search=search,
    )


def _power(cells: Cells, alpha: float) -> Found:
    light = np.maximum(cells.z, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.where(light > 0, alpha * light ** (alpha - 1.0), 0.0)
    return _centre(cells, light**alpha, slope)


@estimator("centroid", cites="Guo et al. 2017, Eq. 28-29 (power α of the intensity)")
def spot_power(
    capture: xr.Dataset, *, alpha: float = 1.5, least_sigmas: float = 5.0, search: Search = "cell"
) -> xr.Dataset:
    """c = Σ x z^α/Σ z^α over the cell, z above the background and 0 below it (Eq. 28 and 29).

    Free of aliasing where a pixel is at most λf/(αd). Returns spot, sigma [px], valid (frame, lenslet, axis), as
    `spot-centroid`; sigma to first order, which pixels of little light exceed.
    """
    return measured(
        capture,
        partial(_power, alpha=in_range("alpha", alpha, 0, above=True)),
        least_sigmas=least_sigmas,
        search=search,
    )


def _brightest(cells: Cells, pixels: int) -> Found:
    flat = np.where(cells.inside, cells.z, -np.inf).reshape(len(cells.z), -1)
    number = min(pixels, flat.shape[1] - 1)
    ordered = np.partition(flat, (-number - 1, -number), axis=1)
    limit = ordered[:, -number][:, None, None]
    kept = cells.inside & (cells.z >= limit) & (cells.z > 0)
    # A pixel near the limit is in or out by its noise: with the chance q to be in, its share of the sum has V q + z² q (1 − q).
    between = 0.5 * (limit + ordered[:, -number - 1][:, None, None])
    with np.errstate(divide="ignore", invalid="ignore"):
        chance = ndtr((cells.z - between) / np.sqrt(cells.variance)) * cells.inside
        slope = np.sqrt(
            chance + np.where(cells.variance > 0, cells.z**2 / cells.variance, 0.0) * chance * (1.0 - chance)
        )
    return _centre(cells, np.where(kept, cells.z, 0.0), np.nan_to_num(slope))


@estimator("centroid", cites="A. G. Basden et al., MNRAS 419:1628, 2012 (brightest pixel selection)")
def spot_brightest(
    capture: xr.Dataset, *, pixels: int = 9, least_sigmas: float = 5.0, search: Search = "cell"
) -> xr.Dataset:
    """c = Σ x z/Σ z over the `pixels` brightest pixels of the cell.

    Returns spot, sigma [px], valid (frame, lenslet, axis), as `spot-centroid`; sigma holds that noise
    decides which pixels count.
    """
    return measured(
        capture, partial(_brightest, pixels=whole("pixels", pixels, 3)), least_sigmas=least_sigmas, search=search
    )


def _quad(cells: Cells) -> Found:
    """Halves of the cell about the declared place; a pixel across the border is shared out."""
    right = np.clip(cells.x + 0.5, 0.0, 1.0) - np.clip(0.5 - cells.x, 0.0, 1.0)
    below = np.clip(cells.y + 0.5, 0.0, 1.0) - np.clip(0.5 - cells.y, 0.0, 1.0)
    total = cells.z.sum(axis=(1, 2))
    # Of a spot at c the signal is 1 − 2∫ beyond: its slope at c = 0 is twice the spot's height there.
    per_px = 2.0 / (np.sqrt(2.0 * np.pi) * cells.spot.sigma_px)
    with np.errstate(divide="ignore", invalid="ignore"):
        sx = np.einsum("lij,lj->l", cells.z, right) / total
        sy = np.einsum("lij,li->l", cells.z, below) / total
        vx = (
            np.einsum("lij,lij->l", cells.variance * cells.inside, (right[:, None, :] - sx[:, None, None]) ** 2)
            / total**2
        )
        vy = (
            np.einsum("lij,lij->l", cells.variance * cells.inside, (below[:, :, None] - sy[:, None, None]) ** 2)
            / total**2
        )
    position = np.stack([sx, sy], axis=1) / per_px
    return Found(position, np.stack([vx, vy], axis=1) / per_px**2, total > 0)


@estimator("centroid", cites="S. Thomas et al., MNRAS 371:323, 2006, sec. 3.2 (quad cell)")
def spot_quad(capture: xr.Dataset, *, least_sigmas: float = 5.0, search: Search = "cell") -> xr.Dataset:
    """c = γ (right − left)/(right + left) of the cell's halves, 1/γ twice the height of the declared spot.

    Linear near the middle only: spots that move by more than half of their width are read short. Returns spot, sigma [px],
    valid (frame, lenslet, axis), as `spot-centroid`.
    """
    return measured(capture, _quad, least_sigmas=least_sigmas, search=search)
