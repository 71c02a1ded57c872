"""Gradients of Zernike polynomials averaged over lenslets, by integrals along the edges.

The mean gradient over an area A with boundary C and outward normal n is (1/A)∮_C Z n ds (Gauss' theorem), so that only values of Z
are needed. Along straight edges a polynomial of order n is integrated exactly by ⌈(n+1)/2⌉ Gauss-Legendre nodes. A lenslet cut by
the edge of a round pupil has arcs too, with enough nodes for rounding accuracy. A gradient at the lenslet's centre is not its mean.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..zernike import orders_of, zernike

__all__ = ["hexagon", "illuminated_share", "mean_gradients", "square"]

Float = NDArray[np.float64]


def square(side_m: float, rotation_rad: float = 0.0) -> Float:
    """Corners (4, 2) [m] of a square lenslet about its centre, x then y."""
    corners = 0.5 * side_m * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return _turned(corners, rotation_rad)


def hexagon(flat_to_flat_m: float, rotation_rad: float = 0.0) -> Float:
    """Corners (6, 2) [m] of a hexagonal lenslet about its centre, two of its edges parallel to y before rotation."""
    angle = np.pi / 6 + np.pi / 3 * np.arange(6)
    return _turned(flat_to_flat_m / np.sqrt(3.0) * np.stack([np.cos(angle), np.sin(angle)], axis=1), rotation_rad)


def mean_gradients(
    noll: Iterable[int] | int,
    centres_m: ArrayLike,
    corners_m: ArrayLike,
    pupil_radius_m: float,
    *,
    cut_by_pupil: bool = False,
) -> Float:
    """Mean of (∂Z_j/∂x, ∂Z_j/∂y) over each lenslet as (lenslets, 2, modes) [1/m].

    Multiplied by coefficients in rad rms it gives the mean phase gradient [rad/m]; over k = 2π/λ the mean slope [rad].

    Main arguments:
        noll: Noll's indices. centres_m (lenslets, 2): x, y from the pupil's centre. corners_m (corners, 2): of a convex lenslet
            about its centre, as `square` gives them. pupil_radius_m: the radius of the disk of unit rms.

    Other arguments:
        cut_by_pupil: the mean over the part of the lenslet within the pupil; NaN for lenslets without such a part.

    Raises ValueError for shapes other than these, a radius that is not positive, or corners that enclose no area.
    """
    modes = [noll] if isinstance(noll, int | np.integer) else list(noll)
    centre, corner = _unit(centres_m, corners_m, pupil_radius_m)
    order = max(orders_of(int(j))[0] for j in modes)
    points, normals = _boundary(centre, corner, order, cut_by_pupil)
    area = 0.5 * np.einsum("kpa,kpa->k", points, normals)
    values = zernike(modes, points[..., 0], points[..., 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(area > 1e-14 * _area(corner), 1.0 / area, np.nan)
    mean = np.einsum("jkp,kpa->kaj", values, normals, optimize=True) * share[:, None, None]
    return np.asarray(mean / pupil_radius_m)


def illuminated_share(centres_m: ArrayLike, corners_m: ArrayLike, pupil_radius_m: float) -> Float:
    """Share (lenslets) 0 … 1 of each lenslet's area that lies within a round pupil. Arguments as for `mean_gradients`."""
    centre, corner = _unit(centres_m, corners_m, pupil_radius_m)
    points, normals = _boundary(centre, corner, 1, True)
    return np.asarray(0.5 * np.einsum("kpa,kpa->k", points, normals) / _area(corner))


def _boundary(centre: Float, corner: Float, order: int, cut: bool) -> tuple[Float, Float]:
    """Nodes (lenslets, nodes, 2) along the boundaries and normals times weights (lenslets, nodes, 2), in radii of the pupil."""
    node, weight = np.polynomial.legendre.leggauss(max(order // 2 + 1, 2))
    start = centre[:, None, :] + corner
    edge = np.roll(corner, -1, axis=0) - corner
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
    low, high = np.zeros(start.shape[:2]), np.ones(start.shape[:2])
    if cut:
        low, high = _inside(start, edge)
    half = 0.5 * (high - low)
    t = 0.5 * (high + low)[..., None] + half[..., None] * node
    points = start[:, :, None, :] + t[..., None] * edge[:, None, :]
    normals = (half[..., None] * weight)[..., None] * normal[:, None, :]
    shape = (len(centre), -1, 2)
    points, normals = points.reshape(shape), normals.reshape(shape)
    if not cut:
        return points, normals
    arcs = _arcs(start, edge, low, high, order)
    return np.concatenate([points, arcs[0]], axis=1), np.concatenate([normals, arcs[1]], axis=1)


def _inside(start: Float, edge: Float) -> tuple[Float, Float]:
    """Parameters (lenslets, edges) between which an edge lies in the unit disk; equal where it does not."""
    a = (edge**2).sum(axis=1)
    b = (start * edge).sum(axis=2)
    c = (start**2).sum(axis=2) - 1.0
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    low, high = np.clip((-b - root) / a, 0.0, 1.0), np.clip((-b + root) / a, 0.0, 1.0)
    return low, np.where(b * b - a * c > 0.0, high, low)


def _arcs(start: Float, edge: Float, low: Float, high: Float, order: int) -> tuple[Float, Float]:
    """Nodes and normals along the parts of the unit circle within the lenslets."""
    t = np.stack([low, high], axis=2)
    crossing = start[:, :, None, :] + t[..., None] * edge[:, None, :]
    angle = np.arctan2(crossing[..., 1], crossing[..., 0]).reshape(len(start), -1)
    # Any further angle only divides an arc in two, so that points that lie not on the circle need not be sorted out.
    angle = np.sort(angle, axis=1)
    bound = np.concatenate([angle, angle[:, :1] + 2.0 * np.pi], axis=1)
    middle, half = 0.5 * (bound[:, 1:] + bound[:, :-1]), 0.5 * (bound[:, 1:] - bound[:, :-1])
    ahead = np.stack([np.cos(middle), np.sin(middle)], axis=2)[:, :, None, :] - start[:, None, :, :]
    within = (edge[:, 0] * ahead[..., 1] - edge[:, 1] * ahead[..., 0] > 0.0).all(axis=2)
    half = np.where(within, half, 0.0)
    node, weight = np.polynomial.legendre.leggauss(int((order + 1) * half.max(initial=0.0)) + 12)
    theta = (middle[..., None] + half[..., None] * node).reshape(len(start), -1)
    points = np.stack([np.cos(theta), np.sin(theta)], axis=2)
    return points, points * (half[..., None] * weight).reshape(len(start), -1, 1)


def _unit(centres_m: ArrayLike, corners_m: ArrayLike, pupil_radius_m: float) -> tuple[Float, Float]:
    centre, corner = np.asarray(centres_m, np.float64), np.asarray(corners_m, np.float64)
    if centre.ndim != 2 or centre.shape[1] != 2 or corner.ndim != 2 or corner.shape[1] != 2 or len(corner) < 3:
        raise ValueError(
            f"centres_m needs the shape (lenslets, 2) and corners_m (3 or more, 2), not {centre.shape} and {corner.shape}."
        )
    if not (pupil_radius_m > 0 and np.isfinite(pupil_radius_m)):
        raise ValueError(f"pupil_radius_m must be positive and finite, not {pupil_radius_m!r}.")
    if _area(corner) < 0:
        corner = corner[::-1]
    if not _area(corner) > 0:
        raise ValueError("corners_m must enclose an area.")
    return centre / pupil_radius_m, corner / pupil_radius_m


def _area(corner: Float) -> float:
    other = np.roll(corner, -1, axis=0)
    return float(0.5 * (corner[:, 0] * other[:, 1] - corner[:, 1] * other[:, 0]).sum())


def _turned(corners: Float, rotation_rad: float) -> Float:
    c, s = np.cos(rotation_rad), np.sin(rotation_rad)
    return np.asarray(corners @ np.array([[c, s], [-s, c]]))
