"""The line's light in one frame: the sheet's profile integrated over every pixel that it crosses.

A pixel of a row is cut into segments along the row. On the tangent plane of what a segment's middle ray hits, the distance u from
the sheet's middle plane runs from u_a to u_b, so that the segment's mean of g(u) is (Φ(u_b/σ) − Φ(u_a/σ))/(u_b − u_a): exact on
flat surfaces however thin the sheet is. The lens's point spread, b px, widens it there: σ² + (b ∂u/∂col)². Segments and rows within
a pixel are doubled until the image stays within the request.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from ...optics.sheet import gaussian_mean
from .setting import Pose, Setting

__all__ = ["Lit", "Nodes", "line_light", "nodes_of"]

Float = NDArray[np.float64]

#: Standard deviations of the sheet beyond which it has no light: g falls to 1e-14 of its peak.
_REACH = 8.0
#: Segments along the row and rows within a pixel, from coarse to fine.
_GRIDS = ((2, 1), (4, 2), (8, 3), (16, 5), (32, 9))


@dataclass(frozen=True, eq=False)
class Nodes:
    """What the middles of the rows see at every half pixel.

    `col` (k): from −½ to cols − ½. `offset` (rows, k): u [m], NaN where nothing is hit. `sigma` (rows, k): of the sheet there.
    `lens_px`: the widest point spread of the lens on the line's way through the image.
    """

    col: Float
    offset: Float
    sigma: Float
    lens_px: float


@dataclass(frozen=True, eq=False)
class Lit:
    """Photoelectrons (rows, cols) of the line in one exposure, the rays that were traced, and how far the last doubling moved
    the image, relative to its own root mean square."""

    electrons: Float
    rays: int
    change: float


def nodes_of(setting: Setting, pose: Pose) -> Nodes:
    """The nodes of one frame."""
    rows, cols = setting.rig.camera.rows, setting.rig.camera.cols
    col: Float = 0.5 * np.arange(2 * cols + 1, dtype=np.float64) - 0.5
    row, at = (part.ravel() for part in np.meshgrid(np.arange(rows, dtype=np.float64), col, indexing="ij"))
    seen = setting.see(row, at, pose, lit=False)
    offset: Float = np.where(seen.hit, setting.sheet.offset(seen.point), np.nan)
    sigma = setting.sheet.sigma(setting.sheet.range(seen.point))
    near = seen.hit & (np.abs(offset) < _REACH * sigma + np.abs(np.nan_to_num(np.gradient(offset))))
    lens = setting.lens_px(at[near], seen.point[:, near])
    widest = float(np.max(lens, initial=setting.rig.lens_sigma_px))
    return Nodes(col, offset.reshape(rows, -1), sigma.reshape(rows, -1), widest)


def line_light(setting: Setting, pose: Pose, nodes: Nodes, rtol: float) -> Lit:
    """The line's light to a relative error of about `rtol` of its root mean square."""
    rows, cols = setting.rig.camera.rows, setting.rig.camera.cols
    row, col = np.nonzero(_crossed(nodes, cols, nodes.lens_px))
    image, rays, change = np.zeros((rows, cols)), nodes.offset.size, np.inf
    if not row.size:
        return Lit(image, rays, 0.0)
    last: Float | None = None
    for across, along in _GRIDS:
        value = _pixels(setting, pose, row.astype(np.float64), col.astype(np.float64), across, along)
        rays += row.size * across * along
        whole = float(np.sqrt((value**2).sum()))
        if last is not None:
            change = float(np.sqrt(((value - last) ** 2).sum())) / whole if whole > 0 else 0.0
        last = value
        # The change is the coarser grid's error; that of the finer one is below a third of it, edges included.
        if change <= 2.0 * rtol:
            break
    assert last is not None
    image[row, col] = last
    return Lit(image, rays, change)


def _crossed(nodes: Nodes, cols: int, lens_px: float) -> NDArray[np.bool_]:
    """Pixels (rows, cols) that may hold light: the sheet, as far as it reaches, lies between their nodes or within the lens's
    point spread of them."""
    reach = _REACH * nodes.sigma
    low = np.where(np.isnan(nodes.offset), np.inf, nodes.offset - reach)
    high = np.where(np.isnan(nodes.offset), -np.inf, nodes.offset + reach)
    three = [slice(k, k + 2 * cols - 1, 2) for k in range(3)]
    within = np.minimum.reduce([low[:, s] for s in three]) <= 0
    within &= np.maximum.reduce([high[:, s] for s in three]) >= 0
    near = np.ones((3, 3 + 2 * int(np.ceil(_REACH * lens_px))), bool)
    return np.asarray(binary_dilation(within, near))


def _pixels(setting: Setting, pose: Pose, row: Float, col: Float, across: int, along: int) -> Float:
    """Photoelectrons of pixels (n), each cut into `across` segments of `along` rows."""
    down, right = (part.ravel()[:, None] for part in np.meshgrid(_middles(along), _middles(across), indexing="ij"))
    at_row, at_col = (row + down).ravel(), (col + right).ravel()
    seen = setting.see(at_row, at_col, pose)
    low, high = (setting.offsets(at_row, at_col + step, seen) for step in (-0.5 / across, 0.5 / across))
    good = (seen.radiance > 0) & np.isfinite(low) & np.isfinite(high)
    spread = setting.lens_px(at_col, seen.point) * across * (high - low)
    sigma = np.hypot(setting.sheet.sigma(setting.sheet.range(seen.point)), spread)
    share = gaussian_mean(np.where(good, low, 1.0), np.where(good, high, 1.0), np.where(good, sigma, 1.0))
    light = np.where(good, seen.radiance * share, 0.0)
    return np.asarray(light.reshape(across * along, row.size).mean(axis=0))


def _middles(count: int) -> Float:
    """Middles of `count` equal parts of −½ … ½."""
    return (np.arange(count) + 0.5) / count - 0.5
